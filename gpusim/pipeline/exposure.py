"""The noise-free exposure of a scene, and the noisy frames that are drawn from it."""

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.backends import Device
from gpusim.color.lens_correction import find_correction
from gpusim.color.rendering import Rendering, choose_colors, render_exposure
from gpusim.color.speed import iso_speed
from gpusim.domain.camera import Camera
from gpusim.domain.errors import checked_count
from gpusim.domain.exposure import exposure_value
from gpusim.domain.sensor import Sensor
from gpusim.domain.short_repr import shorten_repr
from gpusim.kernels.processor.color import color
from gpusim.kernels.sensor.noise import check_drawn
from gpusim.optics.labels import carry_labels
from gpusim.pipeline.brightness import describe_brightness
from gpusim.pipeline.developer import Developer, rendering_name
from gpusim.pipeline.diodes import divided, phase_places, put_phase_pixels
from gpusim.pipeline.frame import Frame, Parts
from gpusim.pipeline.light import return_none
from gpusim.pipeline.metering import metering_steps
from gpusim.pipeline.readout import Readout, flag_pixels
from gpusim.pipeline.report import Error, Report, StageReport
from gpusim.pipeline.step import Rate, Step, Values
from gpusim.pipeline.tables import LensTables
from gpusim.planner.plan import Plan

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

ON_DEVICE = ("mean", "chip_mean")  # device arrays of an exposure
DARKEST = (
    1e6  # [photon s-1 m-2 sr-1 nm-1], 1e-8 cd m-2: light of a scene is brighter, or has no scale
)
HOT = 3.0  # a hot pixel's charge beyond the common dark current, in standard deviations of the read noise


def exposure_steps(simulator: "Simulator", plan: Plan) -> list[Step]:
    """Return the steps of a plan's exposures, from the scene to digital numbers.

    They use the values "content", "view" and "sensor" (the sensor as operated), and the numbers of
    `exposure_numbers`.
    """
    camera, readout, imaging = simulator.camera, simulator.readout, simulator.imaging
    processor, sensor, scene = camera.processor, camera.sensor, plan.scene
    layers = (len(sensor.channels),) if sensor.stacked else ()
    colors = {
        "white_rate": plan.white_rate,
        "light": scene.illuminant if scene.light_is_known else None,
        "camera": replace(camera, processor=replace(processor, tone=())),
        "cache": simulator.cache,
    }
    scaling = {"scaling": processor.scaling, "pixels": readout.pixels}
    of_lens = {"plan": plan, "tables": imaging.tables}
    blurred = of_lens if camera.demosaic_method == "best" else {}
    sharpened = of_lens if processor.sharpening else {}
    steps = [
        *imaging.steps(plan),
        *metering_steps(plan, sensor, readout),
        *readout.steps((*layers, *scene.shape)),
        Step("transforms", "", (), colors, rate=Rate.EXPOSURE, run=choose_colors),
        Step(
            "rendering",
            "",
            ("transforms", "sensor"),
            scaling,
            ("exposure_time",),
            rate=Rate.EXPOSURE,
            run=render_exposure,
        ),
        Step(
            "blur",
            "",
            (),
            blurred,
            rate=Rate.EXPOSURE,
            run=LensTables.deviation_of if blurred else return_none,
        ),
        Step(
            "kernel",
            "",
            (),
            sharpened,
            rate=Rate.EXPOSURE,
            run=LensTables.kernel_of if sharpened else return_none,
        ),
        Step(
            "mean of pixels",
            "",
            ("mean",),
            {"readout": readout},
            rate=Rate.EXPOSURE,
            host="a Frame, with its report, is NumPy",
            run=read_mean,
        ),
    ]
    known = {step.output for step in steps}
    response = "response" if "response" in known and sensor.noise.dead_pixels else ""
    dark = "dark" if "dark" in known else ""
    has_places = sensor.dual is not None and bool(sensor.dual.sparse)
    if processor.defects != "known" or not (response or dark or has_places):
        return [*steps, Step("defects", "", run=return_none, rate=Rate.EXPOSURE)]
    flags = Step(
        "defects",
        "",
        (response, dark),
        {
            "binning": sensor.binning,
            "stride": readout.stride,
            "places": phase_places(sensor.dual, scene.shape) if has_places else None,
            "device": simulator.device,
        },
        ("hot_electrons", "dark_time"),
        rate=Rate.EXPOSURE,
        run=flag_pixels,
    )
    return [*steps, flags]


