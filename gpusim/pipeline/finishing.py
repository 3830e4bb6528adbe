"""From camera values to the finished picture: functions of a `Developer`'s steps."""

import functools
from typing import Any

import numpy as np

from gpusim.color.rendering import Rendering
from gpusim.color.root_polynomial import linearise
from gpusim.kernels.processor.color import color
from gpusim.kernels.processor.highlights import highlights
from gpusim.kernels.processor.levels import MOST_BALANCE
from gpusim.kernels.processor.local_tone import local_tone
from gpusim.kernels.processor.rectify import rectify
from gpusim.kernels.processor.sharpen import detail_gain, sharpen
from gpusim.optics.correction import LensCorrection

SHARPENED = 3.0  # [sigma] of noise at which half of a detail's sharpening is left


def neutral_of(rendering: Rendering) -> np.ndarray:
    """Return the camera values of white."""
    return rendering.neutral


def colors_of(rendering: Rendering) -> tuple:
    """Return a rendering's colour matrix and ceiling."""
    return rendering.display_from_camera, rendering.ceiling


def clipping_of(rendering: Rendering) -> tuple:
    """Return the camera values of white and of saturation."""
    return rendering.neutral, rendering.saturation


def rebuild_highlights(planes, clipping, *, device) -> Any:
    """Return camera values (C, rows, cols) with clipped channels rebuilt."""
    neutral, saturation = clipping
    neutral = np.maximum(neutral, neutral.max() / MOST_BALANCE)  # of a channel blind to the light
    return highlights(planes, neutral, saturation=saturation, device=device)


def correct_lens(planes, *, correction, device) -> Any:
    """Return camera values (C, rows, cols) without the lens's distortion and lateral colour."""
    return rectify(planes, _nodes_on(device, correction, tuple(planes.shape[1:])), device=device)


@functools.lru_cache(maxsize=4)  # constants of a camera: up to 2 MB at 1080p
def _nodes_on(device, correction: LensCorrection, shape):
    return device.array(correction.nodes(shape))


def apply_colors(planes, colors, *, device, is_clipped=True) -> Any:
    """Return linear display RGB (3, rows, cols) of camera values, before the tone curve.

    is_clipped: whether channels are clipped where white clips; else highlights are rebuilt.
    """
    matrix, ceiling = colors
    return color(
        planes, device.array(matrix), ceiling=ceiling if is_clipped else None, device=device
    )


def sharpen_picture(linear_rgb, colors, kernel, *, strength, luminance, noise, device) -> Any:
    """Return linear display RGB, sharpened by the camera's own blur where its noise allows it.

    kernel: as for `Developer.finish`. noise: of camera values: variance per value, and deviation without light.
    """
    if kernel is None:
        return linear_rgb
    matrix, ceiling = colors  # the ceiling has the colour of white
    matrix = linearise(np.asarray(matrix, np.float64), ceiling)
    weights = luminance @ matrix  # of camera values in the luminance
    grey = np.maximum(np.linalg.pinv(matrix) @ np.ones(3), 0)  # camera values of display white
    variances = np.array([noise[0] * weights**2 @ grey, noise[1] ** 2 * weights @ weights])
    halved = SHARPENED**2 * detail_gain(kernel) * variances
    return sharpen(linear_rgb, kernel, luminance, halved, strength=strength, device=device)


def lift_shadows(linear_rgb, colors, *, strength, luminance, dark_noise, device) -> Any:
    """Return linear display RGB with dark regions lifted, but not noise. dark_noise: of camera values."""
    matrix, ceiling = colors
    weights = luminance @ linearise(np.asarray(matrix, np.float64), ceiling)
    noise = dark_noise * float(np.linalg.norm(weights))
    return local_tone(linear_rgb, luminance, strength=strength, noise=noise, device=device)
