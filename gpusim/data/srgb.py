"""The sRGB colour space: its primaries as colours and as reflectances."""

import functools

import numpy as np

from gpusim.data.colorimetry import tables, xyz
from gpusim.data.lights import illuminant
from gpusim.domain.spectrum import Spectrum

# Chromaticities x, y of red, green and blue, IEC 61966-2-1.
SRGB_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])


@functools.cache
def srgb_to_xyz() -> np.ndarray:
    """Return the matrix from linear sRGB to XYZ, shape (3, 3), white Y = 1.

    White is the tabulated illuminant D65, not IEC 61966-2-1's rounded white point, so that a white reflectance in D65
    is RGB = (1, 1, 1) exactly; entries differ from the standard's four digits by up to 3e-4.
    """
    x, y = SRGB_PRIMARIES.T
    primaries = np.stack([x / y, np.ones(3), (1 - x - y) / y])
    white = xyz(illuminant("D65"))
    return primaries * np.linalg.solve(primaries, white / white[1])


@functools.cache
def srgb_primaries() -> Spectrum:
    """Return reflectances of the red, green and blue sRGB primaries in D65, shape (3, L); they add up to 1.

    Smooth and within 0 .. 1 (a cubic spline between the nodes overshoots by less than 0.01). The XYZ of that spline
    in illuminant D65 are the columns of `srgb_to_xyz`.
    Source: Mallett & Yuksel, "Spectral primary decomposition for rendering with sRGB reflectance", EGSR 2019.
    """
    table = tables("srgb")
    return Spectrum(table["wavelengths"], table["primaries"], "sRGB primaries")
