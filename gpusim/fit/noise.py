"""The noise of a sensor from its dark frames and flats, one ISO speed after the other."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.fit.clipped import (
    Unclipped,
    is_above_zero,
    is_clipped,
    level_before_clipping,
    pattern_before_clipping,
    temporal_lines,
    unclip,
    unclipped_level,
)
from gpusim.fit.darks import (
    DarkLine,
    Drift,
    Hot,
    find_drift,
    find_hot,
    find_restless,
    fit_dark_line,
)
from gpusim.fit.findings import ALARM, Tails, find_tails
from gpusim.fit.intervals import (
    Range,
    Z,
    normal_range,
    root_of,
    widened,
)
from gpusim.fit.levels import Level, level_of, stack_group
from gpusim.fit.patterns import Pattern, outliers, share_range, split_pattern
from gpusim.fit.response import Response
from gpusim.fit.rounding import rounding_bias
from gpusim.fit.scene_stack import SHOOT_PAIRS
from gpusim.fit.scenes import read_scenes
from gpusim.fit.sorting import Summary, group_darks, group_flats
from gpusim.fit.transfer import (
    SHOOT_FLATS,
    Linearity,
    Transfer,
    bounds_of,
    find_clipping,
    fit_linearity,
    fit_transfer,
    pool_channels,
)

MOVED = 5.0, 0.03  # standard errors and pixels of a displacement that is one
SAFE = 0.85  # part of the brightest level that no channel of a darker one may reach
SHOOT_DARKS = "shoot 8 or more frames with the lens capped at the exposure times of use"


@dataclass
class IsoFit:
    """The noise of one ISO speed.

    Args:
        iso: ISO speed, None if the files do not say.
        black: Black level [DN].
        dark_line: Dark signal over time.
        drift: Change of the black level over the frames.
        transfer: Photon transfer line.
        linearity: Signal over exposure, or None.
        offsets, response: Fixed patterns of dark frames [DN^2] and of the response [1].
        row, column: Temporal noise of rows and columns [DN^2].
        hot: Hot pixels.
        dead, restless: Shares of dead pixels, and of pixels with telegraph noise.
        jump: Mean distance of the two values of telegraph noise [DN].
        tails: Distribution of the read noise.
        darks, flats: Numbers of the levels.
        good: Pixels that are no defects.
        is_whole: Whether values are whole numbers.
        dark_deviation: Standard deviation of a dark pixel's values, temporal and fixed [DN].
        bounded_read: Bounds of the read noise [e-], if the black level is not known.
        black_source: "darks", "clipped" ones, "hidden" as nearly all of their values are 0, "stated" by
            the files, or "bounds".
    """

    iso: float | None
    black: Range
    dark_line: DarkLine
    drift: Drift | None
    transfer: Transfer
    linearity: Linearity | None
    offsets: Pattern | None
    response: Pattern | None
    row: Range
    column: Range
    hot: Hot | None
    dead: Range
    restless: Range
    jump: float
    tails: Tails | None
    darks: list[Level]
    flats: list[Level]
    good: np.ndarray
    is_whole: bool
    dark_deviation: float
    bounded_read: Range | None = None
    black_source: str = "darks"

    @property
    def gain(self) -> float:
        """System gain [DN/e-]."""
        return self.transfer.line.slope

    @property
    def gain_spread(self) -> float:
        """Relative standard error of the gain."""
        return self.transfer.gain_error / self.gain

    @property
    def read(self) -> Range:
        """Noise of a read without signal [e-], with its interval or its bounds."""
        return self.bounded_read or self.transfer.read

    def in_electrons(self, variance: Range) -> Range:
        """Return the standard deviation [e-] of a variance [DN^2]."""
        return widened(root_of(variance).scaled(1 / self.gain), self.gain_spread)


def fit_iso(
    iso: float | None,
    darks: Sequence[Summary],
    flats: Sequence[Summary],
    scenes: Sequence[Sequence[Summary]],
    done: Iterator[int],
    total: int,
) -> IsoFit:
    """Fit one ISO speed.

    Args:
        iso: The speed.
        darks: Its frames without light.
        flats: Its frames of even light.
        scenes: Groups of frames of static scenes, if there are no flats.
        done: Counter of frames of all speeds.
        total: Number of frames of all speeds.

    Returns:
        The fit.

    Raises:
        BadData: Frames are missing, clipped or moved.
    """
    period = darks[0].frame.period
    is_whole = all(one.is_whole for one in darks)
    groups = group_darks(darks)
    main = max(groups, key=lambda group: min(len(group), 8))
    if len(main) < 2:
        raise BadData(f"{main[0].frame.name} is a single dark frame; {SHOOT_DARKS}")
    stack = stack_group(main, done, total, is_dark=True)
    good = np.ones(stack.shape, bool)
    good &= ~outliers(stack.mean, good, period)
    is_cut = is_whole and is_clipped(stack, good)
    # clipped pixels differ in their variance by their offsets
    restless, jump = (~good & good, 0.0) if is_cut else find_restless(stack)
    good &= ~restless
    longest, hot = _longest(groups, main), None
    levels = []
    if longest is not None and len(longest) > 1:
        other = stack_group(longest, done, total, is_dark=True)
        excess = other.mean - stack.mean
        bad = outliers(excess, np.ones(stack.shape, bool), period)
        excess -= np.median(excess[::7, ::7])
        seconds = longest[0].frame.exposure_time - main[0].frame.exposure_time
        hot = find_hot(excess, bad, seconds)
        good &= ~bad
        levels.append(_dark_level(longest, other, good, is_whole))
        del other, excess
    levels.insert(0, _dark_level(main, stack, good, is_whole))
    for group in groups:
        if group is not main and group is not longest and len(group) > 1:
            other = stack_group(group, done, total, is_dark=True)
            levels.append(_dark_level(group, other, good, is_whole))
            del other
    noise = _dark_noise(stack, good, is_cut)
    row, column, offsets = noise.row, noise.column, noise.offsets
    line_error = max(row.value, 0.0) / stack.shape[0] + max(column.value, 0.0) / stack.shape[1]
    dark_line = fit_dark_line(levels, line_error)
    if is_cut:
        dark_line = _through(dark_line, levels[0])
    fixed = sum(max(part.value, 0.0) for part in (offsets.pixel, offsets.row, offsets.column))
    deviation = math.sqrt(noise.pixel + max(row.value, 0.0) + max(column.value, 0.0) + fixed)
    error = 0.0
    if noise.unclipped is not None:
        error = (noise.unclipped.level.high - noise.unclipped.level.low) / (2 * Z)
    black = _black_range(dark_line, offsets, good.shape, deviation, is_whole, error)
    tails = None
    if stack.count >= 4 and noise.pixel > 1.0 and not is_cut:  # rounding hides finer noise
        tails = find_tails(stack.residual[good], math.sqrt(noise.pixel), float(is_whole))
    halves = stack.halves
    drift = find_drift(levels[0], line_error)
    restless_share = share_range(int(np.count_nonzero(restless)), good.size)
    del stack
    if flats:
        flat_levels, response, dead, good = _read_flats(
            flats, black.value, None if is_cut else halves, good, levels, deviation, done, total
        )
    else:
        flat_levels, _, _ = read_scenes(scenes, done, total)
        response, dead = None, share_range(0, good.size)
    transfer = fit_transfer(
        flat_levels,
        _levels_with_variance(levels, is_cut, noise.unclipped),
        black.value,
        max(row.value, 0.0) + max(column.value, 0.0),
        is_whole,
        line_error,
        fixed,
        SHOOT_FLATS if flats else SHOOT_PAIRS,
    )
    read, source = None, "clipped" if is_cut else "darks"
    if is_cut and noise.unclipped is None:
        black, read = bounds_of(transfer, black.value)
        source = "hidden"
    return IsoFit(
        iso,
        black,
        dark_line,
        drift,
        transfer,
        fit_linearity(flat_levels, black.value, line_error) if flats else None,
        offsets,
        response,
        row,
        column,
        hot,
        dead,
        restless_share,
        jump,
        tails,
        levels,
        flat_levels,
        good,
        is_whole,
        deviation,
        read,
        source,
    )


def _dark_level(group, stack, good, is_whole):
    """Return the numbers of dark frames, with the mean before clipping at 0."""
    level = level_of(group, stack, good)
    return unclipped_level(level, stack, good) if is_whole and is_clipped(stack, good) else level


class _DarkNoise(NamedTuple):
    """Noise of dark frames: variances of pixels, rows and columns [DN^2], and the fixed pattern."""

    pixel: float
    row: Range
    column: Range
    offsets: Pattern
    unclipped: Unclipped | None


def _dark_noise(stack, good, is_cut):
    """Return the noise of dark frames, before clipping at 0 if that is known."""
    row, column, pixel = temporal_lines(stack, good)
    offsets = split_pattern(*(half.copy() for half in stack.halves), good, stack.period)
    found = unclip(stack, good) if is_cut else None
    if found is None:
        return _DarkNoise(pixel.value, row, column, offsets, None)
    offsets = pattern_before_clipping(offsets, found)
    return _DarkNoise(found.pixel.value, found.row, found.column, offsets, found)


def _through(line, level):
    """Return a dark line whose black level is from one level: the others' clipping is known less well.

    Large single electrons make their values no normal numbers; then the rates are left out.
    """
    if line.chance < ALARM:
        line = replace(line, rates={})
    rate, _ = line.rates.get(level.temperature, (0.0, 0.0))
    return replace(line, black=pool_channels(level).mean - rate * (level.exposure_time or 0.0))


def _levels_with_variance(levels, is_cut, uncut: Unclipped | None):
    """Return dark levels whose variances are known: of clipped frames those of the main group."""
    if not is_cut:
        return levels
    return [] if uncut is None else [level_before_clipping(levels[0], uncut)]


def _longest(groups, main):
    """Return the group of the longest exposure at the main group's temperature, or None."""
    degrees = main[0].frame.temperature
    known = [
        group
        for group in groups
        if group[0].frame.exposure_time is not None
        and (group[0].frame.temperature is None) == (degrees is None)
        and (degrees is None or round(group[0].frame.temperature) == round(degrees))
    ]
    longest = max(known, key=lambda group: group[0].frame.exposure_time, default=None)
    return None if longest is main else longest