def picture_steps(simulator: "Simulator", camera: Camera) -> list[Step]:
    """Return the steps from digital numbers "raw" to pictures. camera: as operated."""
    readout, device = simulator.readout, simulator.device
    binning = readout.sensor.binning
    developer = Developer(camera, device, readout.averaged, simulator.cache, binning)
    layers = len(camera.sensor.channels) if camera.sensor.stacked else 1
    steps = developer.steps((layers, 1))
    constants = {"matrix": camera.display.xyz_from_rgb, "device": device}
    steps.append(Step("xyz", "", ("linear",), constants, rate=Rate.FRAME, run=convert_to_xyz))
    return [*steps, developer.codes_at_once()] if camera.is_developed_at_once else steps


def exposure_numbers(
    simulator: "Simulator", sensor: Sensor, seconds: float, gain: float, brightness: float = 1.0
) -> dict[str, float]:
    """Return the numbers of an exposure by name.

    Args:
        simulator: The simulator.
        sensor: The sensor as operated.
        seconds: Exposure time [s].
        gain: The exposure's analog gain [1].
        brightness: Factor on the scene's light [1].
    """
    readout = simulator.readout
    return {
        "exposure_time": seconds * brightness,  # of the light
        "brightness": brightness,
        "dark_time": readout.dark_time(seconds),
        "hot_electrons": HOT * sensor.read_sigma,
        **readout.numbers(seconds, gain),
    }


def read_mean(mean, *, readout: Readout) -> np.ndarray:
    """Return the mean electrons of the output pixels, NumPy float32 (..., rows, cols) [e-]."""
    shape = tuple(mean.shape)
    found = readout.mean(readout.device.reshape(mean, (prod(shape[:-1]), shape[-1])))
    return found.reshape(*shape[:-2], -1, found.shape[-1])


def convert_to_xyz(linear, *, matrix, device) -> Any:
    """Return CIE XYZ of linear display RGB (3, rows, cols)."""
    return color(linear, device.array(matrix), device=device)


