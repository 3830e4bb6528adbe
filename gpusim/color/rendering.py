"""Conversion of a camera's digital numbers to display colours, for one exposure."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.color.balance import estimate_white
from gpusim.color.color import TransformSet, color_matrix, sees_beyond, transform_set
from gpusim.color.root_polynomial import linearise
from gpusim.data.colorimetry import adaptation, xyz
from gpusim.data.lights import illuminant
from gpusim.data.weights import product_weights
from gpusim.domain.camera import Camera
from gpusim.domain.learned import XYZ
from gpusim.domain.sensor import Sensor
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum, photons_from_energy

VISIBLE_END = 700.0  # [nm], where measured surfaces end


@dataclass(frozen=True, eq=False)
class Rendering:
    """Colour transforms of one exposure.

    A camera value is (DN - dark level) / (white level - dark level).

    Attributes:
        display_from_camera: Matrix to linear display RGB, white = 1, shape (3, C); or of the
            root-polynomial terms of three channels, shape (3, 6) or (3, 13).
        ceiling: Largest camera values, shape (C,). Clipping to them keeps blown-out highlights
            neutral.
        neutral: Camera values of white, the largest 1, shape (C,).
        model: Method in words.
        white: Camera value of display white in its strongest channel.
        saturation: Largest camera value.
        diffuser: Linear display value of a perfect white diffuser in the scene's light; 1 if
            normalised, or if its light is not known.
    """

    display_from_camera: np.ndarray
    ceiling: np.ndarray
    neutral: np.ndarray
    model: str
    white: float
    saturation: float
    diffuser: float

    __repr__ = short_repr

    @property
    def linear_matrix(self) -> np.ndarray:
        """Matrix to linear display RGB for colours next to white, shape (3, C).

        It is `display_from_camera` unless that is of root-polynomial terms.
        """
        return linearise(self.display_from_camera, self.neutral)


@dataclass(frozen=True, eq=False)
class Colors:
    """A Rendering without its levels.

    Attributes:
        matrix: Matrix to linear display RGB for white as 1, see `Rendering.display_from_camera`.
        neutral: Camera values of white, the largest 1, shape (C,).
        model: Method in words.
        brightest: Electrons per second of a perfect white diffuser in the strongest plane, or None
            if that is not known.
        share: White in the strongest plane over white in the strongest pixel [1].
    """

    matrix: np.ndarray
    neutral: np.ndarray
    model: str
    brightest: float | None = None
    share: float = 1.0

    def at(self, white, saturation, diffuser):
        """Return the rendering at levels of display white, saturation and a white diffuser."""
        return Rendering(
            self.matrix / white,
            self.neutral * saturation,
            self.neutral,
            self.model,
            white,
            saturation,
            diffuser,
        )


def choose_colors(
    white_rate: np.ndarray | None,
    light: Spectrum | None,
    camera: Camera,
    cache=lambda _, function, *args, **kwargs: function(*args, **kwargs),
) -> Colors:
    """Return the transforms that make white in the scene's light neutral.

    Args:
        white_rate: Electrons per second of a perfect white diffuser in each channel, shape (C,), or
            None.
        light: The scene's light. None if it is not known: the processor's target light is assumed.
        camera: The camera. Its lens transmission, sensor, processor and display matter.
        cache: Function `cache(name, function, *args)` that may return an earlier result.

    Returns:
        The colours.

    Raises:
        BadData: See `color_matrix`.
    """
    colors = _match_colors(white_rate, light, camera, cache)
    rates = _white_rates(white_rate, camera)
    share = 1.0
    if camera.processor.scaling == "exposure":
        share = _share_of_white(white_rate, camera)
    return replace(colors, brightest=None if rates is None else float(rates.max()), share=share)


def render_exposure(
    colors: Colors, sensor: Sensor, *, scaling: str, pixels: int, exposure_time: float
) -> Rendering:
    """Return the rendering of an exposure, with white as bright as `Processor.scaling` says.

    "exposure": display white is `AutoExposure.white` of saturation in the sensor's strongest
    channel, a property of the camera only. Linear display values are therefore proportional to
    exposure time and analog gain up to saturation, at 1 / `AutoExposure.white` of display white;
    there all channels are clipped to white. "normalised": the camera value of a perfect white
    diffuser is display white, or saturation if the scene's light is unknown.

    Args:
        colors: The transforms.
        sensor: The sensor as operated (see `gpusim.pipeline.exposure.Exposure`).
        scaling: Scaling of the processor.
        pixels: Number of pixels whose charge is added to one.
        exposure_time: Exposure time [s].

    Returns:
        The rendering.
    """
    saturation = (
        sensor.saturation * sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    )
    white = saturation  # a camera value in the strongest channel
    if colors.brightest is not None:
        white = diffuser = saturation * (
            colors.brightest * exposure_time * pixels / sensor.saturation
        )
    if scaling == "exposure":
        white = saturation * sensor.auto_exposure.white * colors.share
    return colors.at(white, saturation, 1.0 if colors.brightest is None else diffuser / white)


def _white_rates(rates, camera):
    """Return electrons per second from a perfect white diffuser in the camera's planes, or None."""
    letters = planes_of(camera)
    if rates is None or letters == XYZ:
        return rates
    return rates[[camera.sensor.channels.index(letter) for letter in letters]]


