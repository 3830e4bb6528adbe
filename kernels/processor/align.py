"""Displacements of a burst's frames against one of them, tile by tile, in periods of the mosaic.

Ports: raw (frames, rows, cols) uint16 [DN] -> displacement (frames, tiles_y, tiles_x, 2) float32
[period], rows first. Block b of the reference appears at b + displacement in the frame.

The pixels of one period are added into a block, which has no mosaic. Blocks are halved by means of
2 x 2, rounded to whole numbers, while a tile of 16 x 16 fits. From the coarsest picture on, every
tile starts at twice its parent's displacement and tries all whole displacements up to FINE
(coarsest picture: COARSE) around it. It takes the one with the least sum of absolute differences.
At the end a paraboloid is fitted to the nine sums of squared differences around it; its minimum, at
most half a period away, is the fraction. A displacement back is treated as one forth of the other
tile, because equal tiles then have equal sums on both sides (otherwise the edges of the tile pull
by 0.04 period). Pictures continue with their edge values.

A displacement that follows the noise makes the frame's noise look like the reference's, or moves
sharp edges. Both spoil the average, so each displacement has to be significant. Of n differences
inside both pictures:

- A sum of |differences| of normal noise scatters by 0.755 / sqrt(n) of itself, and the difference
of two sums with one tile in common by 0.94 / sqrt(n). Another whole displacement than the start is
followed only if it saves LIKELY / sqrt(n) of the start's sum, 2.1 of these standard deviations. At
the end it is taken only if on some level, the tile's or a parent's, it saved SAVED / sqrt(n) of the
sum at rest, 4.2 of these, because tens of them are tried.
- With H = 2 sum of g^2, the second derivative of the sum of squares f for gradients g, and the
noise s^2 = f / 2 n of a pixel, the slope scatters by up to 4 s^2 H + 2 n s^4. The depth of the
minimum, slope^2 / 2 H, has to be SURE times f / n (1 + f / 4 H), which is 2.8 of these standard
deviations.

Along an axis on which the sum rises by less than an eighth of itself per period, the content does
not determine a fraction, and there is none.

Sums are whole numbers, so all devices choose the same displacement. If a frame shows something
else, a displacement is found nonetheless: `processor.average` decides whether it fits.
"""

import functools
from numbers import Real

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import moving_picture
from gpusim.kernels.stage import Array, Case, dtype_name, is_opencl_cpu, stage, warp_only

TILE = 16  # rows and columns of blocks
COARSE, FINE = 4, 2  # search radius in the coarsest picture and in the others
PAD = 2 * TILE + COARSE + 4  # blocks around a plane: a window reaches 2 TILE + COARSE + 1 outside
MOST_LEVELS = 8
LIKELY, SAVED = 2, 4  # parts of a sum over the square root of the number of its differences
SURE = 8.0  # depth of a paraboloid's minimum, over what noise gives it