@dataclass(frozen=True, eq=False)
class Exposure:
    """The noise-free exposure of a scene. It is computed once; noisy frames are drawn from it.

    A pickle holds the arrays' values, and the simulator with its device's name; the device is opened when it is loaded.
    `np.asarray` returns the mean electrons.

    Attributes:
        plan: Plan of the scene.
        camera: The camera as operated: its sensor is binned and has the chosen analog gain.
        mean: Mean electrons of each pixel before binning, a device array (rows, cols) or, for stacked pixels, (C, rows,
            cols) [e-].
        chip_mean: The same with the chip's fixed pattern; noise is added to it, see `Readout.chip_mean` [e-].
        exposure_time: Exposure time [s].
        gain: Analog gain chosen by automatic exposure [1].
        rendering: Conversion of camera values to colours, for the known or assumed light.
        simulator: The Simulator that made it and makes its frames.
        blur: Standard deviation of the lens blur as a Gaussian, if the camera uses it [pixel].
        shading: Gains of the shading correction at its nodes, if the camera uses them.
        ms: Milliseconds per stage.
        wall_ms: Milliseconds in all, planning included.
        is_rewritten: True if a loop will write to these arrays again.
        brightness: Factor on the light of the plan's scene [1].
        kernel: The camera's own blur, if its processor sharpens, see `processor.sharpen`.
    """

    plan: Plan
    camera: Camera
    mean: Any
    chip_mean: Any
    exposure_time: float
    gain: float
    rendering: Rendering
    simulator: "Simulator"
    blur: float = 0.0
    shading: np.ndarray | None = None
    ms: dict = dataclasses.field(default_factory=dict)
    wall_ms: float = 0.0
    is_rewritten: bool = False
    brightness: float = 1.0
    kernel: np.ndarray | None = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.mean, dtype, copy=copy)

    def __repr__(self):
        return shorten_repr(
            f"Exposure({self.plan.scene.name} by {self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"gain {self.gain:g}, mean {tuple(self.mean.shape)} on {self.device.name})"
        )

    @property
    def device(self) -> Device:
        """Device of the arrays."""
        return self.simulator.device

    @cached_property
    def labels(self) -> dict[str, np.ndarray]:
        """Labels and depth of the scene at the pixels, see `gpusim.carry_labels`."""
        seen_by = replace(self.plan.camera, processor=self.camera.processor)
        return carry_labels(self.plan.scene, seen_by)

    def split_layers(self, raw: Any) -> Any:
        """Return raw values with the layers of stacked pixels on an axis.

        Args:
            raw: Raw values (..., rows, cols), layers below each other.

        Returns:
            Raw values (..., C, rows, cols); for other sensors unchanged.
        """
        return raw.reshape(*raw.shape[:-2], *self.mean.shape[:-2], -1, raw.shape[-1])

    def raw(self, *, seed: int = 0, first: int = 0, frames: int | None = None) -> Any:
        """Add noise to `chip_mean`. For equal means the result is identical on all devices.

        Args:
            seed: Seed of the noise.
            first: Number of the frame, or of the first one.
            frames: Number of frames; None draws one without the first axis.

        Returns:
            Raw values, a device array (frames, rows, cols) or (rows, cols) [DN]. Layers of stacked pixels are below
            each other.

        Raises:
            DoesNotFit: The frames need more memory than the device has.
            OutOfRange: The seed or a number is not allowed.
        """
        draw = self.simulator.readout.draw
        return draw(self.chip_mean, self.exposure_time, self.gain, seed, first, frames)

    @cached_property
    def diodes(self) -> Any:
        """Mean electrons of the photodiodes of dual or quad pixels, a device array (n, rows, cols) [e-].

        For stacked pixels (n, C, rows, cols). They are in the order of `camera.sensor.dual.diodes`, before binning, and
        add up to `mean`. Raises Conflict if the camera's pixels are not divided.
        """
        divided(self.simulator.camera)
        simulator, scene = self.simulator, self.plan.scene
        made = simulator.diodes_of(scene.shape)
        loops = [
            one.loop(scene, self.exposure_time, self.gain).update(brightness=self.brightness)
            for one in made.simulators
        ]
        parts = [loop.output("mean") for loop in loops]
        return made.divide(self.mean, parts, [loop.plan for loop in loops], self.device)

    def raw_dual(self, *, seed: int = 0, first: int = 0, frames: int | None = None) -> Any:
        """Return raw values of the photodiodes of dual or quad pixels, each read with its own noise.

        A diode has an equal part of the pixel's full well and dark current. The frame's `raw` is another reading, of
        all light of a pixel at once.

        Args:
            seed: Seed of the noise.
            first: Number of the frame, or of the first one.
            frames: Number of frames; None draws one without the first axis.

        Returns:
            A device array (n, rows, cols), or (frames, n, rows, cols) [DN], in the order of `diodes`. Layers of stacked
            pixels are below each other.

        Raises:
            Conflict: The camera's pixels are not divided.
            DoesNotFit: The frames need more memory than the device has.
            OutOfRange: The seed or a number is not allowed, or binned blocks do not fill the frame's rows.
        """
        simulator, means = self.simulator, self.diodes
        made = simulator.diodes_of(self.plan.scene.shape)
        return made.draw(simulator, means, self.exposure_time, self.gain, seed, first, frames)

    def develop(self, raw: Any) -> tuple[Any, Any]:
        """Develop raw values. Those of a sensor without a converter are first rounded to 16 bits.

        Args:
            raw: Raw values of this exposure, a device array (rows, cols) [DN].

        Returns:
            Linear display RGB (3, rows, cols) before the tone curve, and display codes (rows, cols, 3), device arrays.
        """
        values = self.values()
        return output_of(values, "linear", raw=raw), values["codes"]

    def codes(self, raw: Any = None, *, seed: int = 0, first: int = 0) -> Any:
        """Return the display codes of one frame. They are made in one pass if the camera allows it.

        Args:
            raw: Raw values of this exposure, a device array (rows, cols) [DN]. None draws them.
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            Display codes, a device array (rows, cols, 3), uint8.
        """
        raw = self.raw(seed=seed, first=first) if raw is None else raw
        return output_of(self.values(), "codes", raw=raw)

    def frame(self, *, seed: int = 0, first: int = 0, error: Error | None = None) -> Frame:
        """Return one noisy picture with its report, see `frames`.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.
            error: True error of the mean electrons for the report, if known.

        Returns:
            The picture.
        """
        return next(self.frames(seed=seed, first=first, error=error))

    def frames(
        self, count: int = 1, *, seed: int = 0, first: int = 0, error: Error | None = None
    ) -> Iterator[Frame]:
        """Yield noisy frames. The first one's report has the exposure's times.

        Args:
            count: Number of frames.
            seed: Seed of the noise.
            first: Number of the first frame.
            error: True error of the mean electrons for the report, if known.

        Yields:
            The frames, in order.
        """
        checked_count("count of frames", count)
        values = self.values()
        for number in range(first, first + count):
            yield make_frame(self, values, seed, number, error, is_timed=number == first)

    def values(self) -> Values:
        """Return values for frames of this exposure.

        Returns:
            New values, which are not stored.
        """
        simulator, camera = self.simulator, self.camera
        steps = [*exposure_steps(simulator, self.plan), *picture_steps(simulator, camera)]
        values = Values.of(steps, simulator.tables)
        values.give(
            mean=self.mean,
            chip_mean=self.chip_mean,
            rendering=self.rendering,
            shading=self.shading,
            blur=self.blur,
            kernel=self.kernel,
            sensor=camera.sensor,
        )
        values.set_numbers(
            **exposure_numbers(
                simulator, camera.sensor, self.exposure_time, self.gain, self.brightness
            )
        )
        return values

    def __getstate__(self):
        return self.__dict__ | {
            name: np.array(self.device.numpy(getattr(self, name))) for name in ON_DEVICE
        }

    def __setstate__(self, state):
        device = state["simulator"].device
        arrays = {name: device.array(state[name], state[name].dtype) for name in ON_DEVICE}
        self.__dict__.update(state, **arrays, is_rewritten=False)


