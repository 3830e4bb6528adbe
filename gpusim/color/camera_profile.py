"""What raw converters are told of a camera's colours: matrices for two lights, between which they find any other's.

Source: Adobe, "Digital Negative (DNG) Specification", 1.4.0.0, chapter 6: camera colour space to CIE XYZ.
"""

import numpy as np

from gpusim.color.color import camera_matrix, color_matrix
from gpusim.color.rendering import efficiency
from gpusim.data.colorimetry import adaptation, xyz
from gpusim.data.lights import illuminant
from gpusim.domain.camera import Camera

LIGHTS = ("A", "D65")
D50 = np.array(
    [0.9642, 1.0, 0.8249]
)  # XYZ of the white that a forward matrix leads to, as ICC profiles have it


def color_profile(camera: Camera) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """{light: (color, forward)} for illuminants A and D65, from the camera's own curves and training reflectances.

    color: XYZ of surfaces in the light to the channels' values, shape (C, 3); white's largest is 1 where its Y is 1.
    forward: values over those of white to XYZ of the surfaces as adapted to D50 (Bradford), shape (3, C): the
    white-preserving matrix for the light, so that white comes out as D50. {} for one channel, which has no colours.
    Raises BadData (see `color_matrix`).
    """
    letters = camera.sensor.channels
    if len(letters) == 1:
        return {}
    qe, training = efficiency(camera, letters), camera.processor.training
    profile = {}
    for light in LIGHTS:
        found = color_matrix(qe, light, training, target_light=light)
        # White as integrated over the training surfaces' wavelengths lacks what an eye sees beyond them.
        white, whole = found.xyz @ found.white, xyz(illuminant(light))
        color = camera_matrix(qe, light, training) @ adaptation(whole / whole[1], white)
        profile[light] = color, adaptation(white, D50) @ found.xyz * found.white
    return profile
