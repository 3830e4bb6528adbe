"""The lens correction of a camera, with the lateral colour that each of its channels sees."""

import numpy as np

from gpusim.color.rendering import efficiency, planes_of
from gpusim.data.lights import illuminant
from gpusim.data.weights import product_weights
from gpusim.domain.camera import Camera
from gpusim.domain.learned import XYZ
from gpusim.domain.spectrum import photons_from_energy
from gpusim.optics.correction import LensCorrection


def find_correction(camera: Camera, binning: tuple[int, int] = (1, 1)) -> LensCorrection:
    """Return the lens correction of a camera.

    A channel's lateral colour is the mean over the wavelengths that it sees in the processor's
    target light. Learned filters that return XYZ mix the channels: they get the distortion only.

    Args:
        camera: The camera.
        binning: Pixels that are binned, along columns and along rows.
    """
    optics, letters = camera.optics, planes_of(camera)
    excess: tuple[float, ...] = (0.0,)
    if optics.has_lateral_color and letters != XYZ:
        light = photons_from_energy(illuminant(camera.processor.target))
        weights = product_weights(light.wavelengths, light, efficiency(camera, letters))
        weights = np.atleast_2d(weights)
        mean = weights @ optics.lateral_color_at(light.wavelengths) / weights.sum(axis=1)
        excess = tuple(mean.tolist())
    sensor = camera.sensor
    return LensCorrection(optics, sensor.pixel_pitch, sensor.displacement, binning, excess)