def expose_values(
    values: Values,
    simulator: "Simulator",
    plan: Plan,
    camera: Camera,
    seconds: float,
    gain: float,
    is_rewritten: bool = False,
    brightness: float = 1.0,
) -> Exposure:
    """Return the exposure that values of its steps make, without its computing times.

    Args:
        values: Values that use the steps of `exposure_steps`.
        simulator: The simulator.
        plan: Plan of the scene.
        camera: The camera as operated.
        seconds: Exposure time [s].
        gain: Analog gain, next to the sensor's [1].
        is_rewritten: Whether the next exposure will write to its arrays.
        brightness: Factor on the scene's light [1].

    Returns:
        The exposure.
    """
    values.give(sensor=camera.sensor)
    values.set_numbers(**exposure_numbers(simulator, camera.sensor, seconds, gain, brightness))
    return Exposure(
        plan,
        camera,
        values["mean"],
        values["chip_mean"],
        seconds,
        gain,
        values["rendering"],
        simulator,
        values["blur"] or 0.0,
        values["shading"],
        is_rewritten=is_rewritten,
        brightness=brightness,
        kernel=values["kernel"],
    )


def expose_mean(
    simulator: "Simulator", plan: Plan, mean: Any, seconds: float, gain: float
) -> Exposure:
    """Return the exposure for given mean electrons, without its computing times.

    Args:
        simulator: The simulator.
        plan: Plan of the scene.
        mean: Mean electrons, an array of the device [e-].
        seconds: Exposure time [s].
        gain: Analog gain, next to the sensor's [1].

    Returns:
        The exposure.
    """
    camera = operated_camera(simulator.camera, simulator.readout, gain)
    values = Values.of(exposure_steps(simulator, plan), simulator.tables)
    values.give(mean=mean)
    return expose_values(values, simulator, plan, camera, seconds, gain)


def expose_phase_pixels(exposure: Exposure) -> Exposure:
    """Return an exposure in which phase-detection pixels hold the electrons of their half of the pupil."""
    simulator, scene, device = exposure.simulator, exposure.plan.scene, exposure.device
    dual, made = simulator.camera.sensor.dual, simulator.diodes_of(scene.shape)
    assert dual is not None
    parts = {}
    for number, one in enumerate(made.simulators):
        loop = one.loop(scene, exposure.exposure_time, exposure.gain)
        part = np.array(device.numpy(loop.output("mean")), np.float32)
        parts[made.names[number]] = part, made.shares(number, loop.plan)
    mean = put_phase_pixels(np.array(device.numpy(exposure.mean), np.float32), parts, dual)
    own = expose_mean(
        simulator, exposure.plan, device.array(mean), exposure.exposure_time, exposure.gain
    )
    return replace(own, ms=exposure.ms, wall_ms=exposure.wall_ms)


def operated_camera(camera: Camera, readout: Readout, gain: float) -> Camera:
    """Return a camera as operated: its sensor binned, with its analog gain multiplied by `gain`."""
    return replace(camera, sensor=readout.sensor_at_gain(gain))


