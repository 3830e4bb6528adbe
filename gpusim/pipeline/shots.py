"""Frames of an exposure: noise, development and report."""

import time
from dataclasses import replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from gpusim.color.rendering import choose_colors, render_exposure
from gpusim.color.speed import iso_speed
from gpusim.domain.exposure import exposure_value
from gpusim.domain.sensor import Sensor
from gpusim.kernels.processor.color import color
from gpusim.kernels.sensor.noise import check_drawn
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.frame import Exposure, Frame, Later
from gpusim.pipeline.imaging import return_none
from gpusim.pipeline.metering import metering_steps
from gpusim.pipeline.readout import Readout, flag_pixels
from gpusim.pipeline.report import Error, Report, StageReport, merge_names
from gpusim.pipeline.step import Rate, Step, Values
from gpusim.pipeline.tables import LensTables
from gpusim.planner.plan import Plan

HOT = 3.0  # a hot pixel's charge beyond the common dark current, in standard deviations of the read noise


def exposure_steps(simulator, plan: Plan) -> list[Step]:
    """Return the steps of a plan's exposures, from the scene to digital numbers.

    They use the values "content", "view" and "sensor" (the sensor as operated), and the numbers of
    `exposure_numbers`.
    """
    camera, readout, imaging = simulator.camera, simulator.readout, simulator.imaging
    processor, sensor, scene = camera.processor, camera.sensor, plan.scene
    layers = (len(sensor.channels),) if sensor.stacked else ()
    without_tone = replace(camera, processor=replace(processor, tone=()))
    steps = [
        *imaging.steps(plan),
        *metering_steps(plan, sensor, readout),
        *readout.steps((*layers, *scene.shape)),
        Step(
            "transforms",
            "",
            (),
            {
                "white_rate": plan.white_rate,
                "light": scene.illuminant if scene.light_is_known else None,
                "camera": without_tone,
                "cache": simulator.cache,
            },
            rate=Rate.EXPOSURE,
            run=choose_colors,
        ),
        Step(
            "rendering",
            "",
            ("transforms", "sensor"),
            {"scaling": processor.scaling, "pixels": readout.pixels},
            ("exposure_time",),
            rate=Rate.EXPOSURE,
            run=render_exposure,
        ),
        Step("blur", "", run=return_none, rate=Rate.EXPOSURE),
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
    if processor.demosaic == "best":
        constants = {"plan": plan, "tables": imaging.tables}
        steps.append(
            Step("blur", "", (), constants, rate=Rate.EXPOSURE, run=LensTables.deviation_of)
        )
    known = {step.output for step in steps}
    response = "response" if "response" in known and sensor.noise.dead_pixels else ""
    dark = "dark" if "dark" in known else ""
    if processor.defects == "known" and (response or dark):
        constants = {
            "binning": sensor.binning,
            "stride": readout.stride,
            "device": simulator.device,
        }
        steps.append(
            Step(
                "defects",
                "",
                (response, dark, "sensor"),
                constants,
                ("dark_time",),
                rate=Rate.EXPOSURE,
                run=flag_defects,
            )
        )
    else:
        steps.append(Step("defects", "", run=return_none, rate=Rate.EXPOSURE))
    return steps


def picture_steps(simulator, camera) -> list[Step]:
    """Return the steps from digital numbers "raw" to pictures. camera: as operated."""
    readout, device = simulator.readout, simulator.device
    developer = Developer(camera, device, readout.averaged, simulator.cache)
    layers = len(camera.sensor.channels) if camera.sensor.stacked else 1
    steps = developer.steps((layers, 1))
    constants = {"matrix": camera.display.xyz_from_rgb, "device": device}
    steps.append(Step("xyz", "", ("linear",), constants, rate=Rate.FRAME, run=convert_to_xyz))
    return [*steps, developer.codes_at_once()] if camera.is_developed_at_once else steps


def exposure_numbers(simulator, seconds: float, gain: float) -> dict[str, float]:
    """Return the numbers of an exposure by name. seconds: exposure time [s]. gain: the exposure's analog gain."""
    readout = simulator.readout
    times = {"exposure_time": seconds, "dark_time": readout.dark_time(seconds)}
    return times | readout.numbers(seconds, gain)


def flag_defects(response, dark, sensor: Sensor, *, binning, stride, device, dark_time) -> Any:
    """Return the map of the chip's dead pixels and of the pixels that are hot in this exposure."""
    return flag_pixels(
        response,
        dark,
        least=HOT * sensor.read_sigma,
        dark_time=dark_time,
        binning=binning,
        stride=stride,
        device=device,
    )


def read_mean(mean, *, readout: Readout) -> np.ndarray:
    """Return the mean electrons of the output pixels, NumPy float32 (..., rows, cols) [e-]."""
    shape = tuple(mean.shape)
    found = readout.mean(readout.device.reshape(mean, (prod(shape[:-1]), shape[-1])))
    return found.reshape(*shape[:-2], -1, found.shape[-1])


def convert_to_xyz(linear, *, matrix, device) -> Any:
    """Return CIE XYZ of linear display RGB (3, rows, cols)."""
    return color(linear, device.array(matrix), device=device)


class Shots:
    """Frames of one exposure. Arrays are device arrays, with layers of stacked pixels below each other.

    values: values that use the exposure's steps; by default new ones.
    """

    def __init__(self, simulator, exposure: Exposure, values: Values | None = None):
        self.simulator, self.exposure = simulator, exposure
        if values is None:
            values = Values({rate: Cache() for rate in Rate} | {Rate.CAMERA: simulator.tables})
            values.use(
                [
                    *exposure_steps(simulator, exposure.plan),
                    *picture_steps(simulator, exposure.camera),
                ]
            )
            names = ("mean", "chip_mean", "rendering", "shading", "blur")
            values.give(**{name: getattr(exposure, name) for name in names})
            values.give(sensor=exposure.camera.sensor)
            numbers = exposure_numbers(simulator, exposure.exposure_time, exposure.gain)
            values.set_numbers(**numbers)
        self.values = values

    def raw(self, seed: int = 0, first: int = 0) -> Any:
        """Return the digital numbers (rows, cols) of one frame."""
        self.values.withdraw("raw")
        self.values.set_numbers(seed=seed, frame=first)
        return self.values["raw"]

    def _value_of(self, raw, name):
        self.values.give(raw=raw)
        return self.values[name]

    @property
    def developer(self) -> Developer:
        """The camera's image processor."""
        simulator = self.simulator
        return Developer(
            self.exposure.camera, simulator.device, simulator.readout.averaged, simulator.cache
        )

    @property
    def defects(self) -> Any:
        """Map of the chip's defects on the device; None if the camera does not use it, or there are none."""
        return self.values["defects"]

    def planes(self, raw) -> Any:
        """Return camera values of each pixel, (C, rows, cols)."""
        return self._value_of(raw, "camera")

    def linear(self, raw) -> tuple:
        """Return linear display RGB (3, rows, cols), before clipping and tone curve, and its rendering."""
        is_estimated = self.exposure.camera.processor.estimates_white
        rendering = "picture rendering" if is_estimated else "rendering"
        return self._value_of(raw, "linear"), self.values[rendering]

    def develop(self, raw) -> tuple:
        """Return linear display RGB, display codes (rows, cols, 3), and the rendering."""
        shown, rendering = self.linear(raw)
        return shown, self.values["codes"], rendering

    def codes(self, raw) -> Any:
        """Return display codes (rows, cols, 3), in one pass if the camera allows it."""
        return self._value_of(raw, "codes at once" if "codes at once" in self.values else "codes")

    def frame(
        self, *, seed: int = 0, first: int = 0, error: Error | None = None, is_timed: bool = True
    ) -> Frame:
        """Return one picture with its report. Its parts are computed lazily unless a program rewrites the arrays.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.
            error: True error of the mean electrons, if known.
            is_timed: Count the exposure's times in this picture.

        Raises:
            OutOfRange: The seed or the number is not allowed. Other errors are raised when a part is computed.
        """
        check_drawn(seed, first, None, 0)  # now, not when raw values are computed
        exposure, shot = self.exposure, _Shot(self, seed, first, is_timed)

        def report():
            wanted.rendering, wanted.mean, wanted.raw, wanted.linear, wanted.rgb  # noqa: B018  for their times
            return self._build_report(wanted.rendering, shot.ms, shot.wall_ms, seed, first, error)

        shading = None if exposure.shading is None else np.array(exposure.shading)
        wanted = Frame(
            exposure.camera,
            exposure.exposure_time,
            Later(lambda: shot.developed[2]),
            Later(lambda: shot.measure(self.mean_of_pixels)),
            Later(lambda: exposure.split_layers(shot.copy_to_host(shot.raw))),
            Later(lambda: np.moveaxis(shot.copy_to_host(shot.developed[0], np.float32), 0, -1)),
            Later(lambda: shot.copy_to_host(shot.developed[1])),
            Later(report),
            exposure.blur,
            shading,
            self.simulator.readout.averaged,
        )
        return wanted.complete() if exposure.is_rewritten else wanted

    def mean_of_pixels(self) -> np.ndarray:
        """Return the mean electrons of the output pixels, NumPy float32 [e-]."""
        return np.array(self.values["mean of pixels"])

    @property
    def _speed(self):
        # for the sensor before binning
        own = replace(
            self.simulator.camera.sensor, analog_gain=self.exposure.camera.sensor.analog_gain
        )
        return self.simulator.cache("speed", iso_speed, own)

    def _build_report(self, rendering, times, wall, seed, number, error):
        exposure, simulator, camera = self.exposure, self.simulator, self.exposure.camera
        plan, scene = exposure.plan, exposure.plan.scene
        lines = {
            step.stage: step.words
            for step in (
                *simulator.readout.steps(tuple(exposure.mean.shape)),
                *self.developer.steps((1, 1)),
            )
            if step.words
        }
        models = plan.models | lines | {"processor.color": rendering.model}
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
        white = ", saturation is display white" if camera.processor.scaling == "normalised" else ""
        account = plan.account.at(exposure.exposure_time)
        verdict = plan.verdict and account.verdict(simulator.tolerance, plan.verdict.remedy)
        notes = (
            []
            if scene.light_is_known
            else [
                "the scene's light is unknown: colours are rendered for "
                f"{camera.processor.target}{white}"
            ]
        )
        notes += scene.notes
        if plan.planned_for:
            notes.append(
                f"planned for {plan.planned_for}, a scene of the same kind: all predicted errors except "
                f"{'planes' if plan.mix is not None else 'blur left out'} are for that scene"
            )
        if plan.given_of:
            notes.append(
                f"the plan was given and made for {plan.given_of}: all predicted errors are for this scene"
            )
        if plan.probed:
            notes.append(f"probes: {plan.probed}")
        if error is not None and error.places:
            notes.append(f"the true error is for {error.places}")
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
                "iso": self._speed,
                "exposure_value": float(
                    exposure_value(camera.optics.f_number, exposure.exposure_time)
                ),
            },
            {"name": simulator.device.name, "kind": simulator.device.kind},
            number,
            seed,
            stages,
            account,
            plan.beside,
            plan.left_out,
            error,
            simulator.tolerance,
            notes,
            verdict,
            wall,
            plan.name,
        )


