"""A camera's image processor on a device: the steps from digital numbers to a picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.color.balance import COMPARES_LIGHTS, blocks_of
from gpusim.color.color import transform_set
from gpusim.color.lens_correction import find_correction
from gpusim.color.rendering import Rendering, planes_of, rebalance, transform_arguments
from gpusim.domain.camera import Camera
from gpusim.domain.display import Display, decoding
from gpusim.domain.learned import XYZ
from gpusim.domain.mosaics import bayer_roles
from gpusim.domain.processor import Processor
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.tone import NO_TONE, TONES
from gpusim.io.camera.guided import guided_table
from gpusim.kernels.display.encode import encode, thresholds
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.best import best, root_gain
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.defects import defects
from gpusim.kernels.processor.denoise import denoise
from gpusim.kernels.processor.develop import develop
from gpusim.kernels.processor.gamut import lms_matrix
from gpusim.kernels.processor.guided import guided
from gpusim.kernels.processor.interpolate import interpolate
from gpusim.kernels.processor.learned import learned
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE
from gpusim.kernels.processor.linear import linear
from gpusim.kernels.processor.malvar import malvar
from gpusim.kernels.processor.multiscale import multiscale_memory
from gpusim.kernels.processor.network import network, network_memory
from gpusim.kernels.processor.quantise import quantise
from gpusim.kernels.processor.shade import shade
from gpusim.kernels.processor.thumbnail import thumbnail
from gpusim.pipeline.balanced import demosaic_balanced, filter_channels
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.demosaicked_noise import LEVELS, denoise_planes, measure_noise, white_noise
from gpusim.pipeline.finishing import (
    apply_colors,
    clipping_of,
    colors_of,
    correct_lens,
    lift_shadows,
    neutral_of,
    rebuild_highlights,
    sharpen_picture,
)
from gpusim.pipeline.stacked import correct_layers, separate_layers
from gpusim.pipeline.step import Chain, Rate, Step, Values

STANDS_OUT = 6.0  # [sigma] of noise by which a defective pixel exceeds its neighbours
# share of the shot noise that `best` is told before denoising, so that it leaves detail; it is told all of the noise
# without light, as else its roots would darken black
BEST_SHOT_NOISE = 0.4
CLIPPED = 0.95  # share of saturation: values interpolated next to a clipped pixel lie just below it


@dataclass(frozen=True)
class _Numbers:
    """Digital numbers: their black level [DN], 1 / (white - black), and their noise (see `Developer.noise`)."""

    black: float
    scale: float
    noise: tuple[float, float]

    @property
    def root_noise(self):
        """The noise for filters of roots: none without shot noise, and shot noise beside read noise (`root_gain`)."""
        gain, read = self.noise
        return (root_gain(gain, read), read) if gain else (0.0, 0.0)

    def on_corrected_scale(self):
        """Return the numbers on the scale of corrected mosaics."""
        gain, dark = self.noise
        span = (CORRECTED_WHITE - CORRECTED_BLACK) * self.scale
        scale = 1 / (CORRECTED_WHITE - CORRECTED_BLACK)
        return _Numbers(CORRECTED_BLACK, scale, (gain * span, dark * span))


def describe_finish(processor: Processor) -> str:
    """Return the end of the report's line of the encoding: the look and the tone curve, "" for linear light."""
    tone = processor.tone_curve
    look = "" if processor.look == "linear" else f", look {processor.look}"
    if not tone or tone == NO_TONE:
        return look
    return (
        f"{look}, tone: {TONES[tone].words}"
        if isinstance(tone, str)
        else f"{look}, with a tone curve"
    )


def edges_of(display: Display, tone) -> np.ndarray:
    """Return the linear display values at which the next 8-bit code begins, with the tone curve, shape (255,)."""
    return thresholds(decoding(display, tone))


# memory of a demosaicker [byte per pixel]
SCRATCH = {"adaptive": 2, "best": 28, "learned": 6, "guided": 44}