def output_of(values: Values, name: str, seed: int = 0, first: int = 0, raw: Any = None) -> Any:
    """Return a value of one frame by its name, for example "raw", "linear" or "codes".

    raw: raw values of the frame; None draws them.
    """
    if raw is None:
        values.withdraw("raw")
        values.set_numbers(seed=seed, frame=first)
    else:
        values.give(raw=raw)
    return values["codes at once" if name == "codes" and "codes at once" in values else name]


def make_frame(
    exposure: Exposure,
    values: Values,
    seed: int,
    number: int,
    error: Error | None = None,
    is_timed: bool = True,
    raw: Any = None,
    single: Any = None,
) -> Frame:
    """Return one picture of an exposure. Its parts are computed lazily unless a loop rewrites the arrays.

    Args:
        exposure: The exposure.
        values: Values that use the exposure's steps.
        seed: Seed of the noise.
        number: Number of the frame.
        error: True error of the mean electrons, if known.
        is_timed: Count the exposure's times in this picture.
        raw: Raw values, a device array with layers of stacked pixels below each other; None draws them.
        single: Those of single pixels before digital binning; None draws them if they are asked for.

    Raises:
        OutOfRange: The seed or the number is not allowed. Other errors are raised when a part is computed.
    """
    check_drawn(seed, number, None, 0)  # now, not when raw values are computed
    shot = _Shot(exposure, values, seed, number, error, is_timed, single)
    if raw is not None:
        shot.raw = raw
    frame = Frame(
        exposure.camera,
        exposure.exposure_time,
        rendering=shot,
        mean=shot,
        raw=shot,
        linear=shot,
        rgb=shot,
        report=shot,
        labels=shot,
        blur=exposure.blur,
        shading=None if exposure.shading is None else np.array(exposure.shading),
        averaged=exposure.simulator.readout.averaged,
        full=shot if exposure.simulator.readout.averaged > 1 else None,
        kernel=exposure.kernel,
    )
    return frame.complete() if exposure.is_rewritten else frame


