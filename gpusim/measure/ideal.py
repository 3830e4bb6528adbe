"""The picture that a perfect camera would show: a scene's colours, pixel by pixel, on a display."""

import numpy as np

from gpusim.data.colorimetry import LUMINOUS_EFFICACY, adaptation, cmf
from gpusim.data.lights import illuminant
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum, energy_from_photons, photons_from_energy
from gpusim.optics.sampling import AREA, frame_start, pixel_taps
from gpusim.optics.weights import product_weights

DAYLIGHT = "D65"  # assumed where the scene's light is not known
PERIOD = 8  # of the largest mosaic [pixel]: of a binned one only whole periods are kept


def ideal(
    scene: Scene,
    display: Display = DISPLAYS["srgb"],
    shape=None,
    *,
    light: Spectrum | str | None = None,
    luminance: float | None = None,
) -> np.ndarray:
    """CIE 1931 XYZ of `scene` on `display`, without lens, noise or mosaic; float64 (rows, cols, 3), white Y = 1.

    The XYZ of every sample's spectrum, averaged over the area of the pixel, are adapted from the white of the light to
    the display's (Bradford). Nothing is clipped to the display's gamut, and a lens's distortion is not followed.

    shape: rows and columns, those of a binned frame (see `gpusim.kernels.sensor.bin`), which may leave out the last of
        the scene's; None: of the scene's frame.
    light: shows the surfaces in this light instead of the scene's, as a camera's colour matrix aims at: photon radiance
        at any scale, or the name of an illuminant. luminance: shown as display white [cd m-2], needed where the scene's
        light is not known (the white is D65's then), and not with `light`; None: that of a perfect diffuser.
    Raises BadData (shape, light, luminance), OutOfRange.
    """
    eye = energy_from_photons(cmf())  # at its own 1 nm; a light's table may be coarse
    if not scene.light_is_known and light is not None:
        raise BadData(
            f"ideal: {scene.name} is radiance, not reflectance: it cannot be shown in another light"
        )
    if luminance is not None and not 0 < luminance < np.inf:
        raise OutOfRange("luminance of white", f"{luminance} cd m-2", "0 < luminance < inf")
    if luminance is not None and light is not None:
        raise BadData(
            "ideal: luminance together with light: the light has any scale, so leave luminance out and a "
            "perfect diffuser is white"
        )
    if isinstance(light, str):
        light = photons_from_energy(illuminant(light))
    weights = product_weights(scene.wavelengths, eye, scene.illuminant if light is None else light)
    white = weights.sum(1)
    if not scene.light_is_known:
        if luminance is None:
            raise BadData(
                f"ideal: the light of {scene.name} is not known; wanted luminance = that of white [cd m-2]"
            )
        white = product_weights(scene.wavelengths, eye, photons_from_energy(illuminant(DAYLIGHT)))
        white = white.sum(1) / white[1].sum()
        weights = weights * (LUMINOUS_EFFICACY / luminance)
    else:
        scale = white[1] if luminance is None else luminance / LUMINOUS_EFFICACY
        weights, white = weights / scale, white / white[1]
    return np.moveaxis(
        _binned(pixel_sums(scene, adaptation(white, display.xyz_from_rgb.sum(1)) @ weights), shape),
        0,
        -1,
    )


def pixel_sums(scene: Scene, weights) -> np.ndarray:
    """Sums over wavelength of the scene's content, averaged over every pixel's square; float64 (3, rows, cols).

    weights: of the scene's wavelengths, shape (3, L).
    """
    if not scene.view.is_plain:
        raise BadData(
            f"ideal: a view of {scene.name}, whose samples are not the frame's; wanted the scene as it is"
        )
    middle = slice(scene.margin, -scene.margin or None)
    return _pixels(scene, sample_sums(scene, weights, (middle, middle)))


def sample_sums(scene: Scene, weights, window) -> np.ndarray:
    """Sums over wavelength of samples, float64 (C, rows, cols); what stands in front hides what is behind.

    weights: of the scene's wavelengths, shape (C, L). window: slices of rows and columns of the content's samples.
    """
    planes = scene.content.on_host().weighted(weights, window)
    for layer in scene.layers[::-1]:
        alpha = np.asarray(layer.alpha, np.float64)[window]
        planes = planes * (1 - alpha) + layer.content.on_host().weighted(weights, window) * alpha
    return planes


def _pixels(scene, planes):
    """Means of the samples over the area of each pixel."""
    if scene.samples_per_pixel == 1:
        return planes
    for axis, pixels in ((1, scene.shape[0]), (2, scene.shape[1])):
        samples, ratio = planes.shape[axis], scene.samples_per_pixel
        taps = pixel_taps(samples, pixels, ratio, 1.0, frame_start(samples, pixels, ratio), AREA)
        planes = np.moveaxis(planes, axis, -1)
        planes = sum(
            planes[..., taps.start + t] * weight for t, weight in enumerate(taps.weights.T)
        )
        planes = np.moveaxis(planes, -1, axis)
    return planes


def _binned(planes, shape):
    if shape is None or tuple(shape) == planes.shape[1:]:
        return planes
    rows, cols = shape
    by, bx = factors = [
        size // max(count, 1) for size, count in zip(planes.shape[1:], shape, strict=True)
    ]
    if (
        rows < 1
        or cols < 1
        or max(factors) < 2
        or min(factors) < 1
        or any(
            size >= (count + PERIOD) * factor
            for size, count, factor in zip(planes.shape[1:], shape, factors, strict=True)
        )
    ):
        raise BadData(
            f"ideal: {rows} x {cols} pixels do not come from the scene's {planes.shape[1]} x "
            f"{planes.shape[2]} by binning"
        )
    return planes[:, : rows * by, : cols * bx].reshape(3, rows, by, cols, bx).mean(axis=(2, 4))
