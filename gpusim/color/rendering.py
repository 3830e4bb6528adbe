"""How this camera's digital numbers become display colours, at this exposure."""

from dataclasses import dataclass, fields
from operator import attrgetter

import numpy as np

from gpusim.color.balance import estimate_white
from gpusim.color.color import TransformSet, color_matrix, transform_set
from gpusim.data.colorimetry import adaptation, xyz
from gpusim.data.lights import illuminant
from gpusim.domain.camera import Camera
from gpusim.domain.learned import XYZ
from gpusim.domain.processor import Processor
from gpusim.domain.short_repr import brief
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.optics.weights import product_weights
from gpusim.planner.plan import Plan

_BEFORE_TONE = attrgetter(*(part.name for part in fields(Processor) if part.name != "tone"))


@dataclass(frozen=True, eq=False)
class Rendering:
    """Colour transforms of one exposure; a camera value is (DN - dark level) / (white level - dark level).

    display_from_camera: to linear display RGB, white = 1, shape (3, C). ceiling: camera values are clipped to it, so
    that blown-out highlights stay neutral, shape (C,). neutral: camera values of white, the largest 1, shape (C,).
    model: in words. white: the camera value of display white in its strongest channel. saturation: the largest there
    is. diffuser: the linear display value of a perfect white diffuser in the scene's light, 1 if normalised, or its
    light is not known.
    """

    display_from_camera: np.ndarray
    ceiling: np.ndarray
    neutral: np.ndarray
    model: str
    white: float
    saturation: float
    diffuser: float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _Colors:
    """A Rendering but for its levels: of white as 1."""

    matrix: np.ndarray
    neutral: np.ndarray
    model: str

    def at(self, white, saturation, diffuser):
        return Rendering(
            self.matrix / white,
            self.neutral * saturation,
            self.neutral,
            self.model,
            white,
            saturation,
            diffuser,
        )


def rendering(
    plan: Plan,
    camera: Camera,
    exposure_time: float,
    pixels: int = 1,
    keep=lambda _, __, make: make(),
) -> Rendering:
    """Transforms by which white in the scene's light comes out neutral, and as bright as `Processor.scaling` says.

    "exposure": display white is `AutoExposure.white` of saturation in the sensor's strongest channel, a property of the
    camera alone, so that linear display values are proportional to exposure time and analog gain up to saturation,
    1 / `AutoExposure.white` of display white, where all channels are clipped to white. "normalised": the camera value
    of a perfect white diffuser is display white; where the scene's light is unknown, saturation is.
    camera: as operated (see `gpusim.pipeline.frame.Exposure`). exposure_time: [s]. pixels: whose charge was added.
    Where the scene's light is unknown, or not to be used, the target light is assumed. keep: function (what, key, make)
    that may give what make() gave before for the same key. Raises BadData (see `color_matrix`).
    """
    sensor, processor = camera.sensor, camera.processor
    key = (
        plan.white_rate,
        plan.scene.illuminant,
        plan.scene.light_is_known,
        camera.optics.transmission,
        sensor.qe,
        sensor.channels,
        without_tone(processor),
        camera.display,
    )
    colors = keep("colors", key, lambda: _colors(plan, camera, keep))
    saturation = (
        sensor.saturation * sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    )
    white, rates = saturation, _white_rates(plan, camera)  # camera values in the strongest channel
    if rates is not None:
        white = diffuser = saturation * (rates.max() * exposure_time * pixels / sensor.saturation)
    if processor.scaling == "exposure":
        share = keep("share of white", (*key, "share"), lambda: _share_of_white(plan, camera))
        white = saturation * sensor.auto_exposure.white * share
    return colors.at(white, saturation, 1.0 if rates is None else diffuser / white)


def without_tone(processor) -> tuple:
    """What a processor does before its tone curve, as a part of a key."""
    return _BEFORE_TONE(processor)


def _white_rates(plan, camera):
    """Electrons per second that a perfect white diffuser gives in the camera's planes; None if that is not known."""
    rates, letters = plan.white_rate, planes_of(camera)
    if rates is None or letters == XYZ:
        return rates
    return rates[[camera.sensor.channels.index(letter) for letter in letters]]


def _share_of_white(plan, camera) -> float:
    """Return white in the strongest plane over white in the strongest pixel, 1 unless learned filters leave it out.

    Exposure is metered on all pixels, clear ones too, and filters may give only red, green and blue.
    """
    shown, letters = planes_of(camera), camera.sensor.channels
    if shown == XYZ or {*letters} <= {*shown}:
        return 1.0
    rates = plan.white_rate
    if rates is None:
        light = photons_from_energy(illuminant(camera.processor.target))
        rates = product_weights(light.wavelengths, light, efficiency(camera, letters)).sum(axis=-1)
    return float(rates[[letters.index(letter) for letter in shown]].max() / rates.max())


