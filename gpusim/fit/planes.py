"""Light values of raw frames: black level off, channels apart, clipped pixels known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData
from gpusim.io.raw.raw_frame import RawFrame

CLIPPED = 0.98  # of the range between black and white: response and noise are no longer whole above
GREENS = "GYWC"  # channels of the most light, the first that is there leads
WAVELENGTHS = {"R": 605.0, "G": 535.0, "B": 460.0, "Y": 560.0, "C": 500.0, "M": 550.0, "W": 560.0}


def checked_frames(frames: object, kind: str) -> list[RawFrame]:
    """Return frames as a list.

    Args:
        frames: A RawFrame or several.
        kind: Kind of the frames, for messages.

    Returns:
        One frame or more, all of the same size and mosaic.

    Raises:
        BadData: These are no frames, or their sizes or mosaics differ.
    """
    every = (
        [frames]
        if isinstance(frames, RawFrame)
        else list(frames)
        if isinstance(frames, Sequence)
        else []
    )
    if not every or not all(isinstance(frame, RawFrame) for frame in every):
        raise BadData(f"{kind}: {type(frames).__name__}, wanted a RawFrame or several in a list")
    first = every[0]
    for frame in every:
        if frame.values.ndim != 2:
            raise BadData(
                f"{frame.name or kind}: shape {frame.values.shape}, wanted the mosaic of a raw file (rows, "
                "cols): save raw files, not JPEG"
            )
        if frame.values.shape != first.values.shape or frame.cfa != first.cfa:
            raise BadData(
                f"{frame.name} and {first.name}: {kind} of different size or mosaic; give frames of one camera "
                "and mode"
            )
    return every


def light_values(frame: RawFrame, black: ArrayLike | None = None) -> np.ndarray:
    """Return the values of a frame above black.

    Args:
        frame: The frame.
        black: Black level [DN]: a number, or one for each place of a period, shape of `cfa`. None: the level that
            the file states, else 0.

    Returns:
        Values [DN], float64, shape (rows, cols).

    Raises:
        BadData: The black level has another shape.
    """
    values = np.asarray(frame.values, np.float64)
    level = frame.black_level if black is None else black
    if level is None:
        return values
    level = np.asarray(level, np.float64)
    if level.size == 1:
        return values - level.item()
    period = len(frame.cfa), len(frame.cfa[0])
    if level.size != np.prod(period):
        raise BadData(
            f"{frame.name}: {level.size} black levels for a period of {period[0]} x {period[1]} pixels"
        )
    rows, cols = values.shape
    tiles = -(-rows // period[0]), -(-cols // period[1])
    return values - np.tile(level.reshape(period), tiles)[:rows, :cols]


def clipped_mask(frame: RawFrame, values: np.ndarray) -> np.ndarray:
    """Return where a frame is clipped.

    Args:
        frame: The frame.
        values: Its `light_values`.

    Returns:
        True at clipped pixels, shape (rows, cols). Without a stated white level: pixels at the largest value, if
        three or more of a thousand have it.
    """
    raw = np.asarray(frame.values)
    if frame.white_level is not None:
        black = float(np.mean(raw - values))
        return np.asarray(values >= CLIPPED * (frame.white_level - black))
    at_top = raw == raw.max()
    return at_top & (np.mean(at_top) > 3e-3)


def letter_masks(frame: RawFrame) -> dict[str, np.ndarray]:
    """Return the pixels of each channel: letter -> True at its pixels, shape (rows, cols)."""
    period = np.array([list(row) for row in frame.cfa])
    rows, cols = frame.values.shape
    tiles = -(-rows // period.shape[0]), -(-cols // period.shape[1])
    letters = np.tile(period, tiles)[:rows, :cols]
    return {letter: letters == letter for letter in frame.channels}


def main_channel(channels: Sequence[str]) -> str:
    """Return the channel that sees most light, from its letter."""
    return next((letter for letter in GREENS if letter in channels), channels[0])


def even_plane(frame: RawFrame, values: np.ndarray) -> np.ndarray:
    """Return values with each place of the period scaled to mean 1.

    Grey content then looks as if every pixel had the same filter, at full resolution.

    Args:
        frame: The frame.
        values: Its `light_values`, shape (rows, cols).

    Returns:
        Values [1], shape (rows, cols).

    Raises:
        BadData: A channel is dark.
    """
    even = np.empty_like(values)
    down, across = len(frame.cfa), len(frame.cfa[0])
    for row in range(down):
        for col in range(across):
            part = values[row::down, col::across]
            mean = part.mean() if part.size else 0.0
            if not mean > 0:
                raise BadData(
                    f"{frame.name}: channel {frame.cfa[row][col]} is dark; wanted a lit target"
                )
            even[row::down, col::across] = part / mean
    return even


def channel_blocks(
    frame: RawFrame, values: np.ndarray, size: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return means of channels over blocks of whole periods.

    Args:
        frame: The frame.
        values: Its `light_values`.
        size: Periods on a side of a block.

    Returns:
        Means (C, rows, cols) in the order of `frame.channels`, and the size of a block (rows, cols) [pixel].
    """
    block = np.array([len(frame.cfa), len(frame.cfa[0])]) * size
    rows, cols = np.array(values.shape) // block
    masks = letter_masks(frame)
    whole = slice(0, rows * block[0]), slice(0, cols * block[1])
    shape = (rows, block[0], cols, block[1])
    means = [
        np.where(mask, values, 0)[whole].reshape(shape).sum((1, 3))
        / mask[whole].reshape(shape).sum((1, 3))
        for mask in masks.values()
    ]
    return np.stack(means), block


def block_places(frame: RawFrame, letter: str, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles of a channel's pixels in blocks.

    They are up to half a pixel off the blocks' own middles if the mosaic has the channel on one side of its period.

    Args:
        frame: The frame.
        letter: The channel.
        block: Size of a block (rows, cols) [pixel], see `channel_blocks`.

    Returns:
        Rows and columns of the middles [pixel].
    """
    period = np.array([list(row) for row in frame.cfa])
    aside = np.mean(np.nonzero(period == letter), axis=1) - (np.array(period.shape) - 1) / 2
    counts = np.array(frame.values.shape) // block
    rows, cols = (
        (np.arange(count) + 0.5) * size - 0.5 + off
        for count, size, off in zip(counts, block, aside, strict=True)
    )
    return rows, cols


def field_place(row: Any, col: Any, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Return the field point (y, x) of a pixel; 1 is the frame's corner."""
    corner = np.hypot(*shape) / 2
    return (row - (shape[0] - 1) / 2) / corner, (col - (shape[1] - 1) / 2) / corner
