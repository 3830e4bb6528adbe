"""Spectral responses of channels that agree with the colour matrices of a camera.

A matrix has nine numbers and a response at 31 wavelengths 93: typical curves decide the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.data.colorimetry import xyz
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.spectrum import Spectrum, photons_from_energy

NODES = np.arange(400.0, 701.0, 10.0)  # [nm], as the measured surfaces
TRAINING = "objects"
PEAK = 0.55  # [e-/photon] of the most sensitive channel: back-illuminated sensors have 0.5 .. 0.7
NEARNESS, SMOOTHNESS = 3e-3, 1e-2  # weights of typical curves and of second differences
PASSES = 3  # a matrix has any scale, which the last pass's responses give


@dataclass(frozen=True)
class Matrix:
    """A measured colour matrix.

    Attributes:
        light: Name of the light of the measurement.
        values: From XYZ to the channels R, G, B, up to a factor, (3, 3).
        seen_in: Name of the light in which XYZ counts; the light of the measurement, unless the matrix
            was made for adapted colours.
    """

    light: str
    values: np.ndarray
    seen_in: str


@dataclass(frozen=True)
class Response:
    """Responses of the channels R, G, B.

    Attributes:
        qe: Quantum efficiencies at NODES [e-/photon], (3, 31).
        error: Root mean square difference from the matrices over surfaces, of white's green.
    """

    qe: np.ndarray
    error: float


def typical_response() -> np.ndarray:
    """Return curves of a Bayer sensor behind an infrared cut [e-/photon], (3, 31)."""
    sensor, cut = curve("mt9v024"), curve("ir-cut-phone")
    return sensor.at(NODES)[:3] * cut.at(NODES)


def fit_response(matrices: Sequence[Matrix]) -> Response:
    """Return responses that give the colours of matrices, near typical ones.

    Least squares over surfaces without negative values: differences from the matrices, from the
    typical curves and from smoothness.

    Args:
        matrices: Of one camera, in one light or several.

    Returns:
        The responses, the highest PEAK.
    """
    surfaces = reflectances(TRAINING)
    typical = typical_response()
    seen = [_photons(matrix.light) * surfaces.at(NODES) for matrix in matrices]  # (N, 31) each
    wanted = [_see(matrix, surfaces) for matrix in matrices]  # (N, 3)
    white = [_photons(matrix.light) for matrix in matrices]
    fitted = typical
    for _ in range(PASSES):
        targets = [
            own * (light @ fitted[1]) for own, light in zip(wanted, white, strict=True)
        ]  # white's green as now
        sizes = _sizes(targets, fitted, white)
        near = typical * sizes[:, None]
        fitted = _solve(seen, targets, near)
    rest = [
        (view @ fitted.T - target) / (light @ fitted[1])
        for view, target, light in zip(seen, targets, white, strict=True)
    ]
    error = float(np.sqrt(np.mean(np.square(rest))))
    return Response(fitted * (PEAK / fitted.max()), error)


def _photons(light):
    """Return the photons of a light at NODES, the sum 1."""
    photons = photons_from_energy(illuminant(light)).at(NODES)
    return photons / photons.sum()


def _see(matrix, surfaces):
    """Return a matrix's channels for surfaces, relative to white's green, (N, 3)."""
    light = illuminant(matrix.seen_in)
    every = Spectrum(NODES, np.vstack([np.ones(len(NODES)), surfaces.at(NODES)]))
    colors = xyz(every, light) @ matrix.values.T
    return colors[1:] / colors[0, 1]


def _sizes(targets, fitted, white):
    """Return the mean of each channel's target over the typical response's, (3,)."""
    typical = typical_response()
    mean = np.mean([target.mean(axis=0) / target[:, 1].mean() for target in targets], axis=0)
    green = np.mean([light @ fitted[1] for light in white])
    own = np.mean([typical @ light for light in white], axis=0)
    return mean * green / own


def _solve(seen, targets, near):
    """Return the least squares responses >= 0, (3, 31)."""
    from scipy.optimize import nnls

    curves, count = [], len(NODES)
    second = np.diff(np.eye(count), 2, axis=0)
    for channel in range(3):
        scale = near[channel].mean()
        weight = 1 / np.sqrt(sum(map(len, seen)))
        rows = np.vstack(
            [view * weight for view in seen]
            + [np.eye(count) * NEARNESS / count**0.5, second * SMOOTHNESS / count**0.5]
        )
        right = np.concatenate(
            [target[:, channel] * weight / scale for target in targets]
            + [near[channel] / scale * NEARNESS / count**0.5, np.zeros(len(second))]
        )
        curves.append(nnls(rows, right)[0] * scale)
    return np.array(curves)
