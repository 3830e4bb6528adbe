"""Colour profile of a camera for raw converters: matrices for two lights.

Converters interpolate between the two lights. Source: Adobe, "Digital Negative (DNG)
Specification", 1.4.0.0, chapter 6: camera colour space to CIE XYZ.
"""

import numpy as np

from gpusim.color.color import camera_matrix, color_matrix
from gpusim.color.rendering import efficiency
from gpusim.data.colorimetry import adaptation, xyz
from gpusim.data.lights import illuminant
from gpusim.domain.camera import Camera

LIGHTS = ("A", "D65")
D50 = np.array([0.9642, 1.0, 0.8249])  # XYZ of white behind a forward matrix, as in ICC profiles


def color_profile(camera: Camera) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the colour matrices for illuminants A and D65.

    They are computed from the camera's own curves and its training reflectances.

    Args:
        camera: The camera.

    Returns:
        {light: (color, forward)}, empty for one channel. color: from XYZ of surfaces in the light
        to channel values, shape (C, 3); for white with Y = 1 the largest value is 1. forward: from
        channel values relative to white to XYZ adapted to D50 (Bradford), shape (3, C): the
        white-preserving matrix for the light; white becomes D50.

    Raises:
        BadData: See `color_matrix`.
    """
    letters = camera.sensor.channels
    if len(letters) == 1:
        return {}
    qe, training = efficiency(camera, letters), camera.processor.training
    profile = {}
    for light in LIGHTS:
        found = color_matrix(qe, light, training, target_light=light)
        # White, integrated over the training wavelengths, lacks the visible light beyond them.
        white, whole = found.xyz @ found.white, xyz(illuminant(light))
        color = camera_matrix(qe, light, training) @ adaptation(whole / whole[1], white)
        profile[light] = color, adaptation(white, D50) @ found.xyz * found.white
    return profile
