"""Dark frames whose darkest values are clipped at 0: level and noise before clipping and rounding.

Without clipping, values are normal numbers: a level, a fixed pattern and temporal noise, each of pixels, rows and
columns. Clipping and rounding are a staircase of unit steps at 1/2, 3/2, ... Two values whose normal numbers have a
correlation r then have the covariance sum c_k^2 r^k / k!, with the staircase's Hermite coefficients c_k. Each variance
of the clipped values is a covariance of pixels that share a frame, a row, a column or a place; so that each gives a
correlation. Mean and variance of all values give the level and the deviation. Errors come from a parametric bootstrap.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gpusim.fit.intervals import Range, Z, difference_of
from gpusim.fit.levels import Level
from gpusim.fit.patterns import Pattern, split_pattern
from gpusim.fit.rounding import rounded_variance
from gpusim.fit.stack import FrameStack

STEPS = 4.5  # standard deviations of dark values that must lie above 0
TERMS = 80  # of the series
FAR = 9.0  # standard deviations to which steps are counted
RESAMPLES, MOST_SIDE = 30, 256  # of the bootstrap, and its frames' largest side
LEAST_ABOVE = 0.02  # share of values above 0 that tells their distribution


class DarkNoise(NamedTuple):
    """Level [DN] and variances [DN^2] of dark values, or their standard errors.

    Args:
        level: Mean.
        pixel, row, column: Temporal variances.
        fixed_pixel, fixed_row, fixed_column: Variances of the fixed pattern.
    """

    level: float
    pixel: float
    row: float
    column: float
    fixed_pixel: float
    fixed_row: float
    fixed_column: float


class Unclipped(NamedTuple):
    """Dark noise before clipping.

    Args:
        level: [DN].
        pixel, row, column: Temporal variances [DN^2].
        fixed_pixel, fixed_row, fixed_column: Variances of the fixed pattern [DN^2].
    """

    level: Range
    pixel: Range
    row: Range
    column: Range
    fixed_pixel: Range
    fixed_row: Range
    fixed_column: Range


def is_clipped(stack: FrameStack, good: np.ndarray) -> bool:
    """Return whether a part of the dark values is clipped at 0.

    Args:
        stack: Dark frames.
        good: Pixels to count, shape (rows, cols).
    """
    mean, variance = _moments(stack, good)
    return stack.lowest <= 0 and mean <= STEPS * math.sqrt(variance)


def is_above_zero(level: Level, deviation: float) -> bool:
    """Return whether no channel of a level is clipped at 0, and its frames are a pair at least.

    Args:
        level: The level.
        deviation: Standard deviation of dark values [DN].
    """
    reach = [
        point.mean - STEPS * math.hypot(point.variance**0.5, deviation)
        for point in level.points.values()
    ]
    return level.count > 1 and min(reach) > 0


def temporal_lines(stack: FrameStack, good: np.ndarray):
    """Return the temporal variances of rows, of columns, and of pixels [DN^2].

    Args:
        stack: Dark frames.
        good: Pixels to count, shape (rows, cols).

    Returns:
        Two ranges and a mean square.
    """
    pixel = stack.pixel_square(good)
    rows, cols = stack.shape
    row = difference_of(stack.row_square(), pixel.scaled(1 / cols))
    column = difference_of(stack.column_square(), pixel.scaled(1 / rows))
    return row, column, pixel


def unclip(stack: FrameStack, good: np.ndarray, seed: int = 0) -> Unclipped | None:
    """Return level and noise of dark frames before clipping, with intervals.

    Args:
        stack: Dark frames, some of whose values are clipped at 0.
        good: Pixels to count, shape (rows, cols).
        seed: Seed of the bootstrap.

    Returns:
        The noise; None: too few values lie above 0.

    Source:
        Tobin, "Estimation of relationships for limited dependent variables", Econometrica 26
        (1958), 24, on clipped normal numbers; Price, "A useful theorem for nonlinear devices having
        Gaussian inputs", IRE Trans. Inf. Theory 4 (1958), 69; Efron and Tibshirani, "An
        introduction to the bootstrap" (1993), chapter 6.5.
    """
    found = _before_clipping(_seen(stack, good))
    if found is None:
        return None
    random = np.random.default_rng(seed)
    shape = tuple(min(size, MOST_SIDE) for size in stack.shape)
    drawn = [
        _before_clipping(_seen(_draw(found, shape, stack, random), np.ones(shape, bool)))
        for _ in range(RESAMPLES)
    ]
    known = np.array([one for one in drawn if one is not None])
    if len(known) < RESAMPLES:  # some had too few values above 0
        return None
    # of lines, errors fall with the root of their number
    errors = known.std(axis=0, ddof=1) * math.sqrt(max(np.divide(shape, stack.shape)))
    bias = known.mean(axis=0) - found
    halves = Z * np.hypot(errors, bias)
    return Unclipped(
        *(Range(*ends) for ends in zip(found, found - halves, found + halves, strict=True))
    )


def unclipped_level(level: Level, stack: FrameStack, good: np.ndarray) -> Level:
    """Return a level of clipped dark frames with the mean before clipping; variances are unknown.

    Args:
        level: The level.
        stack: Its frames.
        good: Pixels to count, shape (rows, cols).
    """
    moments = np.array(_moments(stack, good))
    found = _normal_of(*moments)
    if found is None:
        return level
    mean, deviation = found
    more = _error_growth(mean, deviation)
    shift = mean - moments[0]
    points = {
        letter: replace(point, mean=point.mean + shift, mean_variance=more * point.mean_variance)
        for letter, point in level.points.items()
    }
    return replace(level, points=points)


def level_before_clipping(level: Level, noise: Unclipped) -> Level:
    """Return a level of dark frames as it would be without clipping.

    Args:
        level: The level.
        noise: Its noise before clipping.
    """
    lines = max(noise.row.value, 0.0) + max(noise.column.value, 0.0)
    variance = rounded_variance(math.sqrt(max(noise.pixel.value, 0.0) + lines)) - lines
    error = (noise.pixel.high - noise.pixel.low) / (2 * Z)
    spread = error**2 * len(level.points)  # channels are pooled as independent ones
    points = {
        letter: replace(point, variance=variance, variance_variance=spread)
        for letter, point in level.points.items()
    }
    return replace(level, points=points)


def pattern_before_clipping(pattern: Pattern, noise: Unclipped) -> Pattern:
    """Return a fixed pattern with its variances before clipping; its maps stay.

    Args:
        pattern: Of the clipped frames.
        noise: Their noise before clipping.
    """
    return replace(pattern, pixel=noise.fixed_pixel, row=noise.fixed_row, column=noise.fixed_column)


def _moments(stack, good):
    """Return mean and variance of all values of good pixels [DN, DN^2]."""
    row, column, pixel = temporal_lines(stack, good)
    temporal = pixel.value + row.value + column.value
    values = stack.mean[good].astype(np.float64)
    return float(values.mean()), float(values.var()) + temporal * (1 - 1 / stack.count)


def _seen(stack, good):
    """Return the noise of clipped values."""
    row, column, pixel = temporal_lines(stack, good)
    fixed = split_pattern(*(half.copy() for half in stack.halves), good, stack.period)
    parts = [one.value for one in (row, column, fixed.pixel, fixed.row, fixed.column)]
    return DarkNoise(float(stack.mean[good].mean(dtype=np.float64)), pixel.value, *parts)


def _before_clipping(seen):
    """Return the noise before clipping as an array; None if too few values lie above 0."""
    normal = _normal_of(seen.level, sum(seen[1:]))
    if normal is None:
        return None
    level, deviation = normal
    squares = _series(level, deviation)
    fixed = _correlation(seen.fixed_pixel + seen.fixed_row + seen.fixed_column, squares)
    fixed_lines = [_correlation(one, squares) for one in (seen.fixed_row, seen.fixed_column)]
    lines = [
        _correlation(one + other, squares) - own
        for one, other, own in zip(
            (seen.row, seen.column), (seen.fixed_row, seen.fixed_column), fixed_lines, strict=True
        )
    ]
    shares = [1 - fixed - sum(lines), *lines, fixed - sum(fixed_lines), *fixed_lines]
    return np.array([level, *(deviation**2 * share for share in shares)])


def _normal_of(mean, variance):
    """Return level and deviation of normal numbers whose clipped, rounded values have these moments."""
    import scipy.optimize

    if not (mean > 0 and variance > 0):
        return None

    def level_at(deviation):
        low, high = -FAR * deviation, mean + deviation + 1
        return scipy.optimize.brentq(lambda x: _staircase(x, deviation)[0] - mean, low, high)

    def excess(deviation):
        return _staircase(level_at(deviation), deviation)[1] - variance

    low, high = 0.2, 4 * (math.sqrt(variance) + mean)
    try:
        deviation = scipy.optimize.brentq(excess, low, high, rtol=1e-7)
        level = level_at(deviation)
    except ValueError:
        return None
    above = 0.5 * math.erfc((0.5 - level) / deviation / math.sqrt(2))
    return (level, deviation) if above > LEAST_ABOVE else None


def _steps(level, deviation):
    """Return the values that begin at steps, and the steps in deviations from the level."""
    last = max(math.ceil(level + FAR * deviation), 1)
    values = np.arange(1, last + 1)
    return values, (values - 0.5 - level) / deviation


def _staircase(level, deviation):
    """Return mean and variance of clipped, rounded normal numbers."""
    import scipy.special

    values, steps = _steps(level, deviation)
    above = scipy.special.ndtr(-steps)
    mean = float(above.sum())
    return mean, float(((2 * values - 1) * above).sum()) - mean**2


def _series(level, deviation):
    """Return c_k^2 / k! for k from 1: parts of the covariance of two values [DN^2]."""
    _, steps = _steps(level, deviation)
    density = np.exp(-(steps**2) / 2) / math.sqrt(2 * math.pi)
    # normalised Hermite polynomials h_k = He_k / sqrt(k!); c_k / sqrt(k!) = sum density h_(k-1) / sqrt(k)
    before, now, found = np.zeros_like(steps), np.ones_like(steps), []
    for k in range(1, TERMS + 1):
        found.append(float(density @ now) ** 2 / k)
        before, now = now, (steps * now - math.sqrt(k - 1) * before) / math.sqrt(k)
    return np.array(found)


def _correlation(covariance, squares):
    """Return the correlation of normal numbers whose values have a covariance [DN^2]."""
    import scipy.optimize

    powers = np.arange(1, TERMS + 1)

    def excess(r):
        return float(squares @ r**powers) - covariance

    if covariance <= 0:  # from chance: as small a correlation below 0
        return covariance / squares[0]
    return scipy.optimize.brentq(excess, 0.0, 1.0) if excess(1.0) > 0 else 1.0


def _error_growth(level, deviation):
    """Return how many times the variance of an estimated level is that of a plain mean of clipped values."""
    values, steps = _steps(level, deviation)
    import scipy.special

    shares = -np.diff(scipy.special.ndtr(-steps), append=0.0)
    values, shares = np.append(0, values), np.append(1 - shares.sum(), shares)
    mean = shares @ values
    second, third, fourth = (shares @ (values - mean) ** k for k in (2, 3, 4))
    covariance = np.array([[second, third], [third, fourth - second**2]])
    step = 1e-4 * deviation
    jacobian = np.array(
        [
            np.subtract(_staircase(level + step, deviation), _staircase(level - step, deviation)),
            np.subtract(_staircase(level, deviation + step), _staircase(level, deviation - step)),
        ]
    ).T / (2 * step)
    inverse = np.linalg.inv(jacobian)
    return float((inverse @ covariance @ inverse.T)[0, 0] / second)


def _draw(noise, shape, stack, random):
    """Return a stack of frames with this noise, clipped."""
    level, *variances = noise
    pixel, row, column, *fixed = np.sqrt(np.maximum(variances, 0))
    rows, cols = shape

    def field(of_pixels, of_rows, of_columns):
        return (
            of_pixels * random.standard_normal(shape, np.float32)
            + of_rows * random.standard_normal((rows, 1), np.float32)
            + of_columns * random.standard_normal(cols, np.float32)
        )

    pattern = level + field(*fixed)
    found = FrameStack(stack.period, is_dark=True)
    for _ in range(stack.count):
        found.add(np.maximum(np.rint(pattern + field(pixel, row, column)), 0))
    return found
