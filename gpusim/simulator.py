"""A camera on a device: the way from a scene to frames, and what else can be asked of it."""

import dataclasses
from collections.abc import Iterable, Iterator
from copy import copy
from math import ceil, prod
from time import perf_counter

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.backends.tape import OwnTape, noted
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.exposure import LightStatistics, bracket_times, checked_gain, checked_time
from gpusim.domain.scene import Scene
from gpusim.domain.tolerance import Tolerance
from gpusim.frame import Exposure, Frame
from gpusim.kernels.common.fft import LENGTHS, fft_length
from gpusim.kernels.optics.mosaic import transform_lengths
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.meter import meter
from gpusim.kernels.sensor.shutter import shutter
from gpusim.planner.facts import Facts
from gpusim.planner.plan import BORDER_REACH, Plan, plan
from gpusim.planner.shutter import shutter_weights
from gpusim.program.batch import Batch
from gpusim.program.imaging import Imaging
from gpusim.program.kept import Kept
from gpusim.program.program import Program, exposed
from gpusim.program.shots import Shots
from gpusim.program.stream import stream
from gpusim.readout import Readout, checked_electrons
from gpusim.report import Error
from gpusim.truth import at_pixels, probe_pixels, true_mean


class Simulator:
    """A camera on a device.

    camera: what takes the picture. device: a name for `open_device`, or a Device. tolerance: a preset's name, a
    relative RMS error or a Tolerance: wavelengths are fused into the fewest planes that are predicted to meet it, and
    with `verify` the report says whether it is met; without one every wavelength is exact. guaranteed: predict for the
    worst spectrum there can be, a monochromatic point, and not for the scene's own. reach: pixels of surroundings on
    each side that take part in the blur; by default BORDER_REACH, or as many as the tolerance needs.
    fft_free: blur without transforms, by pyramids of separable kernels (error 2e-4). period: of the transforms
    [sample], for the reference: see `gpusim.planner.plan.plan`.
    Raises DeviceError, UnknownName, OutOfRange (a tolerance below what float32 can hold).
    """

    def __init__(self, camera: Camera, *, device: Device | str = "auto", tolerance: Tolerance | str | None = None,
                 guaranteed: bool = False, reach: int | None = None, fft_free: bool = False,
                 period: tuple[int, int] | None = None):
        self.camera = camera
        self.guaranteed = guaranteed
        if reach is not None and (int(reach) != reach or not 1 <= reach <= LENGTHS[-1] // 4):
            raise OutOfRange("reach", reach, f"a whole number of pixels, 1 .. {LENGTHS[-1] // 4}")
        self.reach = reach
        self.fft_free = fft_free
        self.period = period
        self.device = open_device(device) if isinstance(device, str) else device
        self.tolerance = None if tolerance is None else Tolerance.parse(tolerance)
        if self.tolerance and self.tolerance.rms and self.tolerance.rms < 1e-6 and self.device.kind != "numpy":
            raise OutOfRange("tolerance rms", self.tolerance.rms, "rms >= 1e-6 in float32; below it use device numpy")
        self._drawing = OwnTape()
        self._connect(Kept(), Kept(), [])

    def _connect(self, kept, tables, launched):
        """kept: what depends on the camera. tables: of its lens, and patterns of its chip, for frames of the same kind.

        launched: names of stages in their order.
        """
        self.kept, self.tables, self.launched = kept, tables, launched
        sensor = self.camera.sensor
        self.readout = kept("readout", sensor, lambda: Readout(sensor, self.device, tables))
        self.imaging = Imaging(self.camera, self.device, tables)

    def update(self, camera: Camera) -> "Simulator":
        """The same with another camera, for which what does not change is kept. Raises as the class does."""
        other = copy(self)
        other.camera = camera
        other._connect(self.kept, self.tables, self.launched)
        return other

    def apart(self, camera: Camera, tables: Kept) -> "Simulator":
        """The same with another camera, used in turn with this one: both keep what is theirs, and tables are shared."""
        other = copy(self)
        other.camera = camera
        other._connect(Kept(), tables, self.launched)
        return other

    def batch(self, count: int, output: str = "codes") -> Batch:
        """Frames of several scenes, or of several settings, in one array: see `gpusim.program.batch.Batch`."""
        return Batch(self, count, output)

    def program(self, scene: Scene, exposure_time: float | None = None, gain: float = 1.0,
                meters_late: bool = False) -> Program:
        """Frames of a scene, in which what a change does not touch is kept: see `Program`."""
        return Program(self, scene, exposure_time, gain, meters_late)

    def stream(self, scenes: Iterable[Scene], output: str = "codes", *, seed: int = 0, first: int = 0,
               exposure_time: float | None = None, gain: float = 1.0, meters_late: bool = True) -> Iterator:
        """One frame of every scene, an array of the device, which is written anew for the next one.

        output: a name of `gpusim.program.outputs.OUTPUTS`, such as "codes" or "raw". seed: of the noise;
        frames are numbered from `first`. exposure_time, gain: as for `expose`. meters_late: where the exposure is
        automatic, expose by what was metered in the frame before, as a video camera does, the first frame by its own;
        else every frame by its own, which waits for the device. The next scene goes to the device while this one is
        computed: arrays of a scene may be written to again when the scene after the next is asked for. A plan is kept
        while scenes are of one kind and it fits them: see `Program`. Raises as `frames` does.
        """
        return stream(self, scenes, output, seed=seed, first=first, exposure_time=exposure_time, gain=gain,
                      meters_late=meters_late)

    def __call__(self, scene: Scene, *, seed: int = 0, frame: int = 0, verify: bool = False) -> Frame:
        """One frame of `scene`; see `frames`."""
        return next(self.frames(scene, 1, seed=seed, first=frame, verify=verify))

    def frames(self, scene: Scene, count: int, *, seed: int = 0, first: int = 0,
               verify: bool = False) -> Iterator[Frame]:
        """`count` noisy frames of one scene, numbered from `first`; the mean electrons are computed once.

        seed: names the noise; frame n of a seed is the same whatever else is drawn. verify: also run the float64
        reference and report the true error.
        Raises BadData, DoesNotFit (memory, before anything is allocated), OutOfRange.
        """
        if verify and self.camera.optics.varies and scene.samples_per_pixel != 1:
            raise OutOfRange("verify", f"{scene.samples_per_pixel:g} samples per pixel with a blur that varies over "
                             "the field", "1 sample per pixel")
        if verify and self.camera.optics.varies and self.camera.sensor.stacked:
            raise OutOfRange("verify", "stacked pixels with a blur that varies over the field", "a mosaic")
        exposure = self.expose(scene)
        error = self._true_error(scene, exposure) if verify else None
        yield from self.shoot(exposure, count, seed=seed, first=first, error=error)

    @property
    def planned_by(self):
        """What plans depend on beside the scene."""
        sensor, optics = self.camera.sensor, self.camera.optics
        asked = self.tolerance
        in_sigma = asked is not None and (asked.p999_sigma is not None or asked.max_sigma is not None)
        noise = (sensor.exposure_time, sensor.saturation, sensor.read_sigma) if in_sigma else ()
        return (optics, sensor.pixel_pitch, sensor.aperture, sensor.displacement, sensor.qe, sensor.cfa,
                sensor.channels, sensor.stacked, sensor.microlens, sensor.vignetting, sensor.binning, noise)

    @property
    def metered_by(self):
        """What an exposure time depends on beside the plan."""
        sensor, noise = self.camera.sensor, self.camera.sensor.noise
        return (sensor.exposure_time, sensor.auto_exposure, noise.dark_current * noise.warmth,
                self.readout.output.saturation, self.readout.pixels)

    def shoot(self, exposure: Exposure, count: int = 1, *, seed: int = 0, first: int = 0,
              error: Error | None = None) -> Iterator[Frame]:
        """`count` noisy frames of an exposure, numbered from `first`; error: of its mean electrons, where known."""
        if count < 1:
            raise OutOfRange("count of frames", count, "a whole number, count >= 1")
        shots = Shots(self, exposure)
        for number in range(first, first + count):
            yield shots.frame(seed=seed, frame=number, error=error, first=number == first)

    def bracket(self, scene: Scene, stops, *, seed: int = 0, first: int = 0) -> list[Frame]:
        """Frames exposed `stops` longer than the camera would, such as (-2, 0, 2); numbered from `first`.

        The mean electrons are computed once. Raises as `frames` does. `gpusim.captures.merge.merge_bracket` makes one
        picture of high dynamic range of them.
        """
        factors = bracket_times(1.0, stops)
        once = self.expose(scene)
        frames: list[Frame] = []
        for number, factor in enumerate(factors):
            exposure = self.lengthened(once, once.exposure_time * float(factor))
            if number == 0:
                exposure = dataclasses.replace(exposure, ms=once.ms | exposure.ms,
                                               wall_ms=once.wall_ms + exposure.wall_ms)
            frames += self.shoot(exposure, seed=seed, first=first + number)
        return frames

    def burst(self, scene: Scene, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
        """Raw values of `count` frames of a scene at rest, drawn at once: NumPy, count x the shape of a frame's."""
        exposure = self.expose(scene)
        return exposure.layered(np.array(self.device.numpy(self.draw(exposure, seed=seed, frame=first, frames=count))))

    def nondestructive(self, scene: Scene, times, *, seed: int = 0, frame: int = 0) -> np.ndarray:
        """Raw values of reads at `times` [s] after the reset that leave the charge: NumPy, reads x a frame's shape."""
        times = self.readout.checked_reads(times)
        exposure = self.expose(scene, float(times[-1]))
        return exposure.layered(self.readout.nondestructive(
            exposure.mean, exposure.exposure_time, times, gain=exposure.gain, seed=seed, frame=frame))

    def average(self, exposure: Exposure, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
        """Mean raw values of `count` frames [DN], float64: see `Readout.average`."""
        return exposure.layered(self.readout.average(
            exposure.chip_mean, exposure.exposure_time, count, gain=exposure.gain, seed=seed, first=first))

    def _true_error(self, scene, exposure):
        """Error of the mean electrons against the float64 reference."""
        mean = np.array(self.device.numpy(exposure.mean), np.float32)
        plan, time = exposure.plan, exposure.exposure_time
        if plan.varying is None:
            truth = true_mean(Simulator, self.camera, scene, plan, time)
        else:
            pixels = probe_pixels(scene.shape)
            truth = at_pixels(Simulator, self.camera, scene, plan, time, pixels)
            mean = mean[pixels[:, 0], pixels[:, 1]]
        return Error.between(mean, truth, self.camera.sensor.read_sigma)

    def plan(self, scene: Scene, facts: Facts | None = None) -> Plan:
        """What a frame of `scene` takes. facts: of it, where they are known. Raises BadData, DoesNotFit."""
        most = LENGTHS[-1] // 2 - 2 * scene.margin if scene.border == "zero" else (
            LENGTHS[-1] - 2 * (ceil((self.reach or BORDER_REACH) * scene.samples_per_pixel) + scene.margin))
        if max(scene.samples) > most and not self.period:
            raise OutOfRange("scene size", "x".join(map(str, scene.samples[::-1])), f"up to {most} samples each way")
        self.readout.output_shape(scene.shape)
        made = plan(scene, self.camera, transform_lengths, fft_length, self.imaging.tables.sampled, self.tolerance,
                    self.guaranteed, self.reach, self.fft_free, self.period,
                    lambda what, key, make: self.kept(what, (self.planned_by, key), make), facts)
        available = self.device.memory
        needed = made.bytes_needed * (4 if self.device.kind == "numpy" else 1)  # float64 and complex temporaries
        if needed > available:
            raise DoesNotFit(f"{scene.name} ({scene.shape[1]}x{scene.shape[0]})", needed, available, self.device.name)
        return made

    def expose(self, scene: Scene, exposure_time: float | None = None, gain: float = 1.0) -> Exposure:
        """Mean electrons of `scene`; the exposure time [s] is the camera's unless given, automatic if that is None.

        Automatic exposure is as the sensor's `auto_exposure` says, and chooses the analog gain too. gain: beside the
        sensor's, with a time that is given or the camera's: `expose(scene, last.exposure_time, last.gain)` keeps what
        was metered before. Raises BadData, DoesNotFit, OutOfRange.
        """
        return self.program(scene, exposure_time, gain).exposure

    def light(self, electrons):
        """Statistics of electrons (rows, cols) or (C, rows, cols), on the device: see `sensor.meter`."""
        shape, automatic = electrons.shape, self.camera.sensor.auto_exposure
        weights = self.kept("weights of metering", tuple(shape), lambda: automatic.weights(shape))
        flat = self.device.reshape(electrons, (prod(shape[:-1]), shape[-1]))
        return meter(flat, *weights, automatic.fractions, device=self.device)

    def metered(self, rates) -> tuple[float, float]:
        """Exposure time [s] and analog gain that automatic exposure chooses for electrons per second, see `chosen`."""
        return self.chosen(self.device.numpy(self.light(rates)), rates.shape)

    def chosen(self, light, shape, seconds: float = 1.0) -> tuple[float, float]:
        """The same by what `light` gave, read by the host, of the electrons of `seconds` [s], shape (..., rows, cols).

        Raises BadData for a scene without light, or with light that is not finite.
        """
        sensor = self.camera.sensor
        dark = sensor.noise.dark_current * sensor.noise.warmth  # fills the well as light does
        rates = LightStatistics(np.array(light), prod(shape)).over(seconds).plus(dark)
        return sensor.auto_exposure.choose(rates, self.readout.output.saturation / self.readout.pixels)

    def expose_moving(self, scenes, times, exposure_time: float | None = None, start: float = 0.0,
                      gain: float = 1.0) -> Exposure:
        """Mean electrons of a scene that moves, or of a camera that does: rows are exposed one after the other.

        scenes: pictures of it at the instants `times` [s], all of one size; between them the light changes linearly.
        start: when the first row opens [s]; row y opens y row_time of the sensor later. Automatic exposure meters the
        first scene; gain: as for `expose`. Raises as `expose` does, and BadData, OutOfRange for times that do not cover
        the exposure.
        """
        checked_time(exposure_time)
        checked_gain(gain)
        scenes, begun = list(scenes), perf_counter()
        if not scenes or len(scenes) != len(np.atleast_1d(times)):
            raise BadData(f"moving scene: {len(scenes)} scenes and {len(np.atleast_1d(times))} times; wanted as many, "
                          "one or more")
        if len({scene.shape for scene in scenes}) > 1:
            raise BadData("moving scene: the scenes differ in size")
        plans = [self.plan(scene) for scene in scenes]
        held = 8 * len(scenes) * prod(scenes[0].shape) * len(plans[0].weights)  # the pictures, and once more together
        if held > self.device.memory:
            raise DoesNotFit(f"a moving scene of {len(scenes)} pictures", held, self.device.memory, self.device.name)
        with self.device.timed() as ms:
            rates = [self.imaging.exposed(plan, self.imaging.rates(plan), 1.0) for plan in plans]
            shape = rates[0].shape
            exposure_time = self.camera.sensor.exposure_time if exposure_time is None else exposure_time
            if exposure_time is None:
                exposure_time, gain = self.metered(rates[0])
            weights = shutter_weights(times, shape[-2], exposure_time, self.camera.sensor.row_time, start)
            layers = prod(shape[:-2])  # of stacked pixels, one below the other
            stacked = self.device.reshape(self.device.stack(rates), (len(rates), layers * shape[-2], shape[-1]))
            mean = shutter(stacked, np.tile(weights, (layers, 1)), device=self.device)
            model = f"{len(scenes)} pictures, rows {1e6 * self.camera.sensor.row_time:g} us apart"
            plan = dataclasses.replace(plans[0], models=plans[0].models | {"sensor.shutter": model})
            exposure = exposed(self, plan, self.device.reshape(mean, shape), exposure_time, gain, Kept())
        return dataclasses.replace(exposure, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begun))

    def lengthened(self, exposure: Exposure, exposure_time: float) -> Exposure:
        """The same scene exposed for another time [s]; nothing but the mean electrons is computed anew."""
        checked_time(exposure_time)
        shape, begun = exposure.mean.shape, perf_counter()
        with self.device.timed() as ms:
            mean = chip(self.device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1])),
                        scale=exposure_time / exposure.exposure_time, device=self.device)
            lengthened = exposed(self, exposure.plan, self.device.reshape(mean, shape), exposure_time, exposure.gain,
                                 Kept())
        return dataclasses.replace(lengthened, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begun))

    def draw(self, exposure: Exposure, *, seed: int = 0, frame: int = 0, frames: int | None = None):
        """Raw values around the exposure's `chip_mean`, an array of the device; equal on all for equal means.

        frames: how many from `frame` on, shape (frames, rows, cols); by default one alone, (rows, cols), the layers of
        stacked pixels one below the other.
        """
        with noted(self._drawing.tape):
            return self.readout.draw(exposure.chip_mean, exposure.exposure_time, gain=exposure.gain, seed=seed,
                                     frame=frame, frames=frames)

    def draw_electrons(self, mean, exposure_time: float, *, gain: float = 1.0, seed: int = 0, frame: int = 0,
                       frames: int | None = None) -> np.ndarray:
        """The same around your own mean electrons of `exposure_time` [s], NumPy.

        mean: of every pixel, not binned, shape (rows, cols) or, of stacked pixels, (C, rows, cols) [e-]. gain: as for
        `expose`. Raises OutOfRange for electrons that are not finite or negative, BadData.
        """
        checked_time(exposure_time)
        sensor = self.camera.sensor
        mean = checked_electrons(mean, len(sensor.channels) if sensor.stacked else None)
        self.readout.output_shape(mean.shape[-2:])
        chip_mean = self.readout.chip_mean(self.device.array(mean), exposure_time)
        raw = np.array(self.device.numpy(self.readout.draw(chip_mean, exposure_time, gain=gain, seed=seed, frame=frame,
                                                           frames=frames)))
        return raw.reshape(*raw.shape[:-2], *mean.shape[:-2], -1, raw.shape[-1])

    def develop(self, raw, exposure: Exposure):
        """Linear display RGB (3, rows, cols), before the tone curve, and display codes (rows, cols, 3) of raw values.

        Those of a sensor without a converter are shown from 16 bits of them.
        """
        return Shots(self, exposure).developed(raw)[:2]

    def codes(self, raw, exposure: Exposure):
        """The display codes of `develop` alone, for previews and videos: in one pass where the camera allows it."""
        return Shots(self, exposure).codes(raw)