def _share_of_white(rates, camera) -> float:
    """Return white in the strongest plane over white in the strongest pixel.

    It is 1 unless learned filters leave that pixel's channel out: exposure is metered on all
    pixels, also clear ones, while filters may return only red, green and blue.
    """
    shown, letters = planes_of(camera), camera.sensor.channels
    if shown == XYZ or {*letters} <= {*shown}:
        return 1.0
    if rates is None:
        light = photons_from_energy(illuminant(camera.processor.target))
        rates = product_weights(light.wavelengths, light, efficiency(camera, letters)).sum(axis=-1)
    return float(rates[[letters.index(letter) for letter in shown]].max() / rates.max())


def _match_colors(white_rate, light, camera, cache):
    """Return the transforms that make white in the scene's light neutral, without its rates."""
    processor, letters = camera.processor, planes_of(camera)
    known = light is not None and processor.white_balance == "illuminant"
    if not known:
        light = photons_from_energy(illuminant(processor.target))
    rates = _white_rates(white_rate, camera)
    if processor.white:
        white, transforms = np.array(processor.white) / max(processor.white), None
        if processor.color != "none":
            transforms = cache("transforms", transform_set, **transform_arguments(camera))
        return _balance_white(camera, white, "white as preset", transforms)
    if letters == XYZ:  # XYZ of surfaces in the target light: the filters have balanced white
        neutral = xyz(illuminant(processor.target))
        neutral = neutral / neutral[1]
        matrix = camera.display.rgb_from_xyz @ adaptation(
            neutral, camera.display.xyz_from_rgb.sum(axis=1)
        )
        return Colors(matrix, neutral, f"XYZ in {processor.target} to the display")
    if processor.color != "none":
        found = cache(
            "colour matrix",
            color_matrix,
            efficiency(camera, letters),
            light,
            processor.training,
            method=processor.color,
            target_light=processor.target,
            display=camera.display,
            channels=letters,
        )
        matrix, neutral = found.matrix, found.white
        if known and rates is not None:
            matrix, neutral = _fit_beyond_visible(
                matrix, neutral, rates, efficiency(camera, letters)
            )
        model = f"3x{matrix.shape[1]} matrix, {processor.color} on {processor.training!r}"
    else:
        neutral = np.ones(len(letters))
        if known and rates is not None:
            neutral = rates / rates.max()
        matrix, model = _show_channels(letters, neutral)
    if len(neutral) > 1:
        model += (
            f", white balance for {light.name or 'the scene light'}"
            if known
            else f", as if the light were {processor.target}"
        )
    return Colors(matrix, neutral, model)


