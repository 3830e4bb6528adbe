"""From an exposure on: frames are drawn, processed and reported; what a change does not touch is kept."""

import time
from dataclasses import replace
from functools import cached_property

import numpy as np

from gpusim.color.rendering import transforms_by, transforms_of, without_tone
from gpusim.color.speed import iso_speed
from gpusim.domain.exposure import exposure_value
from gpusim.kernels.sensor.noise import check_drawn, redraw
from gpusim.pipeline.cache import Kept, One
from gpusim.pipeline.developer import Developer, edges_of
from gpusim.pipeline.frame import Exposure, Frame, Later
from gpusim.pipeline.report import Error, Report, StageReport, merged

HOT = 3.0  # [standard deviation of a read] of electrons beyond the common dark current: a pixel to be replaced


class Shots:
    """Frames of one exposure by a Simulator. Arrays are the device's, layers of stacked pixels one below the other.

    kept: what the steps gave before, for this exposure or one alike.
    """

    def __init__(self, simulator, exposure: Exposure, kept: Kept | None = None):
        self.simulator, self.exposure = simulator, exposure
        self._kept = Kept() if kept is None else kept

    def raw(self, seed: int = 0, frame: int = 0):
        """Digital numbers (rows, cols) of one frame."""
        exposure, readout = self.exposure, self.simulator.readout
        seconds, gain = exposure.exposure_time, exposure.gain
        of = self._kept.one(exposure.chip_mean), One(readout), (seconds, gain, seed, frame)
        return self._kept(
            "raw",
            of,
            lambda: readout.draw(exposure.chip_mean, seconds, gain=gain, seed=seed, frame=frame),
            lambda tape: redraw(tape, seed, frame, **readout.numbers(seconds, gain)),
        )

    @property
    def developer(self) -> Developer:
        """The camera's image processor."""
        simulator, camera = self.simulator, self.exposure.camera
        sensor = camera.sensor
        kept, averaged = simulator.kept, simulator.readout.averaged
        of = One(sensor), camera.optics, camera.processor, camera.display, averaged

        def transforms():
            return kept("transforms", transforms_by(camera), lambda: transforms_of(camera))

        return kept(
            "developer",
            of,
            lambda: Developer(
                camera,
                simulator.device,
                averaged,
                transforms,
                kept(
                    "edges of codes",
                    (camera.display, camera.processor.tone),
                    lambda: edges_of(camera),
                ),
            ),
        )

    @property
    def defects(self):
        """Map of the chip's dead pixels and of those whose own current shows in this exposure, on the device.

        None where it is not asked for, or the chip has none.
        """
        exposure, readout = self.exposure, self.simulator.readout
        if exposure.camera.processor.defects != "known":
            return None
        shape, seconds, sensor = (
            tuple(exposure.mean.shape),
            exposure.exposure_time,
            exposure.camera.sensor,
        )
        return self._kept(
            "defects",
            (shape, seconds, sensor, readout.sensor),
            lambda: readout.flags(shape, seconds, HOT * sensor.read_sigma),
        )

    def planes(self, raw):
        """Camera values of every pixel, (C, rows, cols): see `Developer.demosaicked`."""
        exposure, processor, known = self.exposure, self.exposure.camera.processor, self.defects
        white, shading, blur = exposure.rendering.neutral, exposure.shading, exposure.blur
        asked = (
            processor.demosaic,
            processor.table,
            processor.denoise,
            processor.defects,
            white,
            shading,
            blur,
        )
        sensor = exposure.camera.sensor
        knows_noise = (
            processor.denoise
            or processor.defects != "none"
            or processor.demosaic in ("best", "learned")
        )
        of = (
            self._kept.one(raw),
            self._kept.one(known),
            self._numbers,
            One(sensor) if knows_noise else None,
        )
        return self._kept(
            "camera planes",
            (*of, *asked),
            lambda: self.developer.demosaicked(
                raw, white=white, known=known, shading=shading, blur=blur
            ),
        )

    @property
    def _numbers(self):
        """What digital numbers mean, but for their noise, as a part of a key."""
        sensor = self.exposure.camera.sensor
        return (
            sensor.cfa,
            sensor.channels,
            sensor.stacked,
            sensor.bits,
            sensor.dark_level,
            sensor.white_level,
            self.simulator.readout.averaged,
        )

    def linear(self, raw):
        """Linear display RGB (3, rows, cols), before clipping and tone curve, and the rendering that it is by."""
        kept, planes, rendering, camera = (
            self._kept,
            self.planes(raw),
            self.exposure.rendering,
            self.exposure.camera,
        )
        if camera.processor.estimates_white:
            once = rendering
            by = (
                without_tone(camera.processor),
                camera.display,
                One(camera.sensor),
                camera.optics.transmission,
            )
            rendering = kept(
                "white",
                (kept.one(planes), One(once), *by),
                lambda: self.developer.balanced(planes, once),
            )
        of = kept.one(planes), rendering.display_from_camera, rendering.ceiling
        return kept("linear", of, lambda: self.developer.colored(planes, rendering)), rendering

    def developed(self, raw):
        """Linear display RGB, display codes (rows, cols, 3), and the rendering."""
        shown, rendering = self.linear(raw)
        camera = self.exposure.camera
        codes = self._kept(
            "codes",
            (self._kept.one(shown), camera.processor.tone, camera.display),
            lambda: self.developer.encoded(shown),
        )
        return shown, codes, rendering

    def codes(self, raw):
        """Display codes (rows, cols, 3) alone: in one pass where the camera allows it."""
        camera, rendering = self.exposure.camera, self.exposure.rendering
        if not camera.is_developed_at_once:
            return self.developed(raw)[1]
        of = (
            self._kept.one(raw),
            self._numbers,
            rendering.display_from_camera,
            rendering.ceiling,
            camera.processor.tone,
            camera.display,
        )
        return self._kept("at once", of, lambda: self.developer.in_one_pass(raw, rendering))

    def frame(
        self, *, seed: int = 0, frame: int = 0, error: Error | None = None, first: bool = True
    ) -> Frame:
        """One picture with its report. error: of the mean electrons, where known. first: of this exposure.

        It is made as far as it is asked for, unless a program will write to the exposure's arrays before. Raises
        OutOfRange, for what is wrong with the rest when that is asked for.
        """
        check_drawn(seed, frame, None, 0)  # now, not when it is asked for
        exposure, shot = self.exposure, _Shot(self, seed, frame, first)

        def report():
            wanted.rendering, wanted.mean, wanted.raw, wanted.linear, wanted.rgb  # noqa: B018  for their times
            return self._report(wanted.rendering, shot.ms, shot.wall_ms, seed, frame, error)

        shading = None if exposure.shading is None else np.array(exposure.shading)
        wanted = Frame(
            exposure.camera,
            exposure.exposure_time,
            Later(lambda: shot.developed[2]),
            Later(lambda: shot.timed(self.mean_of_pixels)),
            Later(lambda: exposure.layered(shot.copied(shot.raw))),
            Later(lambda: np.moveaxis(shot.copied(shot.developed[0], np.float32), 0, -1)),
            Later(lambda: shot.copied(shot.developed[1])),
            Later(report),
            exposure.blur,
            shading,
            self.simulator.readout.averaged,
        )
        return wanted.complete() if exposure.is_rewritten else wanted

    def mean_of_pixels(self) -> np.ndarray:
        """Mean electrons of the pixels as they are read, NumPy, float32 [e-]."""
        of = self._kept.one(self.exposure.mean), self.simulator.readout.sensor
        return np.array(self._kept("mean of pixels", of, self._mean))

    def _mean(self):
        exposure, shape = self.exposure, self.exposure.mean.shape
        mean = self.simulator.device.reshape(exposure.mean, (int(np.prod(shape[:-1])), shape[-1]))
        return exposure.layered(self.simulator.readout.mean(mean))

    @property
    def _speed(self):
        # of the sensor as it is, not as binned
        own = replace(
            self.simulator.camera.sensor, analog_gain=self.exposure.camera.sensor.analog_gain
        )
        return self.simulator.kept("speed", own, lambda: iso_speed(own))

    def _report(self, rendering, times, wall, seed, number, error):
        exposure, simulator, camera = self.exposure, self.simulator, self.exposure.camera
        plan, scene = exposure.plan, exposure.plan.scene
        shown = f"{camera.display.name}, 8 bit" + (
            ", with a tone curve" if camera.processor.tone else ""
        )
        models = (
            plan.models
            | simulator.readout.models()
            | self.developer.models()
            | {"processor.color": rendering.model, "display.encode": shown}
        )
        if "sensor.meter" in times:
            models["sensor.meter"] = (
                "light looked at"
                if camera.sensor.exposure_time is not None
                else f"automatic exposure, {camera.sensor.auto_exposure.method}"
            )
        simulator.launched = merged(simulator.launched, times)
        order = merged(simulator.launched, models)  # with stages that had nothing to do
        stages = [
            StageReport(name, models.get(name, "part of what is beside it"), times.get(name, 0.0))
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
                f"by the plan of {plan.planned_for}, a scene of the same kind: predicted errors but that "
                f"of the {'planes' if plan.mix is not None else 'blur left out'} are of that"
            )
        if plan.given_of:
            notes.append(
                f"by a plan that was given, of {plan.given_of}: all predicted errors are those of this scene"
            )
        if plan.probed:
            notes.append(f"probes: {plan.probed}")
        if error is not None and error.places:
            notes.append(f"the true error is that of {error.places}")
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
    """One picture in the making. ms: milliseconds per stage, wall_ms: in all, so far.

    shots: of its exposure, whose times belong to its `first` picture.
    """

    def __init__(self, shots: Shots, seed: int, frame: int, first: bool):
        self._shots, self._seed, self._frame, exposure = shots, seed, frame, shots.exposure
        self.ms, self.wall_ms = (dict(exposure.ms), exposure.wall_ms) if first else ({}, 0.0)

    @cached_property
    def raw(self):
        return self.timed(lambda: self._shots.raw(self._seed, self._frame))

    @cached_property
    def developed(self):
        """As `Shots.developed`."""
        raw = self.raw
        return self.timed(lambda: self._shots.developed(raw))

    def copied(self, array, kind=None):
        """Its values, NumPy; kind: their type, None: as they are."""
        return self.timed(lambda: np.array(self._shots.simulator.device.numpy(array), kind))

    def timed(self, make):
        start = time.perf_counter()
        with self._shots.simulator.device.timed() as ms:
            value = make()
        for stage, spent in ms.items():
            self.ms[stage] = self.ms.get(stage, 0.0) + spent
        self.wall_ms += 1e3 * (time.perf_counter() - start)
        return value
