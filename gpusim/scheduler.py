"""Binds a plan to a device: what runs when, what is kept from one frame to the next, and what it all took."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, prod
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.developer import Developer
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.exposure import bracket_times, checked_time, exposure_value
from gpusim.domain.scene import Scene
from gpusim.domain.tolerance import Tolerance
from gpusim.io.frames import write_frame
from gpusim.kernels.common.fft import LENGTHS, fft_length
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.composite import composite
from gpusim.kernels.optics.field import field, transfer
from gpusim.kernels.optics.gain import gain
from gpusim.kernels.optics.mosaic import mosaic, transform_lengths
from gpusim.kernels.optics.nearfar import nearfar
from gpusim.kernels.optics.pupil import pupil
from gpusim.kernels.optics.sample import sample
from gpusim.kernels.optics.splat import splat
from gpusim.kernels.optics.warp import warp
from gpusim.kernels.sensor.expect import expect
from gpusim.kernels.sensor.expose import expose
from gpusim.kernels.sensor.shutter import shutter
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.spectral.materials import materials
from gpusim.planner.highlights import point_kernels
from gpusim.planner.nearfar import kernel_of, levels_of
from gpusim.planner.plan import BORDER_REACH, Plan, plan
from gpusim.planner.psf import psf_tables
from gpusim.planner.rendering import Rendering, rendering, transforms_of
from gpusim.planner.shading import phase_gains, relative_response, shading_gains
from gpusim.planner.shutter import shutter_weights
from gpusim.planner.speed import iso_speed
from gpusim.readout import Readout, checked_electrons
from gpusim.report import Error, Report, StageReport
from gpusim.truth import PROBES, at_pixels, probe_pixels, true_mean

FFT_FREE_REACH = 255  # [pixel] of kernels without transforms; the little beyond is folded into them
HOT = 3.0  # [standard deviation of a read] of electrons beyond the common dark current: a pixel to be replaced
MOST_GAIN = 1e4  # analog gain beside the sensor's
ON_DEVICE = ("mean", "expected")  # of an exposure


@dataclass(frozen=True, eq=False)
class Exposure:
    """The noise-free capture of a scene: computed once, drawn from many times.

    plan: of the scene. camera: as operated, its sensor binned and with the analog gain that was chosen.
    mean: mean electrons of every pixel, not binned, array of the device, (rows, cols) or, of stacked pixels, (C, rows,
        cols) [e-].
    expected: the same of this very chip, as the noise is drawn around it: see `Readout.expected`.
    exposure_time: [s]. gain: analog gain that automatic exposure chose [1]. rendering: how its values become colours,
        for the light that is known or assumed.
    blur: of the lens as a Gaussian [pixel], gains: of the shading correction at its nodes, where the camera uses them.
    ms: milliseconds per stage that it took. device: where the electrons are. It is pickled with their values and the
        device's name, which is opened where it is loaded.
    """

    plan: Plan
    camera: Camera
    mean: Any
    expected: Any
    exposure_time: float
    gain: float
    rendering: Rendering
    blur: float = 0.0
    gains: np.ndarray | None = None
    ms: dict = dataclasses.field(default_factory=dict)
    device: Device = dataclasses.field(default_factory=Device)

    def __getstate__(self):
        return self.__dict__ | {name: np.array(self.device.numpy(getattr(self, name))) for name in ON_DEVICE}

    def __setstate__(self, state):
        self.__dict__.update(state, **{name: state["device"].array(state[name], state[name].dtype)
                                       for name in ON_DEVICE})


@dataclass(frozen=True, eq=False)
class Frame:
    """One simulated picture.

    camera, exposure_time [s], rendering: what it was taken and developed with; the camera's sensor is as operated, the
        white that of the picture where the camera estimates it.
    mean: mean electrons without noise, float32 (rows, cols) or, of stacked pixels, (C, rows, cols) [e-].
    raw: digital numbers, uint16 of the same shape [DN], or float32 without a converter.
    blur, gains: as of the exposure.
    linear: linear display RGB, display white 1 (see `Processor.scaling`), before clipping and tone curve, float32 (3,
        rows, cols). rgb: display codes, uint8 (rows, cols, 3).
    """

    camera: Camera
    exposure_time: float
    rendering: Rendering
    mean: np.ndarray
    raw: np.ndarray
    linear: np.ndarray
    rgb: np.ndarray
    report: Report
    blur: float = 0.0
    gains: np.ndarray | None = None

    def save(self, path):
        """Write .png, .exr, .dng or .npz: see `gpusim.io.frames.write_frame`."""
        write_frame(path, self)


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
        self.readout = Readout(camera.sensor, self.device)
        self._kept: dict = {}  # what -> (key, value): tables of the last plan, for the next frame of the same kind

    def __getstate__(self):
        return self.__dict__ | {"_kept": {}}  # tables of the device, made anew

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

    def shoot(self, exposure: Exposure, count: int = 1, *, seed: int = 0, first: int = 0,
              error: Error | None = None) -> Iterator[Frame]:
        """`count` noisy frames of an exposure, numbered from `first`; error: of its mean electrons, where known."""
        if count < 1:
            raise OutOfRange("count of frames", count, "a whole number, count >= 1")
        shape = exposure.mean.shape
        mean = self.readout.mean(self.device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1])))
        mean = self._layered(exposure, mean)
        for number in range(first, first + count):
            with self.device.timed() as ms:
                raw = self.draw(exposure, seed=seed, frame=number)
                shown, rgb, rendering = self._developed(raw, exposure)
            raw, shown, rgb = (np.array(self.device.numpy(array)) for array in (raw, shown, rgb))
            report = self._report(exposure, rendering, ms, seed, number, error, kept=number > first)
            yield Frame(exposure.camera, exposure.exposure_time, rendering, mean, self._layered(exposure, raw), shown,
                        rgb, report, exposure.blur, exposure.gains)

    def bracket(self, scene: Scene, stops, *, seed: int = 0, first: int = 0) -> list[Frame]:
        """Frames exposed `stops` longer than the camera would, such as (-2, 0, 2); numbered from `first`.

        The mean electrons are computed once. Raises as `frames` does. `gpusim.multiframe.merge_bracket` makes one
        picture of high dynamic range of them.
        """
        factors = bracket_times(1.0, stops)
        once = self.expose(scene)
        frames: list[Frame] = []
        for number, factor in enumerate(factors):
            exposure = self.lengthened(once, once.exposure_time * float(factor))
            if number == 0:
                exposure = dataclasses.replace(exposure, ms=once.ms | exposure.ms)
            frames += self.shoot(exposure, seed=seed, first=first + number)
        return frames

    def burst(self, scene: Scene, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
        """Raw values of `count` frames of a scene at rest, drawn at once: NumPy, count x the shape of a frame's."""
        exposure = self.expose(scene)
        return self._layered(exposure, np.array(self.device.numpy(self.draw(exposure, seed=seed, frame=first,
                                                                            frames=count))))

    def nondestructive(self, scene: Scene, times, *, seed: int = 0, frame: int = 0) -> np.ndarray:
        """Raw values of reads at `times` [s] after the reset that leave the charge: NumPy, reads x a frame's shape."""
        times = self.readout.checked_reads(times)
        exposure = self.expose(scene, float(times[-1]))
        return self._layered(exposure, self.readout.nondestructive(
            exposure.mean, exposure.exposure_time, times, gain=exposure.gain, seed=seed, frame=frame))

    def average(self, exposure: Exposure, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
        """Mean raw values of `count` frames [DN], float64: see `Readout.average`."""
        return self._layered(exposure, self.readout.average(
            exposure.expected, exposure.exposure_time, count, gain=exposure.gain, seed=seed, first=first))

    def _layered(self, exposure, raw):
        """Raw values (..., rows, cols) with the layers of stacked pixels apart, (..., C, rows, cols)."""
        layers = exposure.mean.shape[:-2]
        return raw.reshape(*raw.shape[:-2], *layers, -1, raw.shape[-1])

    def _true_error(self, scene, exposure):
        """Error of the mean electrons against the float64 reference."""
        mean = np.array(self.device.numpy(exposure.mean), np.float32)
        made, time = exposure.plan, exposure.exposure_time
        if made.varying is None:
            truth = true_mean(Simulator, self.camera, scene, made, time)
        else:
            pixels = probe_pixels(scene.shape)
            truth = at_pixels(Simulator, self.camera, scene, made, time, pixels)
            mean = mean[pixels[:, 0], pixels[:, 1]]
        return Error.between(mean, truth, self.camera.sensor.read_sigma)

    def light(self, made: Plan):
        """Planes of the scene's own wavelengths where the lens puts them, before any blur, shape (L, rows, cols)."""
        whole = slice(None)
        table = None if made.content.is_spectral else made.content.entry_spectra.T
        return self._warped(made, self._planes(made.content, table, (whole, whole)))

    def _warped(self, made: Plan, planes):
        """Planes as the distortion puts them."""
        if made.warp is None:
            return planes
        shape = made.scene.samples if made.gains is None else planes.shape[1:]
        border = "edge" if made.scene.border == "scene" else made.scene.border
        return warp(planes, self.device.array(made.warp.nodes[None]), shape, border, made.warp.method,
                    device=self.device)

    def plan(self, scene: Scene) -> Plan:
        """What a frame of `scene` takes. Raises BadData, DoesNotFit."""
        most = LENGTHS[-1] // 2 - 2 * scene.margin if scene.border == "zero" else (
            LENGTHS[-1] - 2 * (ceil((self.reach or BORDER_REACH) * scene.samples_per_pixel) + scene.margin))
        if max(scene.samples) > most and not self.period:
            raise OutOfRange("scene size", "x".join(map(str, scene.samples[::-1])), f"up to {most} samples each way")
        self.readout.output_shape(scene.shape)
        made = plan(scene, self.camera, transform_lengths, fft_length, self._sampled_tables, self.tolerance,
                    self.guaranteed, self.reach, self.fft_free, self.period, self._keep)
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
        checked_time(exposure_time)
        made = self.plan(scene)
        with self.device.timed() as ms:
            rates = self._rates(made)
            exposure_time, gain = self._metered(exposure_time, gain, lambda: self._expose(made, rates, 1.0))
            mean = self._expose(made, rates, exposure_time)
        return self._exposed(made, mean, exposure_time, gain, ms)

    def expose_moving(self, scenes, times, exposure_time: float | None = None, start: float = 0.0,
                      gain: float = 1.0) -> Exposure:
        """Mean electrons of a scene that moves, or of a camera that does: rows are exposed one after the other.

        scenes: pictures of it at the instants `times` [s], all of one size; between them the light changes linearly.
        start: when the first row opens [s]; row y opens y row_time of the sensor later. Automatic exposure meters the
        first scene; gain: as for `expose`. Raises as `expose` does, and BadData, OutOfRange for times that do not cover
        the exposure.
        """
        checked_time(exposure_time)
        scenes = list(scenes)
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
            rates = [self._expose(made, self._rates(made), 1.0) for made in plans]
            shape = rates[0].shape
            exposure_time, gain = self._metered(exposure_time, gain, lambda: rates[0])
            weights = shutter_weights(times, shape[-2], exposure_time, self.camera.sensor.row_time, start)
            layers = prod(shape[:-2])  # of stacked pixels, one below the other
            stacked = np.stack([np.reshape(self.device.numpy(rate), (-1, shape[-1])) for rate in rates])
            mean = shutter(self.device.array(stacked), np.tile(weights, (layers, 1)), device=self.device)
        model = f"{len(scenes)} pictures, rows {1e6 * self.camera.sensor.row_time:g} us apart"
        made = dataclasses.replace(plans[0], models=plans[0].models | {"sensor.shutter": model})
        return self._exposed(made, self.device.reshape(mean, shape), exposure_time, gain, ms)

    def lengthened(self, exposure: Exposure, exposure_time: float) -> Exposure:
        """The same scene exposed for another time [s]; nothing but the mean electrons is computed anew."""
        checked_time(exposure_time)
        shape = exposure.mean.shape
        with self.device.timed() as ms:
            mean = expect(self.device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1])),
                          scale=exposure_time / exposure.exposure_time, device=self.device)
        return self._exposed(exposure.plan, self.device.reshape(mean, shape), exposure_time, exposure.gain, ms)

    def draw(self, exposure: Exposure, *, seed: int = 0, frame: int = 0, frames: int | None = None):
        """Raw values around the exposure's expected electrons, an array of the device; equal on all for equal means.

        frames: how many from `frame` on, shape (frames, rows, cols); by default one alone, (rows, cols), the layers of
        stacked pixels one below the other.
        """
        return self.readout.draw(exposure.expected, exposure.exposure_time, gain=exposure.gain, seed=seed, frame=frame,
                                 frames=frames)

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
        expected = self.readout.expected(self.device.array(mean), exposure_time)
        raw = np.array(self.device.numpy(self.readout.draw(expected, exposure_time, gain=gain, seed=seed, frame=frame,
                                                           frames=frames)))
        return raw.reshape(*raw.shape[:-2], *mean.shape[:-2], -1, raw.shape[-1])

    def develop(self, raw, exposure: Exposure):
        """Linear display RGB (3, rows, cols), before the tone curve, and display codes (rows, cols, 3) of raw values.

        Those of a sensor without a converter are shown from 16 bits of them.
        """
        return self._developed(raw, exposure)[:2]

    def codes(self, raw, exposure: Exposure):
        """The display codes of `develop` alone, for previews and videos: in one pass where the camera allows it."""
        codes = self._developer(exposure).in_one_pass(raw, exposure.rendering)
        return self.develop(raw, exposure)[1] if codes is None else codes

    def _developed(self, raw, exposure):
        """Linear display RGB, display codes and the rendering that they are by."""
        developer = self._developer(exposure)
        planes = developer.demosaicked(raw, white=exposure.rendering.neutral, known=self._defects(exposure),
                                       gains=exposure.gains, blur=exposure.blur)
        rendered = developer.balanced(planes, exposure.rendering)
        return *developer.shown(planes, rendered), rendered

    def _developer(self, exposure):
        return self._keep("developer", exposure.camera.sensor.analog_gain, lambda: Developer(
            exposure.camera, self.device, self.readout.averaged,
            lambda: self._keep("transforms", (), lambda: transforms_of(exposure.camera))))

    def _defects(self, exposure):
        """Map of the chip's dead pixels and of those whose own current shows in this exposure; None where not asked."""
        if exposure.camera.processor.defects != "known":
            return None
        shape, time = exposure.mean.shape, exposure.exposure_time
        return self._keep("defects", (shape, time, exposure.gain), lambda: self.readout.defects(
            shape, time, HOT * exposure.camera.sensor.read_sigma))

    def _metered(self, exposure_time, gain, per_second):
        """Exposure time [s] and analog gain: given, the sensor's, or chosen for the electrons of `per_second()`."""
        sensor = self.camera.sensor
        if not 0 < gain <= MOST_GAIN:
            raise OutOfRange("gain", gain, f"0 < gain <= {MOST_GAIN:g}")
        exposure_time = sensor.exposure_time if exposure_time is None else exposure_time
        if exposure_time is not None:
            return float(exposure_time), float(gain)
        dark = sensor.noise.dark_current * sensor.noise.warmth  # fills the well as light does
        return sensor.auto_exposure.choose(self.device.numpy(per_second()) + np.float32(dark),
                                           self.readout.output.saturation / self.readout.pixels)

    def _exposed(self, made: Plan, mean, exposure_time, gain, ms):
        camera = dataclasses.replace(self.camera, sensor=self.readout.operated(gain))
        with self.device.timed() as more:
            expected = self.readout.expected(mean, exposure_time)
        ms = {name: ms.get(name, 0.0) + more.get(name, 0.0) for name in {**ms, **more}}
        processor = camera.processor
        gains = None
        if processor.shading:
            falls = (made.gain, None if made.warp is None else made.warp.nodes)
            key = (made.scene.shape, made.slope, *(None if map_ is None else map_.tobytes() for map_ in falls))
            gains = self._keep("shading", key, lambda: self._gains(made))
        return Exposure(made, camera, mean, expected, exposure_time, gain,
                        rendering(made, camera, exposure_time, self.readout.pixels),
                        self._blur(made) if processor.demosaic == "best" else 0.0, gains, ms, self.device)

    def _gains(self, made):
        """Gains of the shading correction for each pixel of the mosaic's period, see `Developer.demosaicked`."""
        response, period = relative_response(made), self.readout.output.cfa_indices.shape
        if self.camera.sensor.binning == (1, 1):
            return shading_gains(response, prod(period))
        return phase_gains(self.readout.mean(self.device.array(response)), period)[0]

    def _rates(self, made: Plan):
        """Electrons per second, planes (1 or C, rows, cols), and the mosaic's pattern over these planes."""
        device, content, margin = self.device, made.content, made.scene.margin
        cfa = self.camera.sensor.cfa_indices
        border = "edge" if made.scene.border == "scene" else made.scene.border
        # without blur or distortion nothing outside the frame is needed
        window = slice(margin, -margin or None) if made.gains is None and made.warp is None else slice(None)
        planes = self._warped(made, self._planes(content, made.table, (window, window)))
        if made.gains is None:
            return self._pixels(made, planes), cfa
        if made.folded:
            rates = mosaic(planes, self._transfer(made), made.gains, cfa, border, made.period, margin=margin,
                           device=device)
        else:
            # spare samples around the scene's own: the crop of the blur begins outside of them
            if made.fft_free:
                key = (made.scene.samples, *self._transfer_key(made))
                levels = self._keep("levels", key, lambda: self._levels(made))
                rates = nearfar(planes, levels, made.gains, border, device=device)
                if margin:
                    rates = device.array(np.ascontiguousarray(device.numpy(rates)[:, margin:-margin, margin:-margin]))
            elif made.depth is None:
                rates = blur(planes, self._transfer(made), made.gains, border, made.period, margin=margin - made.spare,
                             device=device)
            else:
                rates = self._by_depth(made, planes, border)
            if made.varying is not None:
                rates = self._with_field(made, planes, rates, border)
            if made.taps is not None:
                if made.highlights is not None:
                    rates = self._with_highlights(made, rates, None)
                return self._pixels(made, rates), cfa
            if made.highlights is None:
                return rates, cfa
            rates = expose(rates, cfa, 1.0, 0.0, device=device)  # the mosaic, for one second
        if made.highlights is not None:
            rates = self._with_highlights(made, rates, cfa)
        return device.reshape(rates, (1, *rates.shape)), np.zeros((1, 1), np.int32)

    def _by_depth(self, made: Plan, planes, border):
        """The channels, each point blurred as its distance demands, nearer layers laid over farther ones.

        A layer's coverage is blurred in each channel by the kernel of white in the scene's light: that is what the
        channel sees of a wavelength's kernel. Things go on outside the frame even where no light comes from there.
        """
        depth, device, margin = made.depth, self.device, made.scene.margin - made.spare
        assert depth is not None
        channels = len(made.weights)
        white = made.weights / np.maximum(made.weights.sum(axis=1, keepdims=True), 1e-300)
        lights, alphas, layers = [], [], []
        for layer in range(depth.layers):
            content, coverage, confusion = depth.sheet(layer, made.content)
            own = planes if content is made.content else self._planes(content, made.table, (slice(None),))
            for kernel, share in depth.shares(coverage, confusion):
                bands = self._all_bands(made, depth.distances[kernel])
                share = device.array(share[None])
                light = blur(gain(own, share, device=device), self._combined(made, bands), made.gains, border,
                             made.period, margin=margin, device=device)
                cover = integrate(bands, device.array(white), device=device)
                cover = device.reshape(cover, (channels, 1, *bands.shape[1:]))
                alpha = blur(share, cover, np.ones((channels, 1), np.float32), "edge" if border == "zero" else border,
                             made.period, margin=margin, device=device)
                lights.append(device.numpy(light))
                alphas.append(device.numpy(alpha))
                layers.append(layer)
        return composite(device.array(np.stack(lights)), device.array(np.stack(alphas)), layers, device=device)

    def _with_field(self, made: Plan, planes, rates, border):
        """The channels blurred as on the axis, with what the blur is more elsewhere."""
        assert made.varying is not None
        key = (made.varying.kernels.tobytes(), *(edge.tobytes() for edge in made.varying.edges))
        inputs, tables = self._keep("field", key, lambda: (
            {name: value if name == "edges" else self.device.array(value, np.int32 if name == "index" else np.float32)
             for name, value in made.varying.stage_inputs.items()},
            transfer(self.device, made.varying.kernels, made.varying.edges)))
        return field(planes, gains=made.gains, border=border, margin=made.scene.margin - made.spare, base=rates,
                     tables=tables, device=self.device, **inputs)

    def _pixels(self, made: Plan, rates):
        """Channels at the pixels from channels at the scene's samples."""
        if made.taps is None:
            return rates
        rows, cols = made.taps
        return sample(rates, rows.start, rows.weights, cols.start, cols.weights, device=self.device)

    def _with_highlights(self, made: Plan, rates, cfa):
        """The mosaic, or every channel of the samples, with the plan's highlights added."""
        lights, device = made.highlights, self.device
        assert lights is not None
        reach = int(lights.reach.max())
        aperture, _ = self._grid(made.scene.samples_per_pixel)[1]  # highlights are split off for squares only
        kernels = self._keep("points", (made.q.tobytes(), reach), lambda: point_kernels(made.q, aperture, reach))
        weights = lights.spectra[:, None] * (made.weights / made.flat)  # (kernels, channels, L)
        cores, profiles = np.tensordot(weights, kernels.cores, 1), np.tensordot(weights, kernels.profiles, 1)
        places = np.column_stack([lights.places + made.spare, lights.light, lights.reach]).astype(np.int32)
        shape = kernels.step, kernels.parts, kernels.spread
        if made.taps is not None:
            return device.array(np.stack([splat(one, np.zeros((1, 1), np.int32), places, lights.strength, cores[:, [c]],
                                                profiles[:, [c]], *shape, device=device)
                                          for c, one in enumerate(device.numpy(rates))]))
        return splat(rates, device.array(cfa, np.int32), device.array(places, np.int32),
                     device.array(lights.strength), device.array(cores), device.array(profiles), *shape, device=device)

    def _keep(self, what, key, make):
        """What `make` gave for `key` the last time, or gives now; one value of each kind is kept."""
        found = self._kept.get(what)  # read once: another thread may put its own there
        if found is None or found[0] != key:
            found = self._kept[what] = key, make()
        return found[1]

    def _sampled_tables(self, q, aperture, rows, cols, finer, displacement=(0.0, 0.0)):
        """Transfer tables for the planner, float64."""
        pitch = self.camera.sensor.pixel_pitch / finer
        return self._keep(f"sampled {rows}x{cols}", (q.tobytes(), aperture, finer, displacement),
                          lambda: self._bands(q, pitch, aperture, rows, cols, open_device("numpy"), whole=False,
                                              displacement=displacement))

    def _grid(self, samples_per_pixel):
        """Distance of the samples that are blurred [m], height and width over which each is integrated [sample].

        Where they are the pixels', over the pixel's aperture; else over the whole cell, which the pixels then share.
        """
        sensor = self.camera.sensor
        return (sensor.pixel_pitch / samples_per_pixel,
                tuple(side / sensor.pixel_pitch for side in sensor.aperture) if samples_per_pixel == 1 else (1.0, 1.0))

    def _planes(self, content, table, window):
        """The planes that are transformed, or the channels themselves, as an array of the device."""
        device = self.device
        stored = device.array(content.planes[(..., *window)])
        if content.labels is not None:
            ids = device.array(content.labels[window], np.uint16)
            return materials(ids, stored, device.array(table), device=device)
        return stored if table is None else integrate(stored, device.array(table), device=device)

    def _transfer(self, made: Plan):
        """Transfer tables (groups, planes, ...) of the plan, kept for the next frame of the same kind."""
        assert made.gains is not None  # a plan with blur
        return self._keep("transfer", self._transfer_key(made), lambda: self._make_transfer(made))

    def _transfer_key(self, made):
        return (made.q.tobytes(), made.period, made.gains.shape,
                made.transfers.tobytes() if made.transfers is not None else None)

    def _levels(self, made: Plan):
        """The plan's kernels as pyramids."""
        reach = min(FFT_FREE_REACH, max(made.scene.samples))
        period = (2 * reach + 2,) * 2
        pitch, aperture = self._grid(made.scene.samples_per_pixel)
        bands = self._bands(made.q, pitch, aperture, *period, self.device)
        tables = self.device.numpy(self._combined(made, bands))
        return levels_of([[kernel_of(table, period, reach) for table in group] for group in tables])

    def _bands(self, q, pitch, aperture, rows, cols, device, distance=None, whole=True, displacement=None):
        """Transfer tables of every wavelength: quarters where the optics is the same at every angle, else halves.

        q: wavelength times f-number over `pitch`, the distance of samples [m]. aperture: their height and width
        [sample]. distance: of the object [m], that in focus if not given. whole: for a convolution, see `psf_tables`.
        displacement: of the apertures from the samples; the sensor's, where the samples are the pixels', if not given.
        """
        optics, sensor = self.camera.optics, self.camera.sensor
        if displacement is None:
            displacement = sensor.displacement if pitch == sensor.pixel_pitch else (0.0, 0.0)
        if optics.psf is not None:
            return device.array(psf_tables(optics.psf, q * pitch / optics.working_f_number * 1e9, pitch, aperture, rows,
                                           cols, finest=float(q.min()) * pitch / 2 if whole else 0.0, whole=whole,
                                           displacement=displacement))
        if optics.is_ideal and distance is None and not any(displacement):
            return airy(device.array(q), aperture, rows, cols, device=device)
        waves = optics.waves(q * pitch / optics.working_f_number * 1e9, distance=distance)
        return pupil(optics.pupil, waves, device.array(q), aperture, rows, cols, device=device,
                     spots=tuple(length / pitch for length in optics.birefringence), diffuser=optics.diffuser / pitch,
                     displacement=displacement)

    def _make_transfer(self, made):
        return self._combined(made, self._all_bands(made))

    def _all_bands(self, made, distance=None):
        return self._bands(made.q, *self._grid(made.scene.samples_per_pixel), *made.period, self.device, distance)

    def _blur(self, made: Plan) -> float:
        """Standard deviation [pixel] of the Gaussian that is as the lens is on its axis at 1/4 cycle per pixel."""
        if made.gains is None:
            return 0.0
        sensor, q = self.camera.sensor, made.q / made.scene.samples_per_pixel
        aperture = tuple(side / sensor.pixel_pitch for side in sensor.aperture)

        def deviation():
            # four points along a pixel: what a grid of pixels folds onto this frequency is not of the lens
            tables = np.asarray(self._bands(4 * q, sensor.pixel_pitch / 4, tuple(4 * side for side in aperture), 32, 32,
                                            open_device("numpy"), whole=False, displacement=(0.0, 0.0)))
            if tables.shape[1] == 32:  # halves, as pairs of real and imaginary parts
                tables = np.ascontiguousarray(tables).view(np.result_type(tables.dtype, np.complex64))
            light = made.weights.sum(axis=0)
            passed = [light @ tables[:, i, j].real / (light @ tables[:, 0, 0].real) / np.sinc(side / 4)
                      for (i, j), side in zip(((2, 0), (0, 2)), aperture, strict=True)]
            return float(np.sqrt(-2 * np.log(np.clip(np.mean(passed), 1e-6, 1))) / (2 * np.pi / 4))

        return self._keep("blur", (q.tobytes(), made.weights.tobytes()), deviation)

    def _combined(self, made, bands):
        """Transfer tables of the plan's planes from those of its wavelengths."""
        device = self.device
        if made.transfers is None:
            return device.reshape(bands, (1, *bands.shape))
        channels, planes, count = made.transfers.shape
        tables = integrate(bands, device.array(made.transfers.reshape(channels * planes, count)), device=device)
        return device.reshape(tables, (channels, planes, *bands.shape[1:]))

    def _expose(self, made: Plan, rates, exposure_time):
        """Mean electrons (rows, cols) or, of stacked pixels, (C, rows, cols)."""
        planes, cfa = rates
        if made.gain is not None:
            planes = gain(planes, self.device.array(made.gain[None]), device=self.device)
        if not self.camera.sensor.stacked:
            return expose(planes, cfa, exposure_time, made.slope, device=self.device)
        layers = [expose(planes, np.full((1, 1), channel, np.int32), exposure_time, made.slope, device=self.device)
                  for channel in range(planes.shape[0])]
        return self.device.array(np.stack([self.device.numpy(layer) for layer in layers]))

    def _speed(self, analog_gain):
        return self._keep("speed", analog_gain, lambda: iso_speed(dataclasses.replace(
            self.camera.sensor, analog_gain=analog_gain)))

    def _report(self, exposure, rendering, ms, seed, number, error, kept):
        made, camera = exposure.plan, exposure.camera
        times = dict(ms) if kept else {**exposure.ms, **ms}
        developing = self._developer(exposure).models()
        shown = f"{camera.display.name}, 8 bit" + (", with a tone curve" if camera.processor.tone else "")
        models = made.models | self.readout.models() | developing | {
            "processor.color": rendering.model, "display.encode": shown}
        order = ("spectral.integrate", "spectral.materials", "optics.warp", "optics.airy", "optics.pupil",
                 "optics.blur", "optics.nearfar", "optics.composite", "optics.field", "optics.mosaic", "optics.splat",
                 "optics.sample", "optics.gain", "sensor.expose", "sensor.shutter", "sensor.pattern", "sensor.expect",
                 "sensor.bin", "sensor.noise", *developing, "processor.color", "display.encode")
        stages = [StageReport(name, models[name], times.get(name, 0.0)) for name in order if name in models]
        scene = made.scene
        form = scene.content.form
        white = ", saturation is display white" if camera.processor.scaling == "normalised" else ""
        notes = [] if scene.light_is_known else ["the scene's light is unknown: colours are rendered for "
                                                 f"{camera.processor.target}{white}"]
        if error is not None and made.varying is not None:
            notes.append(f"the true error is that of {PROBES} pixels: the blur varies over the field")
        return Report(
            {"name": scene.name, "rows": scene.shape[0], "cols": scene.shape[1], "form": form, "border": scene.border,
             "samples_per_pixel": scene.samples_per_pixel,
             "wavelengths_nm": [float(scene.wavelengths[0]), float(scene.wavelengths[-1])],
             "bands": len(scene.wavelengths)},
            {"name": camera.name, "f_number": camera.optics.f_number, "exposure_time_s": exposure.exposure_time,
             "analog_gain": camera.sensor.analog_gain, "iso": self._speed(camera.sensor.analog_gain),
             "exposure_value": float(exposure_value(camera.optics.f_number, exposure.exposure_time))},
            {"name": self.device.name, "kind": self.device.kind}, number, seed, stages, made.predicted, made.left_out,
            error, self.tolerance, notes, made.not_met)
