"""A camera whose blur varies over the field, at single pixels; it extends triple_brute.py.

The light of every sample is spread with the Seidel wavefront (Welford, chapter 7) and the lateral
colour at its place. A point keeps its light, and a flat field is the sum of its points. Within NEAR
samples of the pixel, spreads are polynomials in the place, of degree NODES - 1; farther light uses
the spread at the pixel.
"""

import numpy as np
from scipy.interpolate import BarycentricInterpolator
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

NODES, NEAR = 9, 40  # places along an axis, and how far they go [sample]
SPARE = 8  # margin of samples, since a transform repeats itself
LEAST_Q = 0.7  # below, the sums over the pupil are too long


def seidel(coefficients, height, angle, scale):
    """Return the wavefront [waves] at a field point, a function of the pupil's x and y."""
    _, coma, astigmatism, curvature, distortion = coefficients

    def waves(u, v):
        along, square = u * np.cos(angle) + v * np.sin(angle), u * u + v * v
        return scale * (
            coma * height * square * along
            + astigmatism * height**2 * along**2
            + curvature * height**2 * square
            + distortion * height**3 * along
        )

    return waves


def spread_from(scene, camera, place, band, reach) -> np.ndarray:
    """Return the light that apertures receive from a point. place: (row, column) of the frame."""
    optics, pitch, shape = camera.optics, camera.sensor.pixel_pitch, np.array(scene.shape)
    wavelength = scene.wavelengths[band]
    q = wavelength * 1e-9 * optics.f_number / pitch
    at, fine = fine_grid(q, reach)
    lateral = optics.lateral_color
    lateral = (
        lateral
        if isinstance(lateral, float)
        else np.interp(wavelength, lateral.wavelengths, lateral.values)
    )
    y, x = place - (shape - 1) / 2
    waves = seidel(
        optics.wavefront.seidel,
        np.hypot(y, x) / (np.hypot(*shape) / 2),
        np.arctan2(y, x),
        CLEAR / wavelength,
    )
    side = np.sqrt(camera.sensor.fill_factor)
    return apertured(
        chord_spread(q, waves, at - lateral * y, at - lateral * x),
        fine,
        reach,
        (side, side),
        (0.0, 0.0),
    )


def gathered(scene, camera, pixel, band, reach) -> tuple[np.ndarray, float]:
    """Return a pixel's response to a light of 1 at each sample around it, and the total.

    The response has (2 reach + 1)^2 values. The total is the sum of all light from a point there.
    """
    limits = np.array([[-scene.margin] * 2, np.array(scene.shape) - 1 + scene.margin])
    out = spread_from(scene, camera, np.array(pixel), band, reach)[::-1, ::-1]
    whole = out.sum()
    first, last = np.clip(
        np.add(pixel, [[-NEAR] * 2, [NEAR] * 2]), *limits
    )  # outside, the outermost place counts
    unit = -np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    places = [
        (one + other) / 2 + (other - one) / 2 * unit for one, other in zip(first, last, strict=True)
    ]
    near = np.zeros((2 * NEAR + 1, 2 * NEAR + 1))
    basis = []
    for at, one, other in zip(pixel, first, last, strict=True):
        source = np.clip(at + np.arange(-NEAR, NEAR + 1), one, other)
        basis.append(
            BarycentricInterpolator(unit, np.eye(NODES))((2 * source - one - other) / (other - one))
        )
    for i, j in np.ndindex(NODES, NODES):
        own = spread_from(scene, camera, np.array([places[0][i], places[1][j]]), band, NEAR + SPARE)
        near += own[SPARE:-SPARE, SPARE:-SPARE][::-1, ::-1] * basis[0][:, i, None] * basis[1][:, j]
    out[reach - NEAR : reach + NEAR + 1, reach - NEAR : reach + NEAR + 1] = near
    return out, whole


def electrons_at(scene, camera, seconds: float, pixels) -> np.ndarray:
    """Return mean electrons at pixels (row, column), one sample per pixel. Raises OutOfRange."""
    optics, margin = camera.optics, scene.margin
    q = scene.wavelengths * 1e-9 * optics.f_number / camera.sensor.pixel_pitch
    if q.min() < LEAST_Q:
        raise OutOfRange("q", f"{q.min():.2g}", f"{LEAST_Q:g} or more")
    reach = int(np.ceil(max(NEAREST, RINGS * q.max())))
    weights, cfa, out = spectral_weights(scene, camera), camera.sensor.cfa, np.zeros(len(pixels))
    slope = (
        camera.sensor.pixel_pitch / optics.focal_length
        if optics.relative_illumination == "cos4"
        else 0.0
    )
    for number, (row, col) in enumerate(pixels):
        share = weights[camera.sensor.channels.index(cfa[row % len(cfa)][col % len(cfa[0])])]
        afar = np.zeros((1, *scene.content.shape))
        for band in np.flatnonzero(np.abs(share) > 1e-6 * share.max()):
            plane = spectra(scene.content, band)
            window = np.pad(plane, reach, mode=MODES[scene.border])[
                row + margin : row + margin + 2 * reach + 1,
                col + margin : col + margin + 2 * reach + 1,
            ]
            found, whole = gathered(scene, camera, (row, col), band, reach)
            own = share[band] / (whole + energy_beyond(Spread(q[band]), reach))
            afar += own * q[band] * plane
            out[number] += own * np.vdot(found, window)
        far = from_afar(
            afar,
            Spread(1.0),
            reach,
            scene.border,
            *(np.array([place + margin, place + margin + 1.0]) for place in (row, col)),
        )
        y, x = (
            slope * (place - (n - 1) / 2) for place, n in zip((row, col), scene.shape, strict=True)
        )
        out[number] = seconds * (out[number] + far[0, 0, 0]) / (1 + y * y + x * x) ** 2
    return out
