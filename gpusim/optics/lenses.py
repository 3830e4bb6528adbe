"""The lens of a camera: each kind has its class."""

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.dual import DiodeOptics
from gpusim.domain.optics import Optics
from gpusim.optics.lens import Lens, MeasuredLens, PointLens, PupilLens
from gpusim.optics.masked_lens import MaskedLens
from gpusim.optics.split_lens import SplitLens


def open_lens(
    optics: Optics,
    pitch: float,
    aperture=1.0,
    shape=(1, 1),
    displacement: tuple[float, float] = (0.0, 0.0),
    axis: tuple[float, float] = (0.0, 0.0),
) -> Lens:
    """Return the lens that `optics` describes, in front of a grid of samples.

    Args:
        optics: Settings of the lens.
        pitch: Distance of the samples [m].
        aperture: Height and width over which each sample is integrated [sample], or one number for a square.
        shape: Rows and columns of the frame; its corner is field height 1.
        displacement: Displacement of the apertures from the samples, (rows, cols) [sample].
        axis: Where the optical axis meets the frame, from its middle, (rows, cols) [sample].
    """
    height, width = np.broadcast_to(aperture, 2).tolist()
    corner = float(np.hypot(*shape)) / 2
    if optics.model == "none":
        return PointLens(optics, pitch, (height, width), axis)
    if optics.psf is not None:
        field = tuple(n / 2 / corner for n in shape)
        return MeasuredLens(optics, optics.psf, pitch, (height, width), field, displacement, axis)
    if isinstance(optics, DiodeOptics) and optics.diode is not None:
        height, width = (side / pitch for side in optics.diode.window)
    settings = optics, pitch, (height, width), corner, displacement, axis
    whole = PupilLens(*settings) if optics.pupil.mask is None else MaskedLens(*settings)
    return SplitLens(whole, optics) if isinstance(optics, DiodeOptics) else whole


def moved_apertures(
    optics: Optics, displacement: tuple[float, float], ratio: float
) -> tuple[float, float]:
    """Return how far the blur displaces apertures from the samples, (rows, cols) [sample].

    If pixels are several samples, weights of samples displace them. Windows of whole pixels are displaced to the
    nearest sample, so that nothing is interpolated if the ratio is whole.

    Args:
        optics: Settings of the lens.
        displacement: Of the apertures from a centred grid of pixels, (rows, cols) [pixel].
        ratio: Samples per pixel.
    """
    if ratio == 1:
        return displacement
    if not isinstance(optics, DiodeOptics) or not float(ratio).is_integer():
        return 0.0, 0.0
    down, across = (((ratio - 1) / 2 + ratio * one) % 1.0 for one in displacement)
    return down, across


def lens_of(camera: Camera) -> Lens:
    """Return a camera's lens in front of its pixels."""
    sensor, pitch = camera.sensor, camera.sensor.pixel_pitch
    aperture = np.divide(sensor.aperture, pitch)
    return open_lens(camera.optics, pitch, aperture, displacement=sensor.displacement)
