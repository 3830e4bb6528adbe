"""Variance behind rounded numbers."""

import numpy as np

FINE = 0.45  # [DN] noise above which rounding adds 1/12 DN^2, within 1e-3 of the variance
HARMONICS = np.arange(1, 40)


def rounded_variance(deviation: float) -> float:
    """Return the mean temporal variance of rounded values whose means are spread over whole steps.

    Bennett's rounding error has the Fourier series sum (-1)^k / (pi k) sin(2 pi k x). Averaged over
    means, the variance of a pixel is s^2 + 1/12 less the variance of the error's mean.

    Args:
        deviation: Standard deviation s before rounding [DN].

    Returns:
        Variance [DN^2].

    Source:
        Bennett, "Spectra of quantized signals", Bell Syst. Tech. J. 27 (1948), 446.
    """
    damping = np.exp(-4 * np.pi**2 * HARMONICS**2 * deviation**2)
    common = float(np.sum(damping / (2 * np.pi**2 * HARMONICS**2)))
    least = float(np.sum(1 / (2 * np.pi**2 * HARMONICS**2)))
    return max(deviation**2 + (1 / 12 - least) + (least - common), 0.0)


_DEVIATIONS = np.linspace(0, 1, 1001)
_VARIANCES = np.array([rounded_variance(one) for one in _DEVIATIONS])


def before_rounding(variance: float, lines: float = 0.0) -> float:
    """Return the variance of pixels before rounding, from the variance of rounded ones [DN^2].

    Args:
        variance: Temporal variance of pixels, without rows and columns.
        lines: Temporal variance of rows and columns, which also moves values over the steps.

    Returns:
        Variance [DN^2].
    """
    total = variance + lines
    if total >= _VARIANCES[-1]:
        return variance - 1 / 12
    return float(np.interp(total, _VARIANCES, _DEVIATIONS)) ** 2 - lines


def rounding_bias(deviation: float) -> float:
    """Return the largest error of a mean of rounded numbers [DN].

    Args:
        deviation: Standard deviation of the averaged values, over frames and pixels [DN].
    """
    return float(np.exp(-2 * np.pi**2 * deviation**2) / np.pi)
