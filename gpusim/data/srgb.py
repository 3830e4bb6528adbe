"""The sRGB colour space: its primaries as colours and as reflectances."""

import functools

import numpy as np

from gpusim.data.colorimetry import BRADFORD, adaptation, tables, xyz
from gpusim.data.lights import illuminant
from gpusim.domain.display import DISPLAYS, xyz_of
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum

SRGB_PRIMARIES = np.array(DISPLAYS["srgb"].primaries)
CLOSE = 1e-5  # largest difference of equal chromaticities stored as float32
SEEN = 1e-4  # negative part over luminance that is only rounding of half floats


@functools.cache
def srgb_to_xyz() -> np.ndarray:
    """Return the matrix from linear sRGB to XYZ, shape (3, 3), with Y = 1 for white.

    White is the tabulated illuminant D65, not the rounded white point of IEC 61966-2-1: a white
    reflectance in D65 is then exactly RGB = (1, 1, 1). Entries differ from the standard's four
    digits by up to 3e-4.
    """
    primaries = xyz_of(SRGB_PRIMARIES)
    white = xyz(illuminant("D65"))
    return primaries * np.linalg.solve(primaries, white / white[1])


@functools.cache
def srgb_primaries() -> Spectrum:
    """Return reflectances of the red, green and blue sRGB primaries in D65, shape (3, L).

    They add up to 1, are smooth and within 0 .. 1 (a cubic spline between the nodes overshoots by
    less than 0.01). The XYZ of that spline in illuminant D65 are the columns of `srgb_to_xyz`.

    Source: Mallett & Yuksel, "Spectral primary decomposition for rendering with sRGB reflectance",
    EGSR 2019.
    """
    table = tables("srgb")
    return Spectrum(table["wavelengths"], table["primaries"], "sRGB primaries")


def srgb_from_rgb(chromaticities) -> np.ndarray | None:
    """Return the matrix from another linear RGB to linear sRGB, or None if they are the same.

    White is adapted (Bradford): (1, 1, 1) stays white. The axes of XYZ have no white, and are not
    adapted.

    Args:
        chromaticities: CIE 1931 (x, y) of red, green, blue and white, shape (4, 2).

    Returns:
        Matrix, shape (3, 3), or None.

    Raises:
        BadData: The chromaticities are not finite, or do not span a colour space.
    """
    given = np.asarray(chromaticities, np.float64)
    if np.abs(given - [*SRGB_PRIMARIES, DISPLAYS["srgb"].white]).max() < CLOSE:
        return None
    if not np.abs(given).max() <= 10 or not given[3, 1] > 0:  # NaN is refused as well
        raise BadData(
            f"chromaticities {given.tolist()}: wanted (x, y) of red, green, blue and white"
        )
    to_srgb = np.linalg.inv(srgb_to_xyz())
    if np.abs(given[:3] - [(1, 0), (0, 1), (0, 0)]).max() < CLOSE:
        return to_srgb
    columns = np.stack([*given.T, 1 - given.sum(axis=1)])
    primaries, white = columns[:, :3], columns[:, 3] / columns[1, 3]
    if abs(np.linalg.det(primaries)) < 1e-6 or not (BRADFORD @ white > 0).all():
        raise BadData(f"chromaticities {given.tolist()}: primaries on one line, or no white")
    return (
        to_srgb
        @ adaptation(white, srgb_to_xyz().sum(axis=1))
        @ (primaries * np.linalg.solve(primaries, white))
    )


def draw_into_srgb(linear: np.ndarray) -> float:
    """Move colours outside sRGB towards grey of the same luminance, in place.

    Afterwards no channel is negative. A colour without luminance becomes black.

    Args:
        linear: Linear sRGB, float32, shape (3, rows, cols).

    Returns:
        Fraction of samples that were outside by more than SEEN.
    """
    lowest = linear.min(axis=0)
    if lowest.min() >= 0:
        return 0.0
    luminance = np.maximum(np.einsum("i,ijk->jk", srgb_to_xyz()[1].astype(np.float32), linear), 0)
    share = float((lowest < -SEEN * luminance).mean())
    below = lowest < 0
    kept = np.divide(luminance, luminance - lowest, out=np.ones_like(luminance), where=below)
    for plane in linear:
        np.copyto(plane, np.maximum(luminance + kept * (plane - luminance), 0), where=below)
    return share
