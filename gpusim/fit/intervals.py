"""Intervals of 95 % confidence for variances, their differences and their roots."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

CONFIDENCE = 0.95
Z = 1.959963984540054  # of a normal distribution, both sides of 95 %
MISFIT = 3e-4  # chance of residuals below which a line is not right


class MeanSquare(NamedTuple):
    """A mean square of normal numbers: its expectation is a variance, its distribution chi-square.

    Args:
        value: The mean square.
        freedom: Degrees of freedom.
    """

    value: float
    freedom: float

    def scaled(self, factor: float) -> "MeanSquare":
        """Return the mean square of numbers whose squares are `factor` times as large."""
        return MeanSquare(self.value * factor, self.freedom)


class Range(NamedTuple):
    """An estimate and the ends of its interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Range":
        """Return the range in another unit; `factor` is above 0."""
        return Range(self.value * factor, self.low * factor, self.high * factor)


def difference_of(first: MeanSquare, *others: MeanSquare) -> Range:
    """Return the interval of a variance that is a difference of expected mean squares.

    The modified large-sample interval: exact for one mean square, and near its confidence for
    differences.

    Args:
        first: The mean square that contains the wanted variance.
        others: Independent mean squares that are subtracted.

    Returns:
        Estimate and ends; below 0 if noise made them so.

    Source:
        Ting, Burdick, Graybill, Jeyaratnam and Lu, "Confidence intervals on linear combinations of
        variance components that are unrestricted in sign", J. Stat. Comput. Simul. 35 (1990), 135;
        without its small cross terms.
    """
    below, above = _reach(first)
    low, high = (first.value * below) ** 2, (first.value * above) ** 2
    value = first.value
    for other in others:
        below, above = _reach(other)
        value -= other.value
        low += (other.value * above) ** 2
        high += (other.value * below) ** 2
    return Range(value, value - math.sqrt(low), value + math.sqrt(high))


def _reach(square):
    """Return how far a variance may lie below and above its mean square, relative to it."""
    import scipy.special

    tail = (1 - CONFIDENCE) / 2
    freedom = max(square.freedom, 1e-9)
    upper, lower = (2 * scipy.special.gammaincinv(freedom / 2, p) for p in (1 - tail, tail))
    return 1 - freedom / upper, freedom / max(lower, 1e-300) - 1


def root_of(variance: Range) -> Range:
    """Return the standard deviation of a variance; 0 for negative ones."""
    return Range(*(math.sqrt(max(part, 0.0)) for part in variance))


def widened(root: Range, relative: float) -> Range:
    """Return a quotient's interval: a number's, widened by a divisor's relative error.

    Args:
        root: Estimate and ends.
        relative: Relative standard error of the divisor, independent of the estimate.
    """
    value, low, high = root
    more = Z * relative * value
    return Range(
        value,
        max(value - math.hypot(value - low, more), min(0.0, low)),
        value + math.hypot(high - value, more),
    )


def normal_range(value: float, error: float, bias: float = 0.0) -> Range:
    """Return the interval of a normal estimate.

    Args:
        value: The estimate.
        error: Its standard error.
        bias: Largest systematic error on either side.
    """
    half = Z * error + bias
    return Range(value, value - half, value + half)


class Line(NamedTuple):
    """A weighted line y = offset + slope x, with the covariances of its numbers.

    Args:
        offset, slope: The line.
        covariance: Of offset and slope, shape (2, 2).
        chi_square: Sum of squared residuals over their variances.
        freedom: Degrees of freedom.
    """

    offset: float
    slope: float
    covariance: np.ndarray
    chi_square: float
    freedom: int

    def at(self, x):
        """Return y at x."""
        return self.offset + self.slope * np.asarray(x)

    @property
    def chance(self) -> float:
        """Probability of residuals at least as large if the line is right."""
        return chance_of(self.chi_square, self.freedom)


def fit_polynomial(x, y, variance, degree: int):
    """Return the coefficients of a weighted polynomial, their covariance, and chi-square.

    Args:
        x: Points, shape (n,).
        y: Their values, shape (n,).
        variance: Of each y, shape (n,).
        degree: Of the polynomial.

    Returns:
        Coefficients from the constant up, covariances, and the sum of weighted squares.
    """
    powers = np.vander(np.asarray(x, np.float64), degree + 1, increasing=True)
    weight = 1 / np.asarray(variance, np.float64)
    normal = powers.T @ (powers * weight[:, None])
    scale = np.sqrt(np.diag(normal))
    covariance = np.linalg.pinv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    coefficients = covariance @ (powers.T @ (weight * y))
    residuals = y - powers @ coefficients
    return coefficients, covariance, float(np.sum(weight * residuals**2))


def fit_line(x, y, variance) -> Line:
    """Return the weighted line through points; see `fit_polynomial`."""
    (offset, slope), covariance, squares = fit_polynomial(x, y, variance, 1)
    return Line(float(offset), float(slope), covariance, squares, len(x) - 2)


def widened_by_misfit(line: Line) -> Line:
    """Return a line whose errors hold its misfit too, if residuals are larger than chance explains.

    Args:
        line: The line.

    Returns:
        It, with covariances times chi-square over its degrees of freedom if that is no chance.

    Source:
        Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40 (1932) 207.
    """
    if line.chance > MISFIT:
        return line
    return line._replace(covariance=line.covariance * line.chi_square / line.freedom)


def chance_of(chi_square: float, freedom: float) -> float:
    """Return the probability of at least this chi-square."""
    import scipy.special

    return float(scipy.special.gammaincc(freedom / 2, chi_square / 2)) if freedom > 0 else 1.0


def chance_of_normal(z: float, freedom: float = math.inf) -> float:
    """Return the probability of at least this deviation on either side.

    Args:
        z: Deviation in standard errors.
        freedom: Degrees of freedom of the standard error, for Student's distribution.
    """
    if math.isfinite(freedom):
        import scipy.special

        return float(2 * scipy.special.stdtr(freedom, -abs(z)))
    return math.erfc(abs(z) / math.sqrt(2))


def combine(values: Sequence[float], errors: Sequence[float]) -> tuple[float, float]:
    """Return the weighted mean of independent estimates, and its standard error."""
    weights = 1 / np.square(np.asarray(errors, np.float64))
    return float(np.sum(weights * values) / weights.sum()), float(weights.sum() ** -0.5)