def _black_range(dark_line, offsets, shape, deviation, is_whole, more):
    """Return the black level: errors of the frames, of a chip whose pattern is a sample, and more."""
    rows, cols = shape
    pattern = (
        max(offsets.pixel.high, 0.0) / (rows * cols)
        + max(offsets.row.high, 0.0) / rows
        + max(offsets.column.high, 0.0) / cols
    )
    error = math.sqrt(dark_line.black_variance + pattern + more**2)
    bias = rounding_bias(deviation) if is_whole else 0.0
    return normal_range(dark_line.black, error, bias)


def _read_flats(flats, black, dark_halves, good, darks, deviation, done, total):
    """Return the flats' levels, the pattern of the response, the share of dead pixels, good pixels.

    Without maps of dark pixels (None), as these are clipped, the darkest flats that are not clipped at 0 serve.
    """
    groups, frame = group_flats(flats, black), flats[0].frame
    stated = frame.white_level
    levels, response = [], Response(dark_halves, good.shape, frame.period, "".join(frame.cfa))
    brightest = np.max([one.means for one in groups[-1]], axis=0) - black
    for group in groups:
        stack = stack_group(group, done, total, good=good)
        level = level_of(group, stack, good)
        _check_still(level)
        levels.append(level)
        find_clipping(levels, darks, stated)
        if response.halves is None and is_above_zero(level, deviation):
            response.halves = stack.halves
        elif group is not groups[-1]:
            response.add(stack, level, black, SAFE * brightest)
    if not any(level.count > 1 for level in levels):
        raise BadData(f"{levels[0].names[0]} is the only flat of its level; {SHOOT_FLATS}")
    for level in levels:
        level.clipped.clear()
    find_clipping(levels, darks, stated)
    response.add(stack, levels[-1], black, np.full(len(brightest), np.inf))
    pattern, dead, good = response.finish(good)
    return levels, pattern, dead, good


