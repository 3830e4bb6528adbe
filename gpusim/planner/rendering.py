"""How this camera's digital numbers become display colours, at this exposure."""

from dataclasses import dataclass

import numpy as np

from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.camera import Camera
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.planner.color import color_matrix
from gpusim.planner.plan import Plan


@dataclass(frozen=True, eq=False)
class Rendering:
    """Colour transforms of one exposure; a camera value is (DN - dark level) / (white level - dark level).

    display_from_camera: to linear display RGB, white = 1, shape (3, C). ceiling: camera values are clipped to it, so
    that blown-out highlights stay neutral, shape (C,). neutral: camera values of white, the largest 1, shape (C,).
    camera_from_xyz: XYZ to values scaled like `neutral`, shape (3, 3); None without a colour matrix. model: in words.
    """

    display_from_camera: np.ndarray
    ceiling: np.ndarray
    neutral: np.ndarray
    camera_from_xyz: np.ndarray | None
    model: str


def rendering(plan: Plan, camera: Camera, exposure_time: float, pixels: int = 1) -> Rendering:
    """Transforms by which a perfect white diffuser in the scene's light comes out as display white.

    camera: as operated (see `gpusim.scheduler.Exposure`). exposure_time: [s]. pixels: whose charge was added. Where
    the scene's light is unknown, D65 is assumed and saturation becomes display white.
    Raises BadData (see `color_matrix`).
    """
    scene = plan.scene
    sensor, processor = camera.sensor, camera.processor
    known = scene.light_is_known and processor.white_balance == "illuminant"
    light = scene.illuminant if known else photons_from_energy(illuminant("D65"))
    saturation = sensor.saturation * sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    white = saturation  # the camera value of white in its strongest channel
    if plan.white_rate is not None:
        white *= plan.white_rate.max() * exposure_time * pixels / sensor.saturation
    if processor.color != "none":
        transform = color_matrix(_through(camera.optics, sensor.qe), light, reflectances(processor.training),
                                 display=camera.display)
        matrix, neutral = transform.matrix, transform.white
        # inverse of a square matrix; more channels than three have none, and no DNG either
        camera_from_xyz = np.linalg.inv(transform.xyz) if transform.xyz.shape == (3, 3) else None
        model = f"3x{len(neutral)} matrix, least squares on {processor.training!r}"
    else:
        neutral = np.ones(len(sensor.channels))
        if known and plan.white_rate is not None:
            neutral = plan.white_rate / plan.white_rate.max()
        matrix, model = _channels_shown(sensor.channels, neutral)
        camera_from_xyz = None
    if len(neutral) > 1:
        model += f", white balance for {light.name or 'the scene light'}" if known else ", as if the light were D65"
    return Rendering(matrix / white, neutral * saturation, neutral, camera_from_xyz, model)


def _channels_shown(letters, neutral):
    """Matrix (3, C) from channels to the display without colour correction, white as 1, and what it is in words.

    Red, green and blue are shown as such, and so are any three channels; others are added to a grey.
    """
    balance = np.divide(1, neutral, out=np.zeros_like(neutral), where=neutral > 0)  # 0: blind to this light
    if {*"RGB"} <= {*letters}:
        chosen = [letters.index(letter) for letter in "RGB"]
    elif len(letters) == 3:
        chosen = [0, 1, 2]
    else:
        return np.tile(balance / np.count_nonzero(balance), (3, 1)), "grey"
    return np.eye(len(letters))[chosen] * balance, "channels to display primaries"


def _through(optics, qe):
    """Quantum efficiency behind the lens."""
    if not isinstance(optics.transmission, Spectrum):
        return qe
    nodes = np.union1d(qe.wavelengths, optics.transmission.wavelengths)
    return Spectrum(nodes, qe.at(nodes) * optics.transmission_at(nodes), qe.name)
