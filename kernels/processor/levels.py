"""Digital numbers on their way through the processor: their noise, and the scale of corrected mosaics."""

import math

from gpusim.domain.errors import OutOfRange

# A mosaic that was shaded or denoised: black at CORRECTED_BLACK, so that noise below black survives, white at the top.
CORRECTED_BLACK, CORRECTED_WHITE = 4096, 65535


def check_noise(noise) -> tuple[float, float]:
    """Return (gain [DN/e-], read noise [DN]) as numbers: variance [DN^2] = gain (DN - black) + read^2.

    Raises OutOfRange unless both are finite and not negative.
    """
    try:
        gain, read = map(float, noise)
    except (TypeError, ValueError):
        gain = read = math.nan
    if not (0 <= gain < math.inf and 0 <= read < math.inf):
        raise OutOfRange("noise", noise, "(gain [DN/e-], read noise [DN]), both finite and >= 0")
    return gain, read


def check_black(black_level):
    """Refuse a black level [DN] that is none. Raises OutOfRange."""
    if not abs(black_level) < 2**24:
        raise OutOfRange("black_level", black_level, "a finite number below 2^24 DN")
