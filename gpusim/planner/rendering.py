"""How this camera's digital numbers become display colours, at this exposure."""

from dataclasses import dataclass

import numpy as np

from gpusim.data.lights import illuminant
from gpusim.domain.camera import Camera
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.planner.balance import estimate_white
from gpusim.planner.color import TransformSet, color_matrix, transform_set
from gpusim.planner.plan import Plan


@dataclass(frozen=True, eq=False)
class Rendering:
    """Colour transforms of one exposure; a camera value is (DN - dark level) / (white level - dark level).

    display_from_camera: to linear display RGB, white = 1, shape (3, C). ceiling: camera values are clipped to it, so
    that blown-out highlights stay neutral, shape (C,). neutral: camera values of white, the largest 1, shape (C,).
    camera_from_xyz: XYZ to values scaled like `neutral`, shape (3, 3); None without a colour matrix. model: in words.
    white: the camera value of white in its strongest channel. saturation: the largest there is.
    """

    display_from_camera: np.ndarray
    ceiling: np.ndarray
    neutral: np.ndarray
    camera_from_xyz: np.ndarray | None
    model: str
    white: float
    saturation: float


def rendering(plan: Plan, camera: Camera, exposure_time: float, pixels: int = 1) -> Rendering:
    """Transforms by which a perfect white diffuser in the scene's light comes out as display white.

    camera: as operated (see `gpusim.scheduler.Exposure`). exposure_time: [s]. pixels: whose charge was added. Where
    the scene's light is unknown, or not to be used, the target light is assumed; where it is unknown, saturation
    becomes display white.
    Raises BadData (see `color_matrix`).
    """
    scene = plan.scene
    sensor, processor = camera.sensor, camera.processor
    known = scene.light_is_known and processor.white_balance == "illuminant"
    light = scene.illuminant if known else photons_from_energy(illuminant(processor.target))
    saturation = sensor.saturation * sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    white = saturation  # the camera value of white in its strongest channel
    if plan.white_rate is not None:
        white *= plan.white_rate.max() * exposure_time * pixels / sensor.saturation
    if processor.color != "none":
        made = color_matrix(_through(camera.optics, sensor.qe), light, processor.training, method=processor.color,
                            target_light=processor.target, display=camera.display, channels=sensor.channels)
        matrix, neutral, to_xyz = made.matrix, made.white, made.xyz
        model = f"3x{len(neutral)} matrix, {processor.color} on {processor.training!r}"
    else:
        neutral = np.ones(len(sensor.channels))
        if known and plan.white_rate is not None:
            neutral = plan.white_rate / plan.white_rate.max()
        (matrix, model), to_xyz = _channels_shown(sensor.channels, neutral), None
    if len(neutral) > 1:
        model += (f", white balance for {light.name or 'the scene light'}" if known else
                  f", as if the light were {processor.target}")
    return _scaled(matrix, neutral, to_xyz, model, white, saturation)


def balanced(once: Rendering, camera: Camera, transforms: TransformSet, thumbnail, floor: float) -> Rendering:
    """The same exposure, rendered for the white that the picture itself suggests.

    once: for the target light. thumbnail: block means of camera values, shape (C, rows, cols). floor: of darkness.
    Raises BadData (see `estimate_white`).
    """
    processor = camera.processor
    estimate = estimate_white(thumbnail, processor.white_balance, transforms, floor=floor)
    if processor.color == "none":
        matrix, model = _channels_shown(camera.sensor.channels, estimate.white)
        return _scaled(matrix, estimate.white, None, f"{model}, {estimate.model}", once.white, once.saturation)
    made = transforms.at(estimate.white)
    model = f"3x{len(made.white)} matrix, {processor.color} on {processor.training!r}, {estimate.model}"
    return _scaled(made.matrix, made.white, made.xyz, model, once.white, once.saturation)


def transforms_of(camera: Camera) -> TransformSet:
    """Colour transforms of this camera for a set of lights, between which an estimate of the light chooses."""
    processor = camera.processor
    method = "white-preserving" if processor.color == "none" else processor.color
    return transform_set(_through(camera.optics, camera.sensor.qe), processor.training, channels=camera.sensor.channels,
                         method=method, target_light=processor.target, display=camera.display)


def _scaled(matrix, neutral, to_xyz, model, white, saturation):
    # the inverse of a square matrix; more channels than three have none, and no DNG either
    camera_from_xyz = np.linalg.inv(to_xyz) if to_xyz is not None and to_xyz.shape == (3, 3) else None
    return Rendering(matrix / white, neutral * saturation, neutral, camera_from_xyz, model, white, saturation)


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
