"""Steps between the values of raw files: shifted bits, and curves that compress bright values with loss."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gpusim.fit.sorting import Summary

OFTEN = 4.0  # pixels on each used value: exp(-4) of all values are missed by chance
BANDS = ((0.02, 0.3), (0.7, 0.98))  # quantiles of the dark and the bright pixels of a frame
GROWN = 2.0  # ratio of steps that is a curve


def common_step(values: np.ndarray) -> int:
    """Return the power of two that divides all values, 1 if they are not whole numbers."""
    if values.dtype.kind not in "ui":
        return 1
    every = int(np.bitwise_or.reduce(values.ravel().astype(np.int64)))
    return every & -every if every else 0


def used_steps(values: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Return levels and the steps between neighbouring used values there [DN].

    Args:
        values: Raw values [DN], shape (rows, cols).

    Returns:
        A pair for the dark and for the bright pixels, if each value has several.
    """
    if values.dtype.kind not in "ui":
        return ()
    found = []
    ordered = np.sort(values, axis=None)
    for low, high in BANDS:
        part = ordered[int(low * len(ordered)) : int(high * len(ordered))]
        used = np.unique(part)
        if len(used) >= 3 and len(part) >= OFTEN * len(used):
            found.append((float(part.mean()), float(np.median(np.diff(used)))))
    return tuple(found)


def without_shift(summaries: Sequence["Summary"]) -> tuple[list["Summary"], int]:
    """Return shots with values that use their lowest bit, and the step [DN] that they had.

    Frames of 12 bits in 16 are multiples of 16: rounding is by 16, and the converter has 12 bits.

    Args:
        summaries: The shots.
    """
    steps = [one.step for one in summaries if one.step]
    step = min(steps, default=1)
    if step == 1:
        return list(summaries), 1
    return [_divided(one, step) for one in summaries], step


def _divided(one, step):
    frame = one.frame
    black, white = frame.black_level, frame.white_level
    return replace(
        one,
        shot=replace(one.shot, step=step),
        frame=replace(
            frame,
            black_level=black / step if black is not None else None,
            white_level=float(white // step) if white is not None else None,
        ),
        means=one.means / step,
        deviation=one.deviation / step,
        unevenness=one.unevenness / step,
        highest=one.highest / step,
        sketch=one.sketch / step,
        used=tuple((level / step, size / step) for level, size in one.used),
        step=one.step // step,
    )


def curve_lines(summaries: Sequence["Summary"]) -> list[str]:
    """Return a line if the steps between used values grow with the level: a curve with loss.

    Args:
        summaries: The shots.

    Returns:
        No line or one.
    """
    for iso in dict.fromkeys(one.frame.iso for one in summaries):
        points = sorted(pair for one in summaries if one.frame.iso == iso for pair in one.used)
        if len(points) < 2:
            continue
        third = math.ceil(len(points) / 3)
        dark, bright = (
            float(np.median([size for _, size in part]))
            for part in (points[:third], points[-third:])
        )
        if bright >= GROWN * dark:
            return [
                f"values are {dark:g} DN apart at {points[0][0]:.0f} DN and {bright:g} DN at {points[-1][0]:.0f} "
                "DN: the raw files are compressed with loss by a curve, and its rounding is in their noise; "
                "shoot raw without loss"
            ]
    return []