def _colors(plan, camera, keep):
    """Transforms by which white in the scene's light comes out neutral."""
    scene, sensor, processor, letters = (
        plan.scene,
        camera.sensor,
        camera.processor,
        planes_of(camera),
    )
    known = scene.light_is_known and processor.white_balance == "illuminant"
    light = scene.illuminant if known else photons_from_energy(illuminant(processor.target))
    rates = _white_rates(plan, camera)
    if processor.white:
        white = np.array(processor.white) / max(processor.white)
        return _balanced(
            camera,
            white,
            "white as preset",
            lambda: keep("transforms", transforms_by(camera), lambda: transforms_of(camera)),
        )
    if letters == XYZ:  # of the surfaces in the target light: filters have balanced white already
        neutral = xyz(illuminant(processor.target))
        neutral = neutral / neutral[1]
        matrix = camera.display.rgb_from_xyz @ adaptation(
            neutral, camera.display.xyz_from_rgb.sum(axis=1)
        )
        return _Colors(matrix, neutral, f"XYZ in {processor.target} to the display")
    if processor.color != "none":
        key = (
            camera.optics.transmission,
            sensor.qe,
            letters,
            light,
            processor.training,
            processor.color,
            processor.target,
            camera.display,
        )
        found = keep(
            "colour matrix",
            key,
            lambda: color_matrix(
                efficiency(camera, letters),
                light,
                processor.training,
                method=processor.color,
                target_light=processor.target,
                display=camera.display,
                channels=letters,
            ),
        )
        matrix, neutral = found.matrix, found.white
        model = f"3x{len(neutral)} matrix, {processor.color} on {processor.training!r}"
    else:
        neutral = np.ones(len(letters))
        if known and rates is not None:
            neutral = rates / rates.max()
        matrix, model = _channels_shown(letters, neutral)
    if len(neutral) > 1:
        model += (
            f", white balance for {light.name or 'the scene light'}"
            if known
            else f", as if the light were {processor.target}"
        )
    return _Colors(matrix, neutral, model)


def planes_of(camera: Camera) -> tuple[str, ...]:
    """Letters of what demosaicking gives: the sensor's channels, or what learned filters make of them."""
    table = camera.processor.table
    return camera.sensor.channels if table is None else table.layout.outputs


def rebalanced(
    once: Rendering, camera: Camera, transforms: TransformSet | None, thumbnail, floor: float
) -> Rendering:
    """The same exposure, rendered for the white that the picture itself suggests.

    once: for the target light. transforms: of a set of lights, where a matrix or the estimate needs them. thumbnail:
    block means of camera values, shape (C, rows, cols). floor: of darkness.
    Raises BadData (see `estimate_white`).
    """
    processor, levels = camera.processor, (once.white, once.saturation, once.diffuser)
    estimate = estimate_white(thumbnail, processor.white_balance, transforms, floor=floor)
    return _balanced(camera, estimate.white, estimate.model, lambda: transforms).at(*levels)


def _balanced(camera, white, words, transforms):
    """Transforms by which `white` (C,), largest 1, comes out neutral. transforms: gives those of a set of lights."""
    processor = camera.processor
    if processor.color == "none":
        matrix, model = _channels_shown(planes_of(camera), white)
        return _Colors(matrix, white, f"{model}, {words}")
    made = transforms().at(white)
    model = f"3x{len(made.white)} matrix, {processor.color} on {processor.training!r}, {words}"
    return _Colors(made.matrix, made.white, model)


def transforms_by(camera: Camera) -> tuple:
    """What `transforms_of` depends on."""
    processor = camera.processor
    return (
        camera.optics.transmission,
        camera.sensor.qe,
        planes_of(camera),
        processor.training,
        processor.color,
        processor.target,
        camera.display,
    )


def transforms_of(camera: Camera) -> TransformSet:
    """Colour transforms of this camera for a set of lights, between which an estimate of the light chooses."""
    processor = camera.processor
    method = "white-preserving" if processor.color == "none" else processor.color
    letters = planes_of(camera)
    return transform_set(
        efficiency(camera, letters),
        processor.training,
        channels=letters,
        method=method,
        target_light=processor.target,
        display=camera.display,
    )


def _channels_shown(letters, neutral):
    """Matrix (3, C) from channels to the display without colour correction, white as 1, and what it is in words.

    Red, green and blue are shown as such, and so are any three channels; others are added to a grey.
    """
    balance = np.divide(
        1, neutral, out=np.zeros_like(neutral), where=neutral > 0
    )  # 0: blind to this light
    if {*"RGB"} <= {*letters}:
        chosen = [letters.index(letter) for letter in "RGB"]
    elif len(letters) == 3:
        chosen = [0, 1, 2]
    else:
        return np.tile(balance / np.count_nonzero(balance), (3, 1)), "grey"
    return np.eye(len(letters))[chosen] * balance, "channels to display primaries"


def efficiency(camera: Camera, letters) -> Spectrum:
    """Quantum efficiency [e-/photon] of the channels with these letters behind the lens, shape (letters, L)."""
    optics, qe = camera.optics, camera.sensor.qe
    rows = np.atleast_2d(qe.values)[[camera.sensor.channels.index(letter) for letter in letters]]
    qe = Spectrum(qe.wavelengths, rows, qe.name)
    if not isinstance(optics.transmission, Spectrum):
        return qe
    nodes = np.union1d(qe.wavelengths, optics.transmission.wavelengths)
    return Spectrum(nodes, qe.at(nodes) * optics.transmission_at(nodes), qe.name)