class _Shot:
    """One picture while it is computed. ms: milliseconds per stage so far. wall_ms: in all.

    is_timed: count the exposure's times in this picture.
    """

    def __init__(self, shots: Shots, seed: int, frame: int, is_timed: bool):
        self._shots, self._seed, self._frame, exposure = shots, seed, frame, shots.exposure
        self.ms, self.wall_ms = (dict(exposure.ms), exposure.wall_ms) if is_timed else ({}, 0.0)

    @cached_property
    def raw(self):
        return self.measure(lambda: self._shots.raw(self._seed, self._frame))

    @cached_property
    def developed(self):
        """Result of `Shots.develop`."""
        raw = self.raw
        return self.measure(lambda: self._shots.develop(raw))

    def copy_to_host(self, array, kind=None):
        """Return a device array as NumPy. kind: its new type, or None."""
        return self.measure(lambda: np.array(self._shots.simulator.device.numpy(array), kind))

    def measure(self, make):
        """Return `make()`, and add its times."""
        start = time.perf_counter()
        with self._shots.simulator.device.timed() as ms:
            value = make()
        for stage, spent in ms.items():
            self.ms[stage] = self.ms.get(stage, 0.0) + spent
        self.wall_ms += 1e3 * (time.perf_counter() - start)
        return value