def _fit_beyond_visible(matrix, neutral, rates, qe):
    """Return a colour matrix and its white for what near-infrared channels see of white in this scene.

    Scenes end at other wavelengths than lights and measured surfaces do.
    """
    infrared = sees_beyond(qe, VISIBLE_END)
    if not infrared.any() or infrared.all() or matrix.shape[1] != len(neutral):
        return matrix, neutral
    strongest = np.argmax(np.where(infrared, 0, neutral))
    seen = rates * neutral[strongest] / rates[strongest]
    white = np.where(infrared & (seen > 0), seen, neutral)
    return matrix * (neutral / white) * white.max(), white / white.max()


def planes_of(camera: Camera) -> tuple[str, ...]:
    """Return the letters of the demosaicked planes: the sensor's or the filters' outputs."""
    table = camera.processor.table
    return camera.sensor.channels if table is None else table.layout.outputs


def rebalance(
    once: Rendering, camera: Camera, transforms: TransformSet | None, thumbnail, floor: float
) -> Rendering:
    """Return the rendering of the same exposure for the white estimated from the picture.

    Args:
        once: Rendering for the target light.
        camera: The camera.
        transforms: Transforms of a set of lights, if a matrix or the estimate needs them.
        thumbnail: Block means of camera values, shape (C, rows, cols).
        floor: Mean response that counts as dark [camera value].

    Returns:
        The rendering.

    Raises:
        BadData: See `estimate_white`.
    """
    processor, levels = camera.processor, (once.white, once.saturation, once.diffuser)
    estimate = estimate_white(thumbnail, processor.white_balance, transforms, floor=floor)
    return _balance_white(camera, estimate.white, estimate.model, transforms).at(*levels)


def _balance_white(camera, white, words, transforms):
    """Return transforms that make `white` (C,), largest 1, neutral.

    transforms: transforms of a set of lights, or None without a matrix.
    """
    processor = camera.processor
    if processor.color == "none":
        matrix, model = _show_channels(planes_of(camera), white)
        return Colors(matrix, white, f"{model}, {words}")
    made = transforms.at(white)
    model = f"3x{made.matrix.shape[1]} matrix, {processor.color} on {processor.training!r}, {words}"
    return Colors(made.matrix, made.white, model)


def transform_arguments(camera: Camera) -> dict:
    """Return the arguments of `transform_set` for a camera, for estimates of the light."""
    processor, letters = camera.processor, planes_of(camera)
    return {
        "qe": efficiency(camera, letters),
        "reflectances": processor.training,
        "channels": letters,
        "method": "white-preserving" if processor.color == "none" else processor.color,
        "target_light": processor.target,
        "display": camera.display,
    }


def _show_channels(letters, neutral):
    """Return the matrix (3, C) without colour correction, white as 1, and its name.

    Red, green and blue are shown as such, and so are any three channels. Others are added to a
    grey.
    """
    # 0: blind to this light
    balance = np.divide(1, neutral, out=np.zeros_like(neutral), where=neutral > 0)
    if {*"RGB"} <= {*letters}:
        chosen = [letters.index(letter) for letter in "RGB"]
    elif len(letters) == 3:
        chosen = [0, 1, 2]
    else:
        return np.tile(balance / np.count_nonzero(balance), (3, 1)), "grey"
    return np.eye(len(letters))[chosen] * balance, "channels to display primaries"


def efficiency(camera: Camera, letters) -> Spectrum:
    """Return the quantum efficiency [e-/photon] of channels behind the lens, shape (letters, L)."""
    optics, qe = camera.optics, camera.sensor.qe
    rows = np.atleast_2d(qe.values)[[camera.sensor.channels.index(letter) for letter in letters]]
    qe = Spectrum(qe.wavelengths, rows, qe.name)
    if not isinstance(optics.transmission, Spectrum):
        return qe
    nodes = np.union1d(qe.wavelengths, optics.transmission.wavelengths)
    return Spectrum(nodes, qe.at(nodes) * optics.transmission_at(nodes), qe.name)
