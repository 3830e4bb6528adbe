"""Pictures of light: a scene's radiance, spectra of its patches, and the irradiance behind a lens."""

import numpy as np

from gpusim.data.colorimetry import LUMINOUS_EFFICACY, cmf
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.spectrum import energy_from_photons
from gpusim.measure.ideal import pixel_sums
from gpusim.planner.weights import product_weights
from gpusim.plot.canvas import axes_of, image, srgb
from gpusim.truth import viewed

BRIGHT = 99.5  # percentile of the luminance that is shown as white where no white is known


def scene(scene: Scene, ax=None):
    """A scene's radiance as sRGB: a white diffuser in its light is white.

    Where the light is not known the brightest 0.5 % of the pixels are white. Returns the axes. Raises BadData, Missing.
    """
    codes, white = radiance_codes(scene)
    rows, cols = scene.shape
    return image(axes_of(ax, picture_size(scene.shape)), codes,
                 f"{scene.name}: radiance, {cols} x {rows} pixels, white {white:.3g} cd/m²")


def radiance_codes(scene: Scene) -> tuple[np.ndarray, float]:
    """Codes 0 .. 1 (rows, cols, 3) in sRGB of a scene's radiance, and the luminance that is white [cd m-2]."""
    scene = viewed(checked_scene(scene))
    eye = energy_from_photons(cmf())
    weights = LUMINOUS_EFFICACY * product_weights(scene.wavelengths, eye, scene.illuminant)
    xyz = pixel_sums(scene, weights)
    if scene.light_is_known:
        white = weights.sum(1)
        if not white[1] > 0:
            raise BadData(f"{scene.name}: its light cannot be seen; wanted some within 360 .. 830 nm")
        return srgb(xyz / white[1], white / white[1]), float(white[1])
    bright = float(np.percentile(xyz[1], BRIGHT)) or 1.0
    return srgb(xyz / bright), bright


def picture_size(shape) -> tuple[float, float]:
    """Inches of a figure for a picture of (rows, cols) with a title."""
    rows, cols = shape
    width = min(8.0, 5.0 * cols / rows)
    return max(width, 3.5), max(width * rows / cols, 1.5) + 0.5
