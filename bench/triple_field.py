"""A camera whose blur varies over the field, at single pixels: the continuation of triple_brute.py.

The light of every sample is spread as at its own place, with the wavefront of Seidel there (Welford, chapter 7) and its
own lateral colour. Spreads are polynomials in the place, of degree NODES - 1 within NEAR samples of the pixel; what
comes from farther is spread as from there.
"""

import numpy as np
from triple_brute import (
    CLEAR,
    MODES,
    NEAREST,
    RINGS,
    Spread,
    apertured,
    chord_spread,
    energy_beyond,
    fine_grid,
    from_afar,
    spectra,
    spectral_weights,
)

from gpusim.domain.errors import OutOfRange

NODES, NEAR = 4, 24  # places along an axis, and how far they go [sample]
LEAST_Q = 0.7  # below, the sums over the pupil are too long


def seidel(coefficients, height, angle, scale):
    """Wavefront [waves] at a field point, as a function of the pupil's x and y; scale: of the wavelength."""
    _, coma, astigmatism, curvature, distortion = coefficients

    def waves(u, v):
        along, square = u * np.cos(angle) + v * np.sin(angle), u * u + v * v
        return scale * (coma * height * square * along + astigmatism * height**2 * along**2
                        + curvature * height**2 * square + distortion * height**3 * along)

    return waves


def kernels_at(scene, camera, pixel, band, reach) -> tuple[np.ndarray, np.ndarray]:
    """Kernels at NODES x NODES places around a pixel, shape (NODES, NODES, n, n), and the places [sample from it]."""
    optics, pitch = camera.optics, camera.sensor.pixel_pitch
    wavelength = scene.wavelengths[band]
    q, shape = wavelength * 1e-9 * optics.f_number / pitch, np.array(scene.shape)
    at, fine = fine_grid(q, reach)
    lateral = optics.lateral_color
    lateral = lateral if isinstance(lateral, float) else np.interp(wavelength, lateral.wavelengths, lateral.values)
    steps = NEAR * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    side = np.sqrt(camera.sensor.fill_factor)
    found = np.empty((NODES, NODES, 2 * reach + 1, 2 * reach + 1))
    for i, j in np.ndindex(NODES, NODES):
        place = np.clip(np.add(pixel, (steps[i], steps[j])), -scene.margin, shape - 1 + scene.margin)
        y, x = place - (shape - 1) / 2
        waves = seidel(optics.wavefront.seidel, np.hypot(y, x) / (np.hypot(*shape) / 2), np.arctan2(y, x),
                       CLEAR / wavelength)
        values = chord_spread(q, waves, at - lateral * y, at - lateral * x)
        found[i, j] = apertured(values, fine, reach, (side, side), (0.0, 0.0))
        if side < 1:  # as in triple_brute
            found[i, j] /= found[i, j].sum() + energy_beyond(Spread(q), reach)
    return found, steps


def electrons_at(scene, camera, seconds: float, pixels) -> np.ndarray:
    """Mean electrons at pixels (row, column) of a scene with one sample a pixel. Raises OutOfRange."""
    optics, margin = camera.optics, scene.margin
    q = scene.wavelengths * 1e-9 * optics.f_number / camera.sensor.pixel_pitch
    if q.min() < LEAST_Q:
        raise OutOfRange("q", f"{q.min():.2g}", f"{LEAST_Q:g} or more")
    reach = int(np.ceil(max(NEAREST, RINGS * q.max())))
    weights, cfa, out = spectral_weights(scene, camera), camera.sensor.cfa, np.zeros(len(pixels))
    slope = camera.sensor.pixel_pitch / optics.focal_length if optics.relative_illumination == "cos4" else 0.0
    for number, (row, col) in enumerate(pixels):
        share = weights[camera.sensor.channels.index(cfa[row % len(cfa)][col % len(cfa[0])])]
        afar = np.zeros((1, *scene.content.shape))
        for band in np.flatnonzero(np.abs(share) > 1e-6 * share.max()):
            plane = spectra(scene.content, band)
            afar += share[band] * q[band] * plane
            window = np.pad(plane, reach, mode=MODES[scene.border])[row + margin : row + margin + 2 * reach + 1,
                                                                    col + margin : col + margin + 2 * reach + 1]
            found, steps = kernels_at(scene, camera, (row, col), band, reach)
            at = np.clip(np.arange(-reach, reach + 1), -NEAR, NEAR)
            basis = np.linalg.solve(np.vander(steps).T, np.vander(at, NODES).T)  # Lagrange's, (NODES, places)
            out[number] += share[band] * np.einsum("yx,ijyx,iy,jx->", window, found[:, :, ::-1, ::-1], basis, basis,
                                                   optimize=True)
        far = from_afar(afar, Spread(1.0), reach, scene.border, *(
            np.array([place + margin, place + margin + 1.0]) for place in (row, col)))
        y, x = (slope * (place - (n - 1) / 2) for place, n in zip((row, col), scene.shape, strict=True))
        out[number] = seconds * (out[number] + far[0, 0, 0]) / (1 + y * y + x * x) ** 2
    return out
