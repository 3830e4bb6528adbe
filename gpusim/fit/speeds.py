"""The noise of each ISO speed, from the frames that it has: darks, flats, pairs of a static scene."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from gpusim.domain.errors import BadData, BadFile
from gpusim.fit.darks import DarkLine
from gpusim.fit.intervals import Range
from gpusim.fit.noise import SHOOT_DARKS, IsoFit, fit_iso
from gpusim.fit.patterns import share_range
from gpusim.fit.scene_stack import SHOOT_PAIRS
from gpusim.fit.scenes import read_scenes
from gpusim.fit.sorting import Summary, group_scenes
from gpusim.fit.transfer import SHOOT_FLATS, Transfer, bounds_of, fit_transfer

LEAST = 256  # pixels of a frame
SCALED = 2.0  # largest value of frames that are scaled to 1
STATED = 0.5  # [DN] error of a stated black level, a whole number
Failures = dict[str, Exception]


def fit_isos(
    darks: Sequence[Summary], flats: Sequence[Summary], pairs: Sequence[Summary] = ()
) -> tuple[list[IsoFit], Failures]:
    """Fit each ISO speed.

    Args:
        darks: Frames without light.
        flats: Frames of even light.
        pairs: Frames of static scenes, for ISO speeds without flats or without darks.

    Returns:
        The fits, in the order of ISO speeds, and the errors of the other speeds by name.

    Raises:
        BadData: Frames are missing, clipped or moved at the only ISO speed that has any.
    """
    _check_frames([*darks, *flats, *pairs])
    speeds = sorted({one.frame.iso for one in (*darks, *flats, *pairs)}, key=lambda iso: iso or 0)
    done, total = count(), len(darks) + len(flats) + len(pairs)
    fits: list[IsoFit] = []
    failures: Failures = {}
    for iso in speeds:
        ours, lit, twice = (
            [one for one in kind if one.frame.iso == iso] for kind in (darks, flats, pairs)
        )
        try:
            fits.append(_fit_speed(iso, ours, lit, twice, done, total))
        except (BadData, BadFile) as error:
            failures["noise" if iso is None else f"noise at ISO {iso:g}"] = error
    if not fits:
        raise next(iter(failures.values()))
    return fits, failures


def _check_frames(frames):
    """Raise BadData for frames without enough pixels, or without whole steps of a converter."""
    rows, cols = frames[0].shape
    if rows * cols < LEAST:
        raise BadData(
            f"{frames[0].frame.name}: {rows} x {cols} pixels are too few for noise; give 16 x 16 pixels or more"
        )
    highest = max(one.highest for one in frames)
    if highest <= SCALED and not all(one.is_whole for one in frames):
        raise BadData(
            f"{frames[0].frame.name}: values are fractions up to {highest:.3g}, no numbers of a converter; give raw "
            "values (DN): multiply by the white level, 4095 for 12 bits"
        )


def _fit_speed(iso, darks, flats, pairs, done, total) -> IsoFit:
    speed = "" if iso is None else f" at ISO {iso:g}"
    if darks and (flats or pairs):
        groups = [] if flats else group_scenes(pairs)
        return fit_iso(iso, darks, flats, groups, done, total)
    if darks:
        raise BadData(f"no flats{speed}: gain and noise in electrons need them; {SHOOT_FLATS}")
    has_black = all(one.frame.black_level is not None for one in (*flats, *pairs))
    if flats and not (pairs or has_black):
        raise BadData(f"no dark frames{speed}: black level and read noise need them; {SHOOT_DARKS}")
    return _fit_scenes(iso, [*flats, *pairs], has_black, done, total)


def _fit_scenes(iso, frames, has_black, done: Iterator[int], total: int) -> IsoFit:
    """Fit an ISO speed without dark frames."""
    groups = group_scenes(frames)
    levels, row, column = read_scenes(groups, done, total)
    is_whole = all(one.is_whole for one in frames)
    lines = max(row.value, 0.0) + max(column.value, 0.0)
    darkest = min(point.mean for level in levels for point in level.points.values())
    stated = (
        float(np.mean([one.frame.black_level.mean() for one in frames])) if has_black else darkest
    )

    def fit_from(black):
        return fit_transfer(
            levels, [], black, lines, is_whole, line_error=0.0, spread=0.0, advice=SHOOT_PAIRS
        )

    transfer, read = fit_from(stated), None
    if has_black:
        black = Range(stated, stated - STATED, stated + STATED)
        transfer = _with_black_error(transfer)
    else:
        black, read = bounds_of(transfer, darkest)
        transfer = fit_from(black.value)
    shape, nothing = groups[0][0].shape, np.zeros(0)
    whole = shape[0] * shape[1]
    return IsoFit(
        iso,
        black,
        DarkLine(black.value, 0.0, {}, nothing, nothing, nothing, [], 1.0, False),
        None,
        transfer,
        None,
        None,
        None,
        row,
        column,
        None,
        share_range(0, whole),
        share_range(0, whole),
        0.0,
        None,
        [],
        levels,
        np.ones(shape, bool),
        is_whole,
        math.sqrt(max(transfer.line.offset + lines, 0.0)),
        bounded_read=read,
        black_source="stated" if has_black else "bounds",
    )


def _with_black_error(transfer: Transfer) -> Transfer:
    """Return the lines with the error of a black level that is stated as a whole number."""

    def widened(line):
        covariance = line.covariance.copy()
        covariance[0, 0] += (line.slope * STATED) ** 2 / 3  # an even distribution
        return line._replace(covariance=covariance)

    lines = {letter: widened(line) for letter, line in transfer.by_channel.items()}
    return replace(transfer, line=widened(transfer.line), by_channel=lines)