@stage
def align(
    device: Device,
    raw: Array,
    *,
    reference: int = 0,
    period: tuple[int, int] = (2, 2),
    levels: int | None = None,
) -> Array:
    """Return the displacement of every tile of every frame, 0 if noise explains it.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16.
        reference: Number of the frame with which the others are compared.
        period: Rows and columns of the mosaic's period, 1 to 8.
        levels: Pictures, each half as large as the one before; None for as many as hold a tile, up
            to 8. The largest displacement found is about (2 COARSE - 1) 2^(levels - 1) periods.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Displacements [period], shape (frames, tiles_y, tiles_x, 2), float32, for tiles of 16 x 16
        periods; 0 for the reference.

    Raises:
        BadData: `raw` is no stack of uint16 frames, or a frame is smaller than a tile.
        OutOfRange: `reference`, `period` or `levels` is not allowed.

    Source:
        Hasinoff et al. 2016, "Burst photography for high dynamic range and low-light imaging on
        mobile cameras", section 4, for the pyramid of tiles and the paraboloid.
    """
    size = check_inputs(raw, reference, period, levels)
    count, rows, cols = raw.shape
    raw = device.array(raw, np.uint16)
    lanes = 8 if is_opencl_cpu(device) else 1
    period_y, period_x = map(int, period)
    defines = {
        "WIDTH": lanes,
        "TILE": TILE,
        "PAD": PAD,
        "LIKELY": LIKELY,
        "SAVED": SAVED,
        "SURE": f"{SURE}f",
        "PERIOD_Y": period_y,
        "PERIOD_X": period_x,
    }
    launch = functools.partial(device.launch, "processor.align", defines=defines)
    sizes, planes = [size], [device.empty((count, *(n + 2 * PAD for n in size)), np.int32)]
    numbers = [count, rows, cols, *size, *warp_only(device, period_y, period_x)]
    launch("blocks", planes[0].shape, raw, planes[0], *numbers)
    while min(sizes[-1]) // 2 >= TILE and len(sizes) < (levels or MOST_LEVELS):
        sizes.append((sizes[-1][0] // 2, sizes[-1][1] // 2))
        planes.append(device.empty((count, *(n + 2 * PAD for n in sizes[-1])), np.int32))
        launch("halve", planes[-1].shape, planes[-2], planes[-1], count, *sizes[-2], *sizes[-1])
    group = (1, 1, 1) if lanes == 8 else None
    parents, parent_tiles = planes[-1], (0, 0)  # none yet: any array stands for them
    for (h, w), plane in zip(reversed(sizes), reversed(planes), strict=True):
        tiles = -(-h // TILE), -(-w // TILE)
        found = device.empty((count, *tiles, 3), np.int32)
        parents = device.reshape(parents, (int(np.prod(parents.shape)),))
        radius = COARSE if parent_tiles == (0, 0) else FINE
        numbers = [int(reference), radius, *parent_tiles, h, w, *tiles, count]
        launch("search", (count, *tiles), plane, parents, found, *numbers, group=group)
        parents, parent_tiles = found, tiles
    out = device.empty((count, *parent_tiles, 2))
    numbers = [int(reference), *size, *parent_tiles, count]
    launch("fraction", (count, *parent_tiles), planes[0], parents, out, *numbers, group=group)
    return out


def check_inputs(raw, reference, period, levels):
    """Return rows and columns of blocks. Raise BadData or OutOfRange as `align` does."""
    checked_stack(raw, reference, period)
    if levels is not None and not (1 <= levels <= MOST_LEVELS and levels == int(levels)):
        raise OutOfRange("levels", levels, f"a whole number, 1 <= levels <= {MOST_LEVELS}")
    size = raw.shape[1] // int(period[0]), raw.shape[2] // int(period[1])
    if min(size) < TILE:
        raise BadData(
            f"raw: {raw.shape[1]}x{raw.shape[2]} pixels; wanted at least {TILE * period[0]}x"
            f"{TILE * period[1]}, one tile of {TILE}x{TILE} periods"
        )
    return size


def checked_stack(raw, reference, period):
    """Raise BadData or OutOfRange if this is no stack of frames with a reference among them."""
    dtype = dtype_name(raw)
    if len(raw.shape) != 3 or dtype != "uint16" or 0 in raw.shape:
        raise BadData(
            f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (frames, rows, cols) of uint16"
        )
    if not (
        isinstance(reference, Real)
        and 0 <= reference < raw.shape[0]
        and reference == int(reference)
    ):
        raise OutOfRange("reference", reference, f"the number of a frame, 0 .. {raw.shape[0] - 1}")
    if len(period) != 2 or not all(1 <= n <= 8 and n == int(n) for n in period):
        raise OutOfRange("period", period, "whole numbers of rows and columns, 1 .. 8")


def cases():
    """Yield cases.

    Whole and broken displacements, odd sizes, other mosaics, flat fields, the largest numbers.
    """
    random = np.random.default_rng(8)
    why = (
        "whole displacements are equal; of 256 squares and their sum at most 24 roundings per lane, 2.4e-6 of sums "
        "up to 5 times the least bend, cancelled twice and over a determinant of at least a quarter: 4 x 3 x 5 x "
        "2.4e-6 < 2e-4"
    )
    for period, rows, cols, shifts in (
        ((2, 2), 64, 97, [(0, 0), (4, -6), (1, 3)]),
        ((1, 1), 50, 49, [(3, -2), (0, 0)]),
        ((6, 6), 130, 101, [(0, 0), (6, 0)]),
        ((2, 2), 150, 140, [(0, 0), (21, -33)]),
        ((4, 1), 64, 16, [(0, 0), (2, 1)]),
    ):
        raw = moving_picture(random, np.array(shifts), rows, cols, 4 * max(period))
        inputs = {"raw": raw, "period": period, "reference": shifts.index((0, 0))}
        name = f"{len(shifts)} frames {rows}x{cols}, period {period}"
        yield Case(name, inputs, 2e-4, why, metric="exact")
    raw = moving_picture(random, np.array([(0, 0), (6, 6)]), 70, 70, 8)
    yield Case("one level", {"raw": raw, "levels": 1}, 2e-4, why, metric="exact")
    raw = np.full((2, 40, 40), 65535, np.uint16)
    raw[1, 20:] = 0
    yield Case("nothing to go by", {"raw": raw}, 2e-4, why, metric="exact")


def bench(rows, cols):
    """Return inputs: eight frames of a Bayer mosaic."""
    random = np.random.default_rng(8)
    return {"raw": moving_picture(random, random.integers(-20, 21, (8, 2)), rows, cols, 8)}
