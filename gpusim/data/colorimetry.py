"""CIE 1931 colorimetry: from spectra to tristimulus values and luminance."""

import functools
from pathlib import Path

import numpy as np

from gpusim.domain.spectrum import Spectrum

HERE = Path(__file__).parent

LUMINOUS_EFFICACY = 683.0  # [lm W-1], CIE 15:2018

# XYZ to the cone-like primaries of CIECAM97s, in which the white is adapted (Lam 1985; Lindbloom's digits).
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


@functools.cache
def tables(name: str) -> dict[str, np.ndarray]:
    """Return the arrays of a table of this package, such as "cie"; read once."""
    with np.load(HERE / f"{name}.npz") as stored:
        return dict(stored)


@functools.cache
def cmf() -> Spectrum:
    """CIE 1931 2-degree colour matching functions x, y, z at 360, 361 .. 830 nm; shape (3, 471)."""
    table = tables("cie")
    return Spectrum(table["cmf_wavelengths"], table["cmf"], "CIE 1931")


def xyz(spectrum: Spectrum, light: Spectrum | None = None) -> np.ndarray:
    """Tristimulus values of spectra in energy units, shape (..., 3).

    spectrum: radiance [W m-2 sr-1 nm-1], then Y is the luminance [cd m-2]; or reflectance [1] with the radiance of
        white in `light`. Nothing is assumed outside a table: it counts as zero there.
    The integral is exact for the tables: between the nodes of all three the product is a cubic polynomial, which
    Simpson's rule integrates without error.
    """
    factors = [cmf(), spectrum, *([light] if light else [])]
    nodes = np.unique(np.concatenate([factor.wavelengths for factor in factors]))
    low = max(factor.wavelengths[0] for factor in factors)
    high = min(factor.wavelengths[-1] for factor in factors)
    nodes = nodes[(nodes >= low) & (nodes <= high)]
    if len(nodes) < 2:
        return np.zeros((*spectrum.values.shape[:-1], 3))
    steps = np.diff(nodes)
    weights = np.zeros(
        2 * len(nodes) - 1
    )  # Simpson's weights on the nodes and the middles between them
    weights[1::2] = 4 * steps / 6
    weights[:-1:2] += steps / 6
    weights[2::2] += steps / 6
    points = np.empty(len(weights))
    points[::2], points[1::2] = nodes, nodes[:-1] + steps / 2
    if light:
        weights = weights * light.at(points)
    return LUMINOUS_EFFICACY * (spectrum.at(points) * weights) @ cmf().at(points).T


def adaptation(white, to):
    """Matrix (3, 3) that takes XYZ `white` to the white `to`, scaling cone-like responses."""
    return np.linalg.solve(BRADFORD, ((BRADFORD @ to) / (BRADFORD @ white))[:, None] * BRADFORD)
