"""Digital numbers inside the processor: their noise, and the scale of corrected mosaics."""

import functools
import math

import numpy as np

from gpusim.domain.errors import OutOfRange, check_known

# A mosaic that was shaded or denoised: black at CORRECTED_BLACK, to keep noise below black
CORRECTED_BLACK, CORRECTED_WHITE = 4096, 65535
MOST_BALANCE = 64  # between channels: a channel with less response to white shows only noise


def check_noise(noise) -> tuple[float, float]:
    """Return (gain [DN/e-], read noise [DN]) as numbers.

    The variance [DN^2] is gain (DN - black) + read^2. Raise OutOfRange unless both are finite and
    not negative.
    """
    try:
        gain, read = map(float, noise)
    except (TypeError, ValueError):
        gain = read = math.nan
    if not (0 <= gain < math.inf and 0 <= read < math.inf):
        raise OutOfRange("noise", noise, "(gain [DN/e-], read noise [DN]), both finite and >= 0")
    return gain, read


def check_black(black_level):
    """Raise OutOfRange if the black level [DN] is not a finite number below 2^24."""
    if not abs(black_level) < 2**24:
        raise OutOfRange("black_level", black_level, "a finite number below 2^24 DN")


def check_balance(balance) -> tuple[float, float]:
    """Return the white balance factors of red and blue as numbers. Raise OutOfRange."""
    try:
        red, blue = map(float, balance)
    except (TypeError, ValueError):
        red = blue = math.nan
    if not (1 / MOST_BALANCE <= red <= MOST_BALANCE and 1 / MOST_BALANCE <= blue <= MOST_BALANCE):
        raise OutOfRange(
            "balance", balance, f"two factors (red, blue), 1 / {MOST_BALANCE} .. {MOST_BALANCE}"
        )
    return red, blue


def check_balances(balance, channels) -> tuple[tuple[str, float], ...]:
    """Return (letter, white balance factor) of channels. Raise OutOfRange, or UnknownName for a letter."""
    for letter, factor in balance.items():
        check_known("balance", letter, channels)
        if not 1 / MOST_BALANCE <= factor <= MOST_BALANCE:
            raise OutOfRange(
                f"balance of {letter}", factor, f"1 / {MOST_BALANCE} .. {MOST_BALANCE}"
            )
    return tuple((letter, float(factor)) for letter, factor in balance.items())


@functools.lru_cache(maxsize=64)
def root_loss(gain: float, read: float) -> np.ndarray:
    """Return the mean minus the square of a mean root, as a polynomial.

    With m the mean of u over many x of mean mu, u = sgn(y) sqrt|y| and y = x + 3/8 gain + read^2 /
    gain,

        mu = m^2 - 3/8 gain - read^2 / gain + a0 + a1 t + .. + a4 t^4,   t = min(1, far / (near + m^2)).

    The polynomial is gain / 4 in the light (Anscombe 1948). It differs in the dark: roots of a few
    electrons, or of values near and below 0, are far from a straight line (Makitalo and Foi 2013,
    IEEE Trans. Image Processing 22, 91, have such an inverse for photons without read noise). It is
    fitted by least squares to sums over the Poisson and Gaussian distributions, and is within gain
    / 50 everywhere and .1 % of mu from gain / 2 on. A mean that keeps the part S of the variance
    lacks 1 - S of it.

    Args:
        gain: Gain > 0, in the unit of x, whose variance is gain x + read^2.
        read: Read noise, in the unit of x.

    Returns:
        near, far, a4 .. a0, shape (7,), float32.
    """
    sigma = read / gain
    mean = np.append(0.0, np.geomspace(0.03, 200.0, 80))
    root = _mean_root(mean, sigma)
    lack = mean + 0.375 + sigma**2 - root**2
    far = 1 + root[0] ** 2
    weight = 1 / np.maximum(mean, 0.2)[:, None]
    powers = np.vander(far / (1 + root**2), 5)
    fitted = np.linalg.lstsq(powers * weight, lack * weight[:, 0], rcond=None)[0]
    return np.append(np.array((gain, far * gain)), fitted * gain).astype(np.float32)


def _mean_root(mean, sigma):
    """Return the mean of sgn(y) sqrt|y|, y = k + z + 3/8 + sigma^2, in the shape of `mean`.

    k is Poisson with these means, z Gaussian with standard deviation sigma.
    """
    from scipy.special import gammaln

    count = np.arange(400)
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = np.exp(
            np.where(count == 0, 0.0, count * np.log(mean)[:, None])
            - mean[:, None]
            - gammaln(count + 1)
        )
    place = np.linspace(-6, 6, 193)
    normal = np.exp(-(place**2) / 2)
    y = count[:, None] + sigma * place + 0.375 + sigma**2
    return chance @ (np.copysign(np.sqrt(np.abs(y)), y) @ normal / normal.sum())