class _Shot(Parts):
    """One picture while it is computed. ms: milliseconds per stage so far. wall_ms: in all."""

    def __init__(self, exposure, values, seed, number, error, is_timed, single):
        self.exposure, self.values, self.error = exposure, values, error
        self.seed, self.number, self.single = seed, number, single
        self.ms, self.wall_ms = (dict(exposure.ms), exposure.wall_ms) if is_timed else ({}, 0.0)
        self.single: Any = None

    @cached_property
    def raw(self):
        return output_of(self.values, "raw", self.seed, self.number)

    @cached_property
    def developed(self):
        """Linear display RGB, display codes and the rendering."""
        linear = output_of(self.values, "linear", raw=self.raw)
        return linear, self.values["codes"], self.values[rendering_name(self.exposure.camera)]

    def compute(self, name, frame):
        """Return a part of the frame. Its times are added."""
        if name == "labels":
            return self.exposure.labels
        if name == "full":
            return self._full()
        if name == "report":
            frame.rendering, frame.mean, frame.raw, frame.linear, frame.rgb  # noqa: B018  for their times
            return self._report(frame)
        start, device = time.perf_counter(), self.exposure.simulator.device
        with device.timed() as ms:
            if name == "mean":
                value = np.array(self.values["mean of pixels"])
            elif name == "raw":
                value = self.exposure.split_layers(np.array(device.numpy(self.raw)))
            elif name == "linear":
                planes = np.array(device.numpy(self.developed[0]), np.float32)
                value = np.moveaxis(planes, 0, -1)
            elif name == "rgb":
                value = np.array(device.numpy(self.developed[1]))
            else:
                value = self.developed[2]
        for stage, spent in ms.items():
            self.ms[stage] = self.ms.get(stage, 0.0) + spent
        self.wall_ms += 1e3 * (time.perf_counter() - start)
        return value

    def _full(self):
        exposure, single = self.exposure, self.single
        readout = exposure.simulator.readout
        if single is None:
            settings = exposure.exposure_time, exposure.gain, self.seed, self.number
            single = readout.draw(exposure.chip_mean, *settings, is_averaged=False)
        return exposure.split_layers(readout.find_full(single, exposure.gain))

    def _report(self, frame):
        """Return the report. All other parts of the frame are computed."""
        exposure, times = self.exposure, self.ms
        simulator, camera = exposure.simulator, exposure.camera
        plan, scene = exposure.plan, exposure.plan.scene
        words = {step.stage: step.words for step in self.values.steps.values() if step.words}
        models = plan.models | words | {"processor.color": frame.rendering.model}
        if "sensor.meter" in times:
            models["sensor.meter"] = (
                "light statistics"
                if camera.sensor.exposure_time is not None
                else f"automatic exposure, {camera.sensor.auto_exposure.method}"
            )
        simulator.launched = merge_names(simulator.launched, times)
        order = merge_names(simulator.launched, models)  # also stages that did no work
        stages = [
            StageReport(name, models.get(name, ""), times.get(name, 0.0))
            for name in order
            if name in models or name in times
        ]
        unbinned = replace(simulator.camera.sensor, analog_gain=camera.sensor.analog_gain)
        account = plan.account.at(exposure.exposure_time * exposure.brightness)
        verdict = plan.verdict and account.verdict(simulator.tolerance, plan.verdict.remedy)
        return Report(
            {
                "name": scene.name,
                "rows": scene.shape[0],
                "cols": scene.shape[1],
                "form": scene.content.form,
                "border": scene.border,
                "samples_per_pixel": scene.samples_per_pixel,
                "wavelengths_nm": [float(scene.wavelengths[0]), float(scene.wavelengths[-1])],
                "bands": len(scene.wavelengths),
            },
            {
                "name": camera.name,
                "f_number": camera.optics.f_number,
                "exposure_time_s": exposure.exposure_time,
                "analog_gain": camera.sensor.analog_gain,
                "iso": simulator.cache("speed", iso_speed, unbinned),
                "exposure_value": float(
                    exposure_value(camera.optics.f_number, exposure.exposure_time)
                ),
            },
            {"name": simulator.device.name, "kind": simulator.device.kind},
            self.number,
            self.seed,
            stages,
            account,
            plan.beside,
            plan.left_out,
            self.error,
            simulator.tolerance,
            self._notes(frame),
            verdict,
            self.wall_ms,
            plan.name,
        )

    def _notes(self, frame):
        """Return the report's notes on the picture, the scene, the plan and the true error."""
        plan, processor = self.exposure.plan, self.exposure.camera.processor
        seen = describe_brightness(
            frame.rgb, frame.mean, frame.exposure_time, self.exposure.camera.sensor
        )
        notes = [seen] if seen else []
        if not plan.scene.light_is_known:
            white = ", saturation is display white" if processor.scaling == "normalised" else ""
            notes.append(
                f"the scene's light is unknown: colours are rendered for {processor.target}{white}"
            )
        if processor.lens_corrections and not find_correction(self.exposure.camera).is_needed:
            notes.append(
                "lens corrections: the lens has neither distortion nor lateral colour, nothing is to correct"
            )
        light = plan.scene.illuminant
        if plan.scene.light_is_known and not light.quantity and light.values.max() < DARKEST:
            notes.append(
                f"light of at most {light.values.max():.3g} photon s-1 m-2 sr-1 nm-1 is darker than any night: if it "
                "is relative, gs.scene_from(cube, wavelengths, light=..., luminance=100) gives it a scale"
            )
        camera = self.exposure.camera
        lens = getattr(camera.optics.distortion, "notes", ())
        notes += dict.fromkeys((*plan.scene.notes, *camera.notes, *camera.sensor.notes, *lens))
        if plan.planned_for:
            own = f": all predicted errors except {plan.watched} are for that scene"
            notes.append(
                f"planned for {plan.planned_for}, a scene of the same kind{'' if plan.probed else own}"
            )
        if plan.given_of:
            notes.append(
                f"the plan was given and made for {plan.given_of}: all predicted errors are for this scene"
            )
        if plan.probed:
            notes.append(f"probes: {plan.probed}")
        if self.error is not None and self.error.places:
            notes.append(f"the true error is for {self.error.places}")
        return notes


def merge_names(order: list[str], names) -> list[str]:
    """Return an order of names with new names merged into it.

    A new name goes before the next known name of `names`, or else after the one before.
    """
    order, names = list(order), list(names)
    for number, name in enumerate(names):
        if name not in order:
            after = next(
                (order.index(other) for other in names[number + 1 :] if other in order), None
            )
            before = order.index(names[number - 1]) + 1 if number else len(order)
            order.insert(before if after is None else after, name)
    return order
