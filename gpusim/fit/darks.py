"""Dark frames: black level, its drift, dark current over time and temperature, defects."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.fit.intervals import Range, chance_of, chance_of_normal, normal_range
from gpusim.fit.levels import Level
from gpusim.fit.stack import FrameStack
from gpusim.fit.transfer import pool_channels

RESTLESS = 1e-7  # chance of a pixel's temporal variance, for telegraph noise
# least variance of a telegraph pixel, of its squared offset: four fifths of the time up
JUMP = 0.25


@dataclass(frozen=True, eq=False)
class DarkLine:
    """Dark signal over exposure time, by temperature.

    Args:
        black: Level without exposure [DN], and its variance from noise of frames.
        rates: Dark signal per second [DN/s] and its standard error, by temperature [deg C].
        times, means, errors, degrees: Points of the lines: exposure times [s], means [DN], their
            standard errors, temperatures.
        chance: Probability of residuals at least as large if the lines are right.
        is_extrapolated: Whether there were two exposure times or more.
    """

    black: float
    black_variance: float
    rates: dict[float | None, tuple[float, float]]
    times: np.ndarray
    means: np.ndarray
    errors: np.ndarray
    degrees: list
    chance: float
    is_extrapolated: bool


def fit_dark_line(levels: Sequence[Level], line_error: float) -> DarkLine:
    """Fit a black level and a dark signal per second and temperature.

    Args:
        levels: Dark levels of one ISO speed.
        line_error: Variance of a frame's mean from rows and columns [DN^2].

    Returns:
        The lines; without two exposure times, the mean of all frames as the black level.
    """
    points = [pool_channels(level) for level in levels]
    means = np.array([point.mean for point in points])
    counts = np.array([level.count for level in levels])
    variances = np.array([_finite(point.mean_variance) for point in points]) + line_error / counts
    degrees = [level.temperature for level in levels]
    times = np.array([level.exposure_time or 0.0 for level in levels])
    by_degree: dict = {}
    for degree, time in zip(degrees, times, strict=True):
        by_degree.setdefault(degree, set()).add(time)
    has_lines = len(set(times)) > 1 and all(level.exposure_time is not None for level in levels)
    if not has_lines:
        shortest = times == times.min()
        if all(level.exposure_time is None for level in levels):
            shortest = means == means.min()  # brighter ones have dark current
        weights = shortest / variances
        black = float(weights @ means / weights.sum())
        return DarkLine(
            black,
            float(1 / weights.sum()),
            {},
            times,
            means,
            np.sqrt(variances),
            degrees,
            1.0,
            False,
        )
    named = list(by_degree)
    design = np.column_stack(
        [np.ones(len(means))]
        + [times * np.array([degree == one for one in degrees]) for degree in named]
    )
    weight = 1 / variances
    scale = np.maximum(np.sqrt((design**2 * weight[:, None]).sum(axis=0)), 1e-30)
    normal = design.T @ (design * weight[:, None]) / np.outer(scale, scale)
    covariance = np.linalg.pinv(normal) / np.outer(scale, scale)
    found = covariance @ (design.T @ (weight * means))
    squares = float(np.sum(weight * (means - design @ found) ** 2))
    rates = {
        degree: (float(found[1 + index]), math.sqrt(covariance[1 + index, 1 + index]))
        for index, degree in enumerate(named)
        if max(by_degree[degree]) > 0
    }
    chance = chance_of(squares, len(means) - len(found))
    return DarkLine(
        float(found[0]),
        float(covariance[0, 0]),
        rates,
        times,
        means,
        np.sqrt(variances),
        degrees,
        chance,
        True,
    )


def _finite(value):
    return value if math.isfinite(value) else 1.0


@dataclass(frozen=True)
class Drift:
    """Change of the black level from frame to frame.

    Args:
        slope: Per frame [DN].
        chance: Probability of a scatter of the frames' means at least as large without drift.
        scatter: Standard deviation of the frames' means [DN].
        expected: Standard deviation that noise explains [DN].
    """

    slope: Range
    chance: float
    scatter: float
    expected: float


def find_drift(level: Level, line_error: float) -> Drift | None:
    """Compare the means of dark frames with the noise; None for fewer than 3 frames."""
    if level.count < 3:
        return None
    means = level.frame_means.mean(axis=1)
    pixels = _finite(pool_channels(level).mean_variance) * level.count
    expected = pixels + line_error
    order = np.arange(level.count) - (level.count - 1) / 2
    slope = float(order @ means / np.sum(order**2))
    error = math.sqrt(expected / np.sum(order**2))
    squares = float(np.sum((means - means.mean()) ** 2) / expected)
    chance = min(chance_of(squares, level.count - 1), chance_of_normal(slope / error)) * 2
    return Drift(
        normal_range(slope, error), min(chance, 1.0), float(means.std(ddof=1)), math.sqrt(expected)
    )


def fit_doubling(rates: dict) -> tuple[Range, float, float] | None:
    """Return the doubling temperature [K] with its interval, and the rate at a middle temperature.

    Args:
        rates: Dark signal and its error by temperature [deg C].

    Returns:
        Doubling, reference temperature [deg C], and the dark signal there in the rates' unit; None
        with fewer than two temperatures with a significant rate.
    """
    known = {
        degree: pair
        for degree, pair in rates.items()
        if degree is not None and pair[0] > 3 * pair[1] > 0
    }
    if len(known) < 2:
        return None
    degrees = np.array(sorted(known))
    values = np.array([known[degree][0] for degree in degrees])
    errors = np.array([known[degree][1] for degree in degrees]) / values
    weight = 1 / errors**2
    middle = float(weight @ degrees / weight.sum())
    x, y = degrees - middle, np.log2(values)
    slope = float((weight * x) @ y / (weight @ x**2))
    error = float((weight @ x**2) ** -0.5) / math.log(2)
    if slope <= 0:
        return None
    reference = float(degrees[np.argmin(np.abs(x))])
    rate = 2 ** (float(weight @ y / weight.sum()) + slope * (reference - middle))
    low, high = slope - 1.96 * error, slope + 1.96 * error
    doubling = Range(1 / slope, 1 / high, 1 / low if low > 0 else math.inf)
    return doubling, reference, rate


SURE = 3.0  # standard errors by which more pixels must lie above the others than below


@dataclass(frozen=True)
class Hot:
    """Pixels with additional dark current.

    Args:
        count: Pixels above the threshold, less those as far below.
        threshold: [DN/s].
        share: Share of pixels with additional dark current, from an exponential distribution.
        scale: Its mean [DN/s].
    """

    count: int
    threshold: float
    share: Range
    scale: Range


def find_hot(excess: np.ndarray, hot: np.ndarray, seconds: float) -> Hot | None:
    """Return the hot pixels' share and mean dark current; None if there are fewer than 5.

    An exponential distribution has no memory: the excess over any threshold has the same mean. Pixels with telegraph
    noise are as often far below the others as above: the lower ones are taken off.

    Args:
        excess: Dark signal between two exposure times, less its median [DN].
        hot: Pixels that are far from the others.
        seconds: Difference of the exposure times [s].
    """
    values = excess[hot] / seconds
    above, below = values[values > 0], -values[values < 0]
    count, seen = len(above) - len(below), len(values)
    if count < max(5, SURE * math.sqrt(seen)):
        return None
    threshold = float(above.min())
    scale = max(float(above.sum() - below.sum()) / count - threshold, 1e-9)
    share = count / excess.size * math.exp(threshold / scale)
    spread = math.sqrt(seen) / count
    relative = spread * math.hypot(1, threshold / scale)
    return Hot(
        count,
        threshold,
        normal_range(share, share * relative),
        normal_range(scale, scale * spread),
    )


def find_restless(stack: FrameStack) -> tuple[np.ndarray, float]:
    """Return pixels whose temporal variance is too large for noise, and their mean jump [DN].

    Args:
        stack: Dark frames.
    """
    import scipy.special

    variance = stack.squares / np.float32(stack.freedom)
    middle = float(np.median(variance[::3, ::3]))
    freedom = stack.freedom
    # the median of a mean square lies below its expectation
    typical = middle * freedom / (2 * scipy.special.gammaincinv(freedom / 2, 0.5))
    limit = 2 * scipy.special.gammainccinv(freedom / 2, RESTLESS) / freedom * max(typical, 0.05)
    found = variance > 1.5 * limit
    # a pixel that jumps by J has offsets up to J and a variance near J^2 / 4; a hot one has far less
    offset = stack.mean - np.median(stack.mean[::3, ::3])
    found &= variance - typical > JUMP * offset**2
    excess = variance[found] - typical
    jump = float(np.mean(2 * np.sqrt(np.maximum(excess, 0)))) if found.any() else 0.0
    return found, jump
