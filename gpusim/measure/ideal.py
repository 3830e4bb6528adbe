"""The picture of an ideal camera: the colours of a scene, pixel by pixel, on a display."""

from collections.abc import Sequence

import numpy as np

from gpusim.data.colorimetry import adaptation
from gpusim.data.lights import illuminant
from gpusim.data.weights import xyz_per_content
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import ENERGY, RELATIVE, Spectrum, photons_from_energy
from gpusim.optics.sampling import AREA, frame_start, pixel_taps

DAYLIGHT = "D65"  # assumed if the scene's light is unknown
PERIOD = 8  # of the largest mosaic [pixel]: binned frames have whole periods only


def ideal(
    scene: Scene,
    display: Display = DISPLAYS["srgb"],
    shape: Sequence[int] | None = None,
    *,
    light: Spectrum | str | None = None,
    luminance: float | None = None,
) -> np.ndarray:
    """Return the CIE 1931 XYZ of `scene` on `display`, without lens, noise or mosaic.

    The XYZ of every sample's spectrum are averaged over the area of the pixel and adapted from the
    white of the light to the display's (Bradford). Nothing is clipped to the display's gamut, and
    lens distortion is not applied.

    Args:
        scene: scene to show.
        display: display to show it on.
        shape: rows and columns of a binned frame (see `gpusim.kernels.sensor.bin`), which may omit
            the last of the scene's; None is the scene's frame.
        light: light to show the surfaces in instead of the scene's, as a camera's colour matrix
            assumes: photon radiance at any scale, or the name of an illuminant.
        luminance: luminance shown as display white [cd m-2]. Required if the scene's light is
            unknown (its white is then D65), not allowed with `light`. None is the luminance of a
            perfect diffuser.

    Returns:
        XYZ with white Y = 1, float64, shape (rows, cols, 3).

    Raises:
        BadData: if shape, light or luminance do not fit the scene.
        OutOfRange: if `luminance` is not positive and finite.
    """
    if not scene.light_is_known and light is not None:
        raise BadData(
            f"ideal: {scene.name} is radiance, not reflectance: it cannot be shown in another light; "
            "leave light out"
        )
    if luminance is not None and not 0 < luminance < np.inf:
        raise OutOfRange("luminance of white", f"{luminance} cd m-2", "0 < luminance < inf")
    if luminance is not None and light is not None:
        raise BadData(
            "ideal: luminance together with light, whose scale is arbitrary; leave luminance out: a perfect "
            "diffuser is white"
        )
    if isinstance(light, str):
        light = illuminant(light)
    if light is not None and light.quantity in (ENERGY, RELATIVE):
        light = photons_from_energy(light)
    weights = xyz_per_content(scene.wavelengths, scene.illuminant if light is None else light)
    white = weights.sum(1)
    if not scene.light_is_known:
        if luminance is None:
            raise BadData(
                f"ideal: the light of {scene.name} is not known; wanted luminance of white [cd m-2]"
            )
        white = xyz_per_content(scene.wavelengths, photons_from_energy(illuminant(DAYLIGHT)))
        white = white.sum(1) / white[1].sum()
        weights = weights / luminance
    else:
        scale = white[1] if luminance is None else luminance
        weights, white = weights / scale, white / white[1]
    weights = adaptation(white, display.xyz_from_rgb.sum(1)) @ weights
    return np.moveaxis(_bin(pixel_sums(scene, weights), shape), 0, -1)


def pixel_sums(scene: Scene, weights) -> np.ndarray:
    """Return sums of the scene's content over wavelength, averaged over every pixel's square.

    weights: of the scene's wavelengths, shape (3, L). Returns float64 (3, rows, cols). Raises
    BadData if the scene has a view.
    """
    if not scene.view.is_plain:
        raise BadData(f"ideal: {scene.name} has a view; wanted the scene without one")
    middle = slice(scene.margin, -scene.margin or None)
    return _pixels(scene, sample_sums(scene, weights, (middle, middle)))


def sample_sums(scene: Scene, weights, window) -> np.ndarray:
    """Return sums of the samples over wavelength, float64 (C, rows, cols), with layers in front.

    weights: of the scene's wavelengths, shape (C, L). window: slices of rows and columns of the
    content's samples.
    """
    planes = scene.content.on_host().weigh(weights, window)
    for layer in scene.layers[::-1]:
        alpha = np.asarray(layer.alpha, np.float64)[window]
        planes = planes * (1 - alpha) + layer.content.on_host().weigh(weights, window) * alpha
    return planes


def _pixels(scene, planes):
    """Return the mean of the samples over the area of each pixel."""
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


def _bin(planes, shape):
    if shape is None or tuple(shape) == planes.shape[1:]:
        return planes
    (rows, cols), (high, wide) = shape, planes.shape[1:]
    by, bx = high // max(rows, 1), wide // max(cols, 1)
    is_binning = min(rows, cols, by, bx) >= 1 and max(by, bx) >= 2
    if not is_binning or high >= (rows + PERIOD) * by or wide >= (cols + PERIOD) * bx:
        raise BadData(
            f"ideal: {rows} x {cols} pixels do not come from the scene's {high} x {wide} by binning"
        )
    return planes[:, : rows * by, : cols * bx].reshape(3, rows, by, cols, bx).mean(axis=(2, 4))