def _check_still(level):
    """Raise BadData if the frames of a level show a displaced picture."""
    if level.shift is None:
        return
    shift, error = level.shift
    if np.any((np.abs(shift) > MOVED[0] * error) & (np.abs(shift) > MOVED[1])):
        raise BadData(
            f"{level.names[0]} and {level.names[1]} are displaced by {np.hypot(*shift):.2f} pixel: the "
            "tripod or the target moved; shoot the pairs again on a firm tripod, with a remote release"
        )


def line_of_reads(fits: Sequence[IsoFit]) -> tuple[Range, Range, float] | None:
    """Separate the noise before the gain from the converter's, over ISO speeds.

    read_total^2 = read^2 + adc^2 / gain^2 is a line over 1 / gain^2.

    Args:
        fits: Fits of two ISO speeds or more.

    Returns:
        Read noise [e-], converter noise [DN], and the chance of the residuals; None with one speed.
    """
    from gpusim.fit.intervals import fit_line

    fits = [fit for fit in fits if fit.bounded_read is None]
    if len(fits) < 2:
        return None
    x = np.array([1 / fit.gain**2 for fit in fits])
    y, errors = [], []
    for fit in fits:
        value, low, high = fit.read
        y.append(value**2)
        errors.append(max((high**2 - low**2) / 3.92, 1e-9))
    line = fit_line(x, np.array(y), np.square(errors))
    deviations = np.sqrt(np.diag(line.covariance))
    read = root_of(normal_range(line.offset, deviations[0]))
    adc = root_of(normal_range(line.slope, deviations[1]))
    return read, adc, line.chance
