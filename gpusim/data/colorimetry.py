"""CIE 1931 colorimetry: from spectra to tristimulus values and luminance."""

import functools
from pathlib import Path

import numpy as np

from gpusim.domain.spectrum import Spectrum

HERE = Path(__file__).parent

LUMINOUS_EFFICACY = 683.0  # [lm W-1], CIE 15:2018

# From XYZ to the cone-like primaries of CIECAM97s, for adaptation to a white (Lam 1985; Lindbloom's
# digits).
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


@functools.cache
def tables(name: str) -> dict[str, np.ndarray]:
    """Return the arrays of a table of this package, for example "cie"; read once."""
    with np.load(HERE / f"{name}.npz") as stored:
        return dict(stored)


@functools.cache
def cmf() -> Spectrum:
    """Return the CIE 1931 2-degree colour matching functions at 360, 361 .. 830 nm, (3, 471)."""
    table = tables("cie")
    return Spectrum(table["cmf_wavelengths"], table["cmf"], "CIE 1931")


def xyz(spectrum: Spectrum, light: Spectrum | None = None) -> np.ndarray:
    """Return tristimulus values of spectra in energy units.

    The integral is exact for the tables: between the nodes of all three the product is a cubic
    polynomial, which Simpson's rule integrates without error. Spectra count as zero outside their
    tables.

    Args:
        spectrum: Radiance [W m-2 sr-1 nm-1]; or reflectance [1] if `light` is given.
        light: Radiance of white for a reflectance.

    Returns:
        XYZ, shape (..., 3); Y is the luminance [cd m-2].
    """
    axes = [factor.wavelengths for factor in (cmf(), spectrum, light) if factor is not None]
    nodes = np.unique(np.concatenate(axes))
    low = max(axis[0] for axis in axes)
    high = min(axis[-1] for axis in axes)
    nodes = nodes[(nodes >= low) & (nodes <= high)]
    if len(nodes) < 2:
        return np.zeros((*spectrum.values.shape[:-1], 3))
    steps = np.diff(nodes)
    # Simpson's weights of the nodes and of the points halfway between them
    weights = np.zeros(2 * len(nodes) - 1)
    weights[1::2] = 4 * steps / 6
    weights[:-1:2] += steps / 6
    weights[2::2] += steps / 6
    points = np.empty(len(weights))
    points[::2], points[1::2] = nodes, nodes[:-1] + steps / 2
    if light:
        weights = weights * light.at(points)
    return LUMINOUS_EFFICACY * (spectrum.at(points) * weights) @ cmf().at(points).T


def adaptation(white, to):
    """Return the matrix (3, 3) that maps XYZ `white` to `to` by scaling cone-like responses."""
    return np.linalg.solve(BRADFORD, ((BRADFORD @ to) / (BRADFORD @ white))[:, None] * BRADFORD)