class Developer:
    """The image processor of a camera on a device.

    Args:
        camera: The camera as operated (see `gpusim.pipeline.exposure.Exposure`).
        device: Its device.
        averaged: Number of raw values whose mean each value is (digital binning).
        cache: Cache of colour transforms and code thresholds; by default its own.
        binning: Pixels that are binned to each raw value, along columns and along rows.
    """

    def __init__(
        self,
        camera: Camera,
        device: Device,
        averaged: int = 1,
        cache: Cache | None = None,
        binning: tuple[int, int] = (1, 1),
    ):
        self.camera, self.device, self.averaged = camera, device, averaged
        self.binning = binning
        self._cache = Cache() if cache is None else cache

    @property
    def noise(self) -> tuple[float, float]:
        """Gain [DN/e-] and noise without light [DN] of raw values.

        The variance is gain (DN - dark level) + noise^2. The noise without light includes all terms of
        `RawNoise.variance`, fixed offsets too. PRNU is left out.
        """
        noise = RawNoise.of(self.camera.sensor, self.averaged)
        gain = self.camera.sensor.gain_dn_per_electron
        return gain * noise.photons / noise.averaged, gain * noise.variance() ** 0.5

    @property
    def _edges(self):
        camera = self.camera
        return self._cache("edges of codes", edges_of, camera.display, camera.processor.tone_curve)

    def steps(self, shape: tuple[int, int]) -> list[Step]:
        """Return the steps from "raw" to display codes.

        They use the values "rendering", "shading" (gains), "blur" (of the lens [pixel]), "kernel" (of
        the camera's blur) and "defects" (a map). They make "camera" (camera values of every pixel,
        (C, rows, cols)), "linear" (display RGB) and "codes".

        Args:
            shape: Shape of the raw values, layers of stacked pixels below each other.

        Returns:
            The steps in the order in which they run.
        """
        camera, device = self.camera, self.device
        processor, pixels = camera.processor, prod(shape)
        chain = Chain("raw", "camera", Rate.FRAME, device)
        numbers = self._correct(chain, pixels)
        self._demosaic(chain, numbers, shape)
        steps = [
            Step("neutral", "", ("rendering",), run=neutral_of, rate=Rate.EXPOSURE),
            *chain.end(),
        ]
        if processor.estimates_white:
            steps.append(self._white_step())
        # not the whole rendering, which changes with every exposure
        steps.append(Step("colors", "", (rendering_name(camera),), run=colors_of, rate=Rate.FRAME))
        area = pixels // (len(camera.sensor.channels) if camera.sensor.stacked else 1)
        chain = Chain("camera", "linear", Rate.FRAME, device)
        if self._rebuilds:
            steps.append(
                Step("clipping", "", (rendering_name(camera),), run=clipping_of, rate=Rate.FRAME)
            )
        self._prepare(chain, area)
        chain.add(
            "processor.color",
            {"is_clipped": not self._rebuilds},
            "colors",
            run=apply_colors,
            nbytes=12 * area,
            work=float(pixels),
        )
        self._finish(chain, area)
        steps += chain.end()
        chain = Chain("linear", "codes", Rate.FRAME, device)
        chain.add(
            "display.encode",
            {"thresholds": self._edges},
            words=f"{camera.display.name}, 8 bit{describe_finish(processor)}",
            nbytes=3 * area,
            work=float(pixels),
        )
        return [*steps, *chain.end()]

    @property
    def _rebuilds(self) -> bool:
        """Whether highlights are rebuilt: where planes are several of the camera's own channels."""
        planes = planes_of(self.camera)
        return self.camera.processor.rebuilds_highlights and planes != XYZ and len(planes) > 1

    def _prepare(self, chain: Chain, area: int) -> None:
        """Add the corrections of camera values before the colour transform."""
        planes = len(planes_of(self.camera))
        if self._rebuilds:
            chain.add(
                "processor.highlights",
                {},
                "clipping",
                run=rebuild_highlights,
                words="clipped channels rebuilt by the colour around them",
                nbytes=4 * planes * area,
                work=float(area),
            )
        if self.camera.processor.corrects_lens:
            # not its gain, which changes with every exposure
            sensor = replace(self.camera.sensor, analog_gain=1.0)
            still = replace(self.camera, sensor=sensor)
            correction = self._cache("lens correction", find_correction, still, self.binning)
            if correction.is_needed:
                chain.add(
                    "processor.rectify",
                    {"correction": correction},
                    run=correct_lens,
                    words=correction.words,
                    nbytes=4 * planes * area,
                    work=float(planes * area),
                )

    def _finish(self, chain: Chain, area: int) -> None:
        """Add what is done to linear display RGB."""
        processor, to_xyz = self.camera.processor, self.camera.display.xyz_from_rgb
        if processor.sharpening:
            chain.add(
                "processor.sharpen",
                self._sharpening,
                "colors",
                "kernel",
                run=sharpen_picture,
                words=f"luminance by the camera's own blur, strength {processor.sharpening:g}",
                nbytes=16 * area,
                work=float(area),
            )
        if processor.local_toning:
            chain.add(
                "processor.local_tone",
                {
                    "strength": processor.local_toning,
                    "luminance": to_xyz[1],
                    "dark_noise": self._sharpening["noise"][1],
                },
                "colors",
                run=lift_shadows,
                words=f"dark regions lifted, strength {processor.local_toning:g}",
                nbytes=12 * area,
                work=float(area),
            )
        if processor.maps_gamut:
            chain.add(
                "processor.gamut",
                {"lms_from_rgb": lms_matrix(to_xyz)},
                words="colours outside moved to a neutral, hue kept",
                nbytes=12 * area,
                work=float(area),
            )

    def codes_at_once(self) -> Step:
        """Return the step from "raw" to "codes" of a camera that `is_developed_at_once`."""
        sensor = self.camera.sensor
        return Step(
            "codes at once",
            "processor.develop",
            ("raw", "colors"),
            {
                "edges": self._edges,
                "phase": "".join(sensor.cfa),
                "black_level": sensor.dark_level,
                "scale": 1 / (sensor.white_level - sensor.dark_level),
                "device": self.device,
            },
            rate=Rate.FRAME,
            run=develop_at_once,
        )

    def _correct(self, chain: Chain, pixels: int) -> "_Numbers":
        """Add the camera's corrections of raw values. Returns the scale of the corrected numbers."""
        sensor, processor = self.camera.sensor, self.camera.processor
        layers = len(sensor.channels) if sensor.stacked else 1
        mosaic = np.zeros((1, 1), np.int32) if sensor.stacked else sensor.cfa_indices
        numbers = _Numbers(
            sensor.dark_level, 1 / (sensor.white_level - sensor.dark_level), self.noise
        )

        def add(stage, run, constants, *others, words="", nbytes=2 * pixels):
            constants = {"correct": run, "layers": layers, **constants}
            chain.add(
                stage,
                constants,
                *others,
                run=correct_layers,
                words=words,
                nbytes=nbytes,
                work=float(pixels),
            )

        if sensor.bits == FLOAT_BITS:
            add(
                "processor.quantise",
                quantise,
                {"black_level": numbers.black, "scale": numbers.scale},
                words=f"to {CORRECTED_WHITE + 1} numbers",
            )
            numbers = numbers.on_corrected_scale()
        if processor.defects != "none":
            add(
                "processor.defects",
                defects,
                {
                    "cfa": mosaic,
                    "detect": STANDS_OUT if processor.defects == "detect" else None,
                    "noise": numbers.noise,
                    "black_level": numbers.black,
                },
                "defects",
                words={
                    "known": "the chip's known defects replaced",
                    "detect": f"pixels {STANDS_OUT:g} sigma beyond their neighbours replaced",
                }[processor.defects],
            )
        if processor.denoising and processor.denoise_by == "mosaic":
            add(
                "processor.denoise",
                denoise,
                {
                    "cfa": mosaic,
                    "black_level": numbers.black,
                    "scale": numbers.scale,
                    "noise": numbers.noise,
                    "strength": processor.denoising,
                },
                words=f"mosaic denoised, strength {processor.denoising:g}",
                nbytes=6 * pixels,
            )
            numbers = replace(numbers.on_corrected_scale(), noise=(0.0, 0.0))
        if processor.corrects_shading:
            add(
                "processor.shade",
                shade,
                {
                    "cfa": np.arange(mosaic.size, dtype=np.int32).reshape(mosaic.shape),
                    "black_level": numbers.black,
                    "scale": numbers.scale,
                },
                "shading",
                words="lens shading divided out",
            )
            numbers = numbers.on_corrected_scale()
        return numbers

    def _demosaic(self, chain: Chain, numbers: "_Numbers", shape: tuple[int, int]) -> None:
        """Add the step to camera values of each pixel, (C, rows, cols), white level 1."""
        sensor, processor = self.camera.sensor, self.camera.processor
        constants: dict[str, Any] = {"black_level": numbers.black, "scale": numbers.scale}
        name, method, more_bytes = "", self.camera.demosaic_method, 0
        roles = bayer_roles(sensor.cfa)
        run: Callable
        others: list[str]
        if sensor.stacked:
            stage, words = "processor.linear", "stacked: all channels"
            constants |= {"correct": linear, "layers": len(sensor.channels)}
            run, others = separate_layers, []
        elif sensor.is_monochrome:
            stage, words, run, others = "processor.linear", "monochrome", linear, []
        elif method == "learned" and not (processor.table or sensor.bayer_phase):
            stage, run, others = "processor.guided", filter_channels, ["neutral"]
            mosaic = self.camera.built_in_filters
            table = guided_table(mosaic)
            more_bytes = table.device_bytes
            words, name = f"filters for {mosaic}, chosen on a first picture, built in", "guided"
            constants |= {
                "demosaic": guided,
                "phase": sensor.cfa,
                "noise": numbers.root_noise,
                "table": table,
                "channels": sensor.channels,
            }
        elif method == "learned":
            stage, run, others = "processor.learned", demosaic_balanced, ["neutral"]
            words = "learned local linear filters" + ("" if processor.table else ", built in")
            name = method
            own = numbers.noise if numbers.noise[0] else (0.0, 0.0)  # as `train-l3` has it
            constants |= {
                "demosaic": learned,
                "phase": sensor.cfa,
                # its square roots include read noise as well as shot noise
                "noise": own if processor.table else numbers.root_noise,
                "table": processor.table,
                # a camera's filters were learned from unbalanced channels, in its light
                "places": None if processor.table else self._places,
            }
        elif method == "network":
            stage, run, others = "processor.network", demosaic_balanced, ["neutral"]
            words = "demosaicking and denoising by a network" + (
                "" if processor.network else ", built in"
            )
            more_bytes = network_memory(*shape, processor.network)
            constants |= {
                "demosaic": network,
                "cfa": sensor.cfa,
                "noise": numbers.noise,
                "weights": processor.network,
                "half": True,
                "places": self._places,
            }
        elif not roles or (method == "bilinear" and not sensor.bayer_phase):
            stage, run, others = "processor.interpolate", interpolate, []
            words = "weighted means of each channel's neighbours"
            constants |= {"cfa": sensor.cfa_indices}
        else:
            phase, letters = roles
            stage, words = f"processor.{method}", f"{method} demosaicking"
            if not sensor.bayer_phase:
                words += f", {', '.join(letters)} in the places of red, green and blue"
                more_bytes = 24 * prod(shape)  # their planes are copied into the sensor's order
            constants |= {"phase": phase}
            name, run, others = method, bilinear, []
            if method != "bilinear":  # these compare channels with each other
                run, others = demosaic_balanced, ["neutral"]
                constants |= {
                    "demosaic": {"malvar": malvar, "adaptive": adaptive, "best": best}[method],
                    "places": tuple(map(sensor.channels.index, letters)),
                }
            if method == "best":
                others.append("blur")
                gain, dark = numbers.noise
                gain *= BEST_SHOT_NOISE if self._is_denoised_after else 1.0
                constants |= {"noise": (gain, dark)}
        channels, pixels = 3 if processor.table is not None else len(sensor.channels), prod(shape)
        area = pixels // (len(sensor.channels) if sensor.stacked else 1)
        chain.add(
            stage,
            constants,
            *others,
            run=run,
            words=words,
            nbytes=(SCRATCH.get(name, 0) + 4 * channels) * area + more_bytes,
            work=float(pixels),
        )
        if self._is_denoised_after:
            self._denoise_planes(chain, numbers, run, constants, (channels, *shape))

    @property
    def _is_denoised_after(self) -> bool:
        """True if denoising follows demosaicking."""
        processor = self.camera.processor
        return processor.denoising > 0 and processor.denoise_by == "multiscale"

    def _denoise_planes(
        self, chain: Chain, numbers: "_Numbers", demosaic, constants, shape
    ) -> None:
        """Add denoising of camera values, whose noise after demosaicking is measured once.

        demosaic, constants: the demosaicker's function and constants. shape: of channels and raw values.
        """
        sensor, processor = self.camera.sensor, self.camera.processor
        channels, rows, cols = shape
        if sensor.stacked or sensor.is_monochrome:
            rows, measured = rows // channels, white_noise(channels)
        else:
            others = {"demosaic", "places", "noise", "black_level", "scale"}
            arguments = {key: value for key, value in constants.items() if key not in others}
            told = constants.get("noise", (0.0, 0.0))
            part = int(not numbers.noise[0])  # the shot noise, if there is any
            assumed = round(told[part] / numbers.noise[part], 6) if numbers.noise[part] else 0.0
            measured = measure_noise(constants.get("demosaic", demosaic), arguments, assumed)
            places = constants.get("places")
            if places:  # of the demosaicker's planes among the channels
                measured = measured.in_order(np.argsort(places))
        gain, dark = numbers.noise
        chain.add(
            "processor.multiscale",
            {
                "measured": measured,
                "is_balanced": processor.table is not None,
                "noise": (gain * numbers.scale, dark * numbers.scale),
                "strength": processor.denoising,
            },
            *(("neutral", "shading") if processor.corrects_shading else ("neutral",)),
            run=denoise_planes,
            words=f"denoised at {LEVELS} scales, strength {processor.denoising:g}",
            nbytes=4 * channels * rows * cols
            + multiscale_memory(self.device, channels, rows, cols, LEVELS),
            work=float(rows * cols),
        )

    @property
    def _places(self):
        """Indices of the red, green and blue channels; None if one is missing."""
        channels = self.camera.sensor.channels
        return tuple(map(channels.index, "RGB")) if {*"RGB"} <= {*channels} else None

    def _white_step(self) -> Step:
        """Return the step that renders for a white that is estimated from the picture."""
        camera, processor = self.camera, self.camera.processor
        method, several = processor.white_balance, len(camera.sensor.channels) > 1
        wanted = processor.color != "none" or (method in COMPARES_LIGHTS and several)
        transforms = None
        if wanted:
            transforms = self._cache("transforms", transform_set, **transform_arguments(camera))
        scale = 1 / (camera.sensor.white_level - camera.sensor.dark_level)
        return Step(
            "picture rendering",
            "processor.thumbnail",
            ("camera", "rendering"),
            {
                "camera": replace(camera, processor=replace(processor, tone=())),
                "transforms": transforms,
                "floor": self.noise[1] * scale,
                "device": self.device,
            },
            words=f"white by {method}",
            rate=Rate.FRAME,
            host="the white is estimated from a thumbnail of some thousand blocks",
            run=render_for_picture,
        )

    def demosaic(self, raw, *, white=None, known=None, shading=None, blur: float = 0.0) -> Any:
        """Return camera values of each pixel, (C, rows, cols), or the output of learned filters; white level 1.

        Args:
            raw: Digital numbers (rows, cols), layers of stacked pixels below each other.
            white: Camera values of white on any scale, shape (C,), for comparing channels. None compares them
                unbalanced. The scale of the result does not change, so clipped values can still be recognised.
            known: Map of the chip's defective pixels, same shape, if the camera replaces known defects.
            shading: Gains of the shading correction at its nodes, (positions, ny, nx), positions of the mosaic's
                period, if the camera corrects shading.
            blur: Standard deviation of the lens's blur [pixel], see `processor.best`.

        Returns:
            An array of the device.
        """
        processor = replace(self.camera.processor, shading=shading is not None)
        own = replace(self.camera, processor=processor)
        developer = Developer(own, self.device, self.averaged, self._cache, self.binning)
        values = Values.of(developer.steps(tuple(raw.shape)))
        values.give(raw=raw, neutral=white, defects=known, shading=shading, blur=blur)
        return values["camera"]

    def apply_color(self, planes, rendering: Rendering) -> Any:
        """Return linear display RGB (3, rows, cols), before the tone curve."""
        return apply_colors(planes, colors_of(rendering), device=self.device)

    def finish(self, planes, rendering: Rendering, kernel: np.ndarray | None) -> Any:
        """Return linear display RGB (3, rows, cols) of camera values, with everything of the camera's look.

        Args:
            planes: Camera values of each pixel, (C, rows, cols).
            rendering: Conversion to display RGB.
            kernel: The camera's own blur, see `processor.sharpen`; None: nothing is blurred.
        """
        values = Values.of(self.steps((2, 2)))
        values.give(camera=planes, kernel=kernel, **{rendering_name(self.camera): rendering})
        return values["linear"]

    @property
    def _sharpening(self) -> dict:
        """Constants of `sharpen_picture`."""
        sensor = self.camera.sensor
        gain, dark = self.noise
        scale = 1 / (sensor.white_level - sensor.dark_level)
        return {
            "strength": self.camera.processor.sharpening,
            "luminance": self.camera.display.xyz_from_rgb[1],
            "noise": (gain * scale, dark * scale),
        }

    def encode(self, linear_rgb) -> Any:
        """Return display codes (rows, cols, 3) of linear display RGB."""
        return encode(linear_rgb, self._edges, device=self.device)

    def models(self) -> dict[str, str]:
        """Return the report's line of each stage."""
        return {step.stage: step.words for step in self.steps((2, 2)) if step.words}


def rendering_name(camera: Camera) -> str:
    """Return the name of the value that is the rendering of a camera's pictures."""
    return "picture rendering" if camera.processor.estimates_white else "rendering"


def develop_at_once(raw, colors, edges, *, device, **constants) -> Any:
    """Return display codes (rows, cols, 3) of raw values in one pass."""
    matrix, ceiling = colors
    return develop(raw, device.array(matrix), edges, ceiling=ceiling, **constants, device=device)


def render_for_picture(planes, once, *, camera, transforms, floor, device) -> Rendering:
    """Return the rendering for a white estimated from the picture. once: the rendering for the target light."""
    rows, cols = blocks_of(camera.processor.white_balance, planes.shape[1:])
    small = thumbnail(planes, CLIPPED * once.saturation, rows=rows, cols=cols, device=device)
    small = device.numpy(small)
    return rebalance(once, camera, transforms, small, floor)
