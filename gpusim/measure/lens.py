"""Modulation transfer and point spread of a camera's lens, at a wavelength or of a channel."""

from collections.abc import Sequence
from math import hypot

import numpy as np

from gpusim.data.lights import light_of
from gpusim.data.weights import product_weights
from gpusim.domain.calibration import Framed
from gpusim.domain.camera import Camera
from gpusim.domain.distortion import fit_to_frame
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.optics.lenses import lens_of

STEP = 20.0  # [nm] between the wavelengths of a channel
ACROSS = 161  # samples along a side of a point spread
RINGS = 5.0  # least radius of a point spread's picture [Airy radius]


def sensed_light(
    camera: Camera, one: str | float, light: str | Spectrum = "D65"
) -> tuple[np.ndarray, np.ndarray]:
    """Return the wavelengths of a channel's light on the sensor, and their shares of its electrons.

    Args:
        camera: the camera.
        one: letter of a channel, or a wavelength [nm], which is returned with the share 1.
        light: name of an illuminant, or its relative power in energy units.

    Returns:
        Wavelengths (L,) [nm] and shares (L,) [1], whose sum is 1.

    Raises:
        BadData: if the channel does not respond to the light through the lens.
        UnknownName: if the illuminant is unknown.
    """
    if not isinstance(one, str):
        return np.array([float(one)]), np.ones(1)
    sensor, (shortest, longest) = camera.sensor, lens_of(camera).wavelengths
    photons = photons_from_energy(light_of(light))
    low = max(sensor.qe.wavelengths[0], photons.wavelengths[0], shortest)
    high = min(sensor.qe.wavelengths[-1], photons.wavelengths[-1], longest)
    if not low < high:
        raise BadData(
            f"channel {one}: does not respond to the light {photons.name} through the lens"
        )
    nodes = np.linspace(low, high, int(np.ceil((high - low) / STEP)) + 1)
    number = sensor.channels.index(one)
    curve = Spectrum(sensor.qe.wavelengths, sensor.qe.values[number])
    through = camera.optics.transmission
    weights = product_weights(
        nodes, photons, curve, *([through] if isinstance(through, Spectrum) else [])
    )
    if not weights.sum() > 0:
        raise BadData(
            f"channel {one}: does not respond to the light {photons.name} through the lens"
        )
    return nodes, weights / weights.sum()


def pixel_mtf(camera: Camera, frequencies: np.ndarray, direction: str = "across") -> np.ndarray:
    """Return the modulation transfer of the pixel's aperture, negative beyond its first zero.

    Args:
        camera: the camera.
        frequencies: on the sensor, shape (F,) [cycle/m].
        direction: "across" (along rows) or "down".

    Returns:
        Transfer, shape (F,) [1].
    """
    return np.sinc(frequencies * camera.sensor.aperture[direction == "across"])


def lens_mtf(
    camera: Camera,
    one: str | float,
    frequencies: np.ndarray,
    direction: str = "across",
    place: Sequence[float] = (0.0, 0.0),
    light: str | Spectrum = "D65",
) -> np.ndarray:
    """Return the modulation transfer of a camera's lens, without the pixel.

    Lateral colour, which shifts the image, is left out.

    Args:
        camera: the camera.
        one: letter of a channel, or a wavelength [nm].
        frequencies: on the sensor, shape (F,) [cycle/m].
        direction: "across" (along rows) or "down".
        place: field point (y, x); 1 is the frame's corner.
        light: see `sensed_light`.

    Returns:
        Transfer, shape (F,) [1].

    Raises:
        BadData: if the channel does not respond to the light.
    """
    nodes, shares = sensed_light(camera, one, light)
    fy, fx = (0.0, frequencies) if direction == "across" else (frequencies, 0.0)
    return np.abs(shares @ lens_of(camera).transfer(nodes, fy, fx, place))


def spread_reach(camera: Camera, wavelengths: np.ndarray, place: Sequence[float]) -> float:
    """Return the distance from its middle up to which a point spread is shown [m]."""
    optics, pitch = camera.optics, camera.sensor.pixel_pitch
    rays = pitch * lens_of(camera).spread(wavelengths, hypot(*place))
    return max(RINGS * float(optics.airy_radius(max(wavelengths))), 0.75 * pitch, 1.5 * rays)


def check_spread(camera: Camera):
    """Raise BadData if a camera has no lens."""
    if lens_of(camera).is_pointlike:
        raise BadData(
            f'psf: {camera.name} has optics.model = "none": no point spread to draw; use another model'
        )


def point_spread(
    camera: Camera,
    one: str | float,
    place: Sequence[float] = (0.0, 0.0),
    light: str | Spectrum = "D65",
) -> tuple[np.ndarray, float]:
    """Return the point spread of a camera's lens, without the pixel and without lateral colour.

    Args:
        camera: the camera.
        one: letter of a channel, or a wavelength [nm].
        place: field point (y, x); 1 is the frame's corner.
        light: see `sensed_light`.

    Returns:
        Energies (rows, cols) [1], and the distance of their samples [m].

    Raises:
        BadData: if the camera has no lens, or the channel does not respond to the light.
    """
    check_spread(camera)
    lens = lens_of(camera)
    nodes, shares = sensed_light(camera, one, light)
    energy, step = lens.sampled_spread(nodes, place, spread_reach(camera, nodes, place), ACROSS)
    return np.tensordot(shares, energy, 1), step


def field_place(camera: Camera, shape: tuple[int, int], row: int, col: int) -> tuple[float, float]:
    """Return the field point (y, x) of a pixel of an unbinned frame.

    The length 1 is half of the frame's diagonal. Distortion, which moves the image, is left out.

    Args:
        camera: the camera.
        shape: rows and columns of the frame.
        row: row of the pixel.
        col: column of the pixel.

    Returns:
        The field point, at most 1 from the axis.
    """
    corner, axis, pitch = hypot(*shape) / 2, (0.0, 0.0), camera.sensor.pixel_pitch
    if camera.optics.distortion is not None:
        model = fit_to_frame(camera.optics.distortion, shape, pitch)
        if isinstance(model, Framed):
            x, y = (model.radius / pitch * at for at in model.middle)
            axis = y, x
    y, x = (
        (at - (n - 1) / 2 - away) / corner
        for at, n, away in zip((row, col), shape, axis, strict=True)
    )
    beyond = max(hypot(y, x), 1.0)
    return y / beyond, x / beyond
