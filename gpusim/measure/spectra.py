"""Spectra of parts of a scene, of the light behind a lens, and of a sensor's electrons."""

from math import ceil, floor
from operator import index

import numpy as np
import scipy

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange, check_known, format_value
from gpusim.domain.interpolation import spectral_weights
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import energy_per_photon
from gpusim.measure.ideal import sample_sums
from gpusim.optics.outside import rule_of
from gpusim.optics.sampling import frame_start

# names of the border rules in SciPy
MODES = {"zero": "grid-constant", "edge": "nearest", "reflect": "reflect"}
ORDER, REACH = 5, 16  # of splines between samples; samples beyond which they change by 1e-6

# quantities of a patch, with their units
QUANTITIES = {
    "radiance": "[W m⁻² sr⁻¹ nm⁻¹]",
    "photons": "[photon s⁻¹ m⁻² sr⁻¹ nm⁻¹]",
    "reflectance": "[1]",
}


def patch_spectrum(
    scene: Scene, place, quantity: str = "radiance"
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean spectrum of a patch of a scene.

    Reflectances are a cubic spline between the scene's wavelengths, as everywhere, which keeps a
    lamp's lines visible.

    Args:
        scene: the scene. Its reflectance is known only without a view.
        place: a pixel (column, row) or a region (left, top, right, bottom) of the frame, right and
            bottom exclusive.
        quantity: a key of QUANTITIES.

    Returns:
        Wavelengths (L,) [nm] and values (L,), in the unit of QUANTITIES.

    Raises:
        BadData: if the place is no pixel and no region.
        OutOfRange: if it is outside the frame.
        UnknownName: if the quantity is unknown.
    """
    check_known("quantity", quantity, QUANTITIES)
    wavelengths, light = scene.wavelengths, scene.illuminant
    if quantity == "reflectance":
        every, window = np.eye(len(wavelengths)), patch_window(scene, place)
        return wavelengths, scene.content.on_host().surfaces.weigh(every, window).mean(axis=(1, 2))
    content = patch_content(scene, place)
    own = light.wavelengths
    fine = np.union1d(wavelengths, own[(own > wavelengths[0]) & (own < wavelengths[-1])])
    if len(fine) > len(wavelengths):
        content, wavelengths = spectral_weights(wavelengths, fine) @ content, fine
    values = content * light.at(wavelengths)
    return wavelengths, values * energy_per_photon(
        wavelengths
    ) if quantity == "radiance" else values


def patch_content(scene: Scene, place) -> np.ndarray:
    """Return the mean content of a patch at the scene's wavelengths, (L,), see `patch_spectrum`."""
    every, window = np.eye(len(scene.wavelengths)), patch_window(scene, place)
    samples = sample_sums if scene.view.is_plain else _viewed_sums
    return samples(scene, every, window).mean(axis=(1, 2))


def _viewed_sums(scene, weights, window):
    """Return `sample_sums` of a window of what the view shows, by splines between the samples.

    Source: Thevenaz, Blu and Unser, Interpolation revisited, IEEE Trans. Med. Imaging 19 (2000).
    """
    middle = [(n - 1) / 2 for n in scene.content.shape]
    y, x = np.mgrid[window]
    y, x = scene.view.place(y - middle[0], x - middle[1], scene.samples_per_pixel)
    places, crop = [y + middle[0], x + middle[1]], []
    for at, n in zip(places, scene.content.shape, strict=True):
        first = min(max(floor(at.min()) - REACH, 0), n - 1)
        crop.append(slice(first, max(first + 1, min(ceil(at.max()) + REACH + 1, n))))
    at = [place - part.start for place, part in zip(places, crop, strict=True)]
    mode = MODES[rule_of(scene.border)]
    return np.stack(
        [
            scipy.ndimage.map_coordinates(plane, at, order=ORDER, mode=mode)
            for plane in sample_sums(scene, weights, tuple(crop))
        ]
    )


def patch_window(scene: Scene, place) -> tuple[slice, slice]:
    """Return the samples of a pixel or region as slices of the content's rows and columns.

    Raises BadData, OutOfRange, see `patch_spectrum`.
    """
    try:
        numbers = [index(one) for one in place]
    except TypeError:
        numbers = []
    if len(numbers) not in (2, 4):
        raise BadData(
            f"at = {format_value(place)}: wanted a pixel (column, row), a region (left, top, right, bottom) or a "
            "list of them"
        )
    left, top = numbers[:2]
    right, bottom = numbers[2:] or (left + 1, top + 1)
    rows, cols = scene.shape
    if not (0 <= left < right <= cols and 0 <= top < bottom <= rows):
        raise OutOfRange(
            "at",
            tuple(numbers),
            f"columns 0 .. {cols - 1} and rows 0 .. {rows - 1} of the frame, right "
            "and bottom beyond left and top",
        )
    ratio, window = scene.samples_per_pixel, []
    for first, last, pixels, samples in (
        (top, bottom, rows, scene.samples[0]),
        (left, right, cols, scene.samples[1]),
    ):
        start = scene.margin + frame_start(samples, pixels, ratio)
        low = int(start + first * ratio + 1e-9)
        window.append(slice(low, max(low + 1, ceil(start + last * ratio - 1e-9))))
    return window[0], window[1]


def electron_spectra(
    camera: Camera, wavelengths: np.ndarray, irradiance: np.ndarray, seconds: float
) -> np.ndarray:
    """Return the electrons per nanometre of each channel from an irradiance.

    Args:
        camera: the camera.
        wavelengths: shape (L,) [nm].
        irradiance: photons on the sensor, shape (L,) [photon s-1 m-2 nm-1].
        seconds: exposure time [s].

    Returns:
        Electrons of one pixel, shape (C, L) [e- nm-1]; 0 beyond the table of the efficiency.
    """
    height, width = camera.sensor.aperture
    return height * width * seconds * irradiance * camera.sensor.qe.at(wavelengths)
