"""Photon transfer of one ISO speed: gain, noise without light, saturation, linearity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.fit.intervals import (
    Line,
    Range,
    Z,
    chance_of_normal,
    fit_line,
    fit_polynomial,
    normal_range,
    root_of,
    widened_by_misfit,
)
from gpusim.fit.levels import Level
from gpusim.fit.rounding import before_rounding

COLLAPSED = 0.6  # part of the expected variance below which a level is saturated
SIGNIFICANT = 5.0  # standard errors of a gain that is one
BRIGHT = 0.01  # part of the largest signal that has light
CLIPPED = 1e-3  # share of pixels at the largest value of all frames
SHOOT_FLATS = "shoot pairs of evenly lit frames from a tenth to nine tenths of saturation, and one pair beyond it"


@dataclass(frozen=True, eq=False)
class Transfer:
    """The photon transfer line of one ISO speed.

    Args:
        line: Variance [DN^2] over signal above black [DN].
        by_channel: Lines of single channels by letter.
        signal, variance, errors: Points of the line: signal, variance, standard error.
        letters: Letter of each point, "" for dark frames.
        curvature: Coefficient of the squared signal [1/DN], and its standard error.
        saturation: Mean of saturated pixels by letter [DN], or None.
        is_converter: Whether saturated pixels have the largest number of the converter.
        white: Largest value [DN], if it was reached.
    """

    line: Line
    by_channel: dict[str, Line]
    signal: np.ndarray
    variance: np.ndarray
    errors: np.ndarray
    letters: list[str]
    curvature: tuple[float, float]
    saturation: dict[str, float]
    is_converter: bool
    white: float | None

    @property
    def gain(self) -> Range:
        """System gain [DN/e-]."""
        return normal_range(self.line.slope, self.gain_error)

    @property
    def gains(self) -> tuple[float, float]:
        """Smallest and largest slope from no light to a level with light [DN/e-]."""
        bright = self.signal > BRIGHT * self.signal.max()
        slopes = (self.variance - self.line.offset)[bright] / self.signal[bright]
        return float(slopes.min()), float(slopes.max())

    @property
    def gain_error(self) -> float:
        """Standard error of the gain [DN/e-]."""
        return math.sqrt(self.line.covariance[1, 1])

    @property
    def read(self) -> Range:
        """Noise of a read without signal [e-], with its interval."""
        return read_of(self.line)


def read_of(line: Line) -> Range:
    """Return the noise without signal [e-] of a photon transfer line, with its interval."""
    offset, gain = line.offset, line.slope
    slopes = np.array([1 / gain**2, -2 * offset / gain**3])
    error = math.sqrt(max(float(slopes @ line.covariance @ slopes), 0.0))
    return root_of(normal_range(offset / gain**2, error))


def find_clipping(flats: Sequence[Level], darks: Sequence[Level], white: float | None) -> None:
    """Fill `clipped` of each flat: letters whose pixels are saturated, wholly or in part.

    Args:
        flats: Levels with light.
        darks: Levels without.
        white: Largest value that the files state [DN], or None.
    """
    top = max(level.highest for level in (*flats, *darks))
    letters = flats[0].points.keys()
    for letter in letters:
        dark = min((level.points[letter] for level in darks), key=lambda point: point.mean)
        ordered = sorted(flats, key=lambda level: level.points[letter].mean)
        slopes = [_slope(level.points[letter], dark) for level in ordered]
        best, limit = 0.0, math.inf
        for level, slope in zip(ordered, slopes, strict=True):
            point = level.points[letter]
            is_at_top = level.highest == top and level.at_highest > CLIPPED
            share = 1.0 if len(letters) == 1 else 1 / 16  # of the pixels that are a channel's
            is_top = (
                is_at_top and point.brightest > top - 0.5 and level.at_highest > CLIPPED * share
            )
            collapsed = best > 0 and slope < COLLAPSED * best
            if is_top or collapsed:
                level.clipped.add(letter)
                limit = min(limit, point.mean - 4 * math.sqrt(max(point.variance, 0.1)))
            elif math.isfinite(slope):
                best = slope if best == 0 else max(best, slope)
        ceiling = white if white is not None else math.inf
        saturated = [one.points[letter] for one in ordered if letter in one.clipped]
        if saturated:
            most = max(saturated, key=lambda point: point.mean)
            ceiling = min(ceiling, most.mean - 5 * math.sqrt(max(most.variance, 0.1)))
        for level in ordered:
            point = level.points[letter]
            reach = point.brightest + 5 * math.sqrt(max(point.variance, 0.1))
            if reach > ceiling:
                level.clipped.add(letter)


def _slope(point, dark):
    """Return variance over signal of a point above the dark one, 0 without signal."""
    signal = point.mean - dark.mean
    if signal < 8 * math.sqrt(max(dark.variance, 0.1)):
        return math.inf
    return (point.variance - min(dark.variance, point.variance)) / signal


def fit_transfer(
    flats: Sequence[Level],
    darks: Sequence[Level],
    black: float,
    lines: float,
    is_whole: bool,
    line_error: float,
    spread: float,
    advice: str = SHOOT_FLATS,
) -> Transfer:
    """Fit the photon transfer line through dark frames and flats that are not clipped.

    Args:
        flats: Levels with light, with `clipped`.
        darks: Levels without.
        black: Black level [DN].
        lines: Variance that rows and columns have in common [DN^2].
        is_whole: Whether values are rounded to whole numbers.
        line_error: Variance of a frame's mean from rows and columns [DN^2].
        spread: Spatial variance of dark pixels [DN^2].
        advice: Shots to take if the line cannot be fitted.

    Returns:
        The line; errors are from the statistics of the points.

    Raises:
        BadData: All flats are clipped, or the variance does not rise with the light.

    Source:
        Janesick, "Photon Transfer" (2007); EMVA Standard 1288.
    """
    used = [
        (point, level, letter)
        for level in flats
        for letter, point in level.points.items()
        if letter not in level.clipped and level.count > 1
    ]
    if not used:
        names = ", ".join(flats[0].names[:2]) if flats else ""
        raise BadData(f"all flats are clipped or single frames ({names} ...): {SHOOT_FLATS}")
    used += [(pool_channels(level), level, "") for level in darks if level.count > 1]
    signal = np.array([point.mean - black for point, _, _ in used])
    variance = np.array([_unrounded(point.variance, lines, is_whole) for point, _, _ in used])
    relative = np.array(
        [point.variance_variance / max(point.variance, 1e-9) ** 2 for point, _, _ in used]
    )
    means = np.array([point.mean_variance + line_error / level.count for point, level, _ in used])
    rounding = 1 / 12 if is_whole else 0.0
    fitted, errors = variance, np.ones(len(used))
    for _ in range(4):
        total = np.maximum(fitted + rounding, 0.02)
        slope = max((fitted.max() - fitted.min()) / max(np.ptp(signal), 1e-9), 0.0)
        errors = np.sqrt(relative * total**2 + slope**2 * means)
        line = fit_line(signal, variance, errors**2)
        fitted = np.maximum(line.at(signal), 1e-6)
    if not line.slope > SIGNIFICANT * math.sqrt(line.covariance[1, 1]):
        raise BadData(
            f"the noise does not rise with the light ({used[0][1].names[0]}): the light is too even, or the "
            f"frames are clipped, averaged or denoised; {advice}"
        )
    letters = [letter for _, _, letter in used]
    curvature = (0.0, math.inf)
    if len(used) >= 4:
        coefficients, covariance, _ = fit_polynomial(signal, variance, errors**2, 2)
        curvature = float(coefficients[2]), math.sqrt(covariance[2, 2])
    saturation, is_converter, white = _saturation(
        flats, math.sqrt(max(_dark_variance(darks) + lines + spread, 0.0))
    )
    return Transfer(
        widened_by_misfit(line),
        _channel_lines(signal, variance, errors, letters),
        signal,
        variance,
        errors,
        letters,
        curvature,
        saturation,
        is_converter,
        white,
    )


def pool_channels(level):
    """Return the point of all channels of a dark level."""
    from gpusim.fit.levels import Point

    points = level.points.values()
    weights = np.array([1 / max(point.variance_variance, 1e-30) for point in points])
    weights /= weights.sum()
    counts = np.array([1 / max(point.mean_variance, 1e-30) for point in points])
    counts /= counts.sum()
    return Point(
        float(counts @ [point.mean for point in points]),
        float(counts**2 @ [point.mean_variance for point in points]),
        float(weights @ [point.variance for point in points]),
        float(weights**2 @ [point.variance_variance for point in points]),
        max(point.brightest for point in points),
        float(np.mean([point.middle for point in points])),
    )


def _dark_variance(darks):
    return min((pool_channels(level).variance for level in darks if level.count > 1), default=0.0)


def _unrounded(variance, lines, is_whole):
    return before_rounding(variance, lines) if is_whole else variance


def _channel_lines(signal, variance, errors, letters):
    """Return the lines of single channels, which share the dark frames."""
    found = {}
    named = [letter for letter in dict.fromkeys(letters) if letter]
    for letter in named if len(named) > 1 else []:
        chosen = np.array([one in (letter, "") for one in letters])
        if letters.count(letter) >= 1 and chosen.sum() >= 2:
            found[letter] = fit_line(signal[chosen], variance[chosen], errors[chosen] ** 2)
    return found


def _saturation(flats, noise):
    """Return means of saturated pixels by letter, whether the converter limits them, and its limit."""
    top = max((level.highest for level in flats), default=0.0)
    found, is_converter = {}, False
    for level in flats:
        for letter in level.clipped:
            point = level.points[letter]
            others = [one.points[letter].mean for one in flats if letter not in one.clipped]
            if others and point.mean <= max(others):
                continue
            if point.variance > 4 * noise**2 + 1:  # only some of the pixels are saturated
                continue
            found[letter] = max(found.get(letter, 0.0), point.middle)
    if found:
        share = max(level.at_highest for level in flats if level.highest == top)
        is_converter = share > 0.5 / max(len(flats[0].points), 1)
    return found, is_converter, top if is_converter else None


@dataclass(frozen=True, eq=False)
class Linearity:
    """Signal over exposure.

    Args:
        exposure, signal, fitted, errors: Points: exposure [s or photon], signal [DN], the line's
            signal, standard error.
        letters: Letter of each point.
        nonlinearity: Largest deviation from lines, relative to the largest signal [%].
        chance: Probability of a curvature at least as large if the response is linear.
        unit: Unit of the exposure.
    """

    exposure: np.ndarray
    signal: np.ndarray
    fitted: np.ndarray
    errors: np.ndarray
    letters: list[str]
    nonlinearity: Range
    chance: float
    unit: str


def fit_linearity(flats: Sequence[Level], black: float, line_error: float) -> Linearity | None:
    """Fit signal over exposure for each channel and test its curvature.

    Args:
        flats: Levels with light, with `clipped`.
        black: Black level [DN].
        line_error: Variance of a frame's mean from rows and columns [DN^2].

    Returns:
        The fit, or None: fewer than four exposures, or the light was not the same for all.
    """
    unit = "photon" if all(level.photons for level in flats) else "s"
    flicker = _flicker(flats, line_error)
    rows: list[tuple] = []
    curvatures = []
    for letter in flats[0].points:
        points = [
            (level.photons or level.exposure_time, level.points[letter], level)
            for level in flats
            if letter not in level.clipped
            and level.count > 1
            and (level.photons or level.exposure_time)
        ]
        if len({exposure for exposure, _, _ in points}) < 4:
            return None
        x = np.array([exposure for exposure, _, _ in points])
        y = np.array([point.mean - black for _, point, _ in points])
        errors = np.sqrt(
            [
                point.mean_variance
                + (line_error + flicker * (point.mean - black) ** 2) / level.count
                for _, point, level in points
            ]
        )
        linear, _, _ = fit_polynomial(x, y, errors**2, 1)
        fitted = linear[0] + linear[1] * x
        if np.sqrt(np.mean((y / fitted - 1) ** 2)) > 0.3 or linear[1] <= 0:
            return None
        quadratic, covariance, _ = fit_polynomial(x, y, errors**2, 2)
        curvatures.append((quadratic[2], math.sqrt(covariance[2, 2]), np.ptp(x), y.max()))
        rows += zip(x, y, fitted, errors, [letter] * len(x), strict=True)
    bends = [(c * span**2 / 8 / top, e * span**2 / 8 / top) for c, e, span, top in curvatures]
    # light that flickers moves all channels together: Bonferroni's bound needs no independence
    freedom = max(len(flats) - 3, 1) if flicker else math.inf
    chances = [chance_of_normal(bend / error, freedom) for bend, error in bends]
    chance = min(1.0, len(bends) * min(chances))
    worst = max(bends, key=lambda one: abs(one[0]))
    columns = [list(column) for column in zip(*rows, strict=True)]
    return Linearity(
        np.array(columns[0]),
        np.array(columns[1]),
        np.array(columns[2]),
        np.array(columns[3]),
        columns[4],
        normal_range(100 * worst[0], 100 * worst[1]),
        chance,
        unit,
    )


def _flicker(flats, line_error):
    """Return the relative variance of the light between frames of one level, beyond noise."""
    found = []
    for level in flats:
        if level.count < 2 or level.clipped:
            continue
        totals = level.frame_means.mean(axis=1)
        signal = max(totals.mean(), 1.0)
        noise = sum(point.mean_variance for point in level.points.values()) * level.count
        noise = noise / len(level.points) ** 2 + line_error
        found.append((totals.var(ddof=1) - noise) / signal**2)
    return max(float(np.mean(found)), 0.0) if found else 0.0


def chance_of_curvature(transfer: Transfer) -> float:
    """Return the probability of a curvature of the variance at least as large if it is linear."""
    value, error = transfer.curvature
    return chance_of_normal(value / error) if math.isfinite(error) else 1.0


def chance_of_channels(transfer: Transfer) -> float:
    """Return the probability of gains of channels that differ as much if they are equal.

    Args:
        transfer: The photon transfer line.
    """
    if len(transfer.by_channel) < 2:
        return 1.0
    slopes = np.array([line.slope for line in transfer.by_channel.values()])
    errors = np.array([math.sqrt(line.covariance[1, 1]) for line in transfer.by_channel.values()])
    mean = float(np.sum(slopes / errors**2) / np.sum(1 / errors**2))
    chances = [chance_of_normal(z) for z in (slopes - mean) / errors]
    return min(1.0, len(chances) * min(chances))


def bounds_of(transfer: Transfer, darkest: float) -> tuple[Range, Range]:
    """Return bounds of an unknown black level [DN], and of the read noise [e-].

    The black level is below the darkest pixels, and not so low that the variance there is below 0. The
    value between keeps the variance of every signal.

    Args:
        transfer: Line over the signal above the darkest pixels.
        darkest: Mean of the darkest pixels [DN].
    """
    offset, gain = max(transfer.line.offset, 0.0), transfer.line.slope
    reach = offset / gain
    jacobian = np.array([1 / gain, -reach / gain])
    error = math.sqrt(max(float(jacobian @ transfer.line.covariance @ jacobian), 0.0))
    black = Range(darkest - reach / 2, darkest - reach - Z * error, darkest)
    largest = transfer.read.high
    return black, Range(math.sqrt(offset / 2) / gain, 0.0, largest)
