"""Binds a plan to a device: what runs when, what is kept from one frame to the next, and what it all took."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import DoesNotFit, OutOfRange, UnknownName
from gpusim.domain.exposure import auto_exposure, exposure_value
from gpusim.domain.scene import Cube, Materials, Scene
from gpusim.domain.tolerance import Tolerance
from gpusim.io.frames import write_frame
from gpusim.kernels.common.fft import LENGTHS
from gpusim.kernels.display.srgb import srgb
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.mosaic import mosaic, transform_lengths
from gpusim.kernels.optics.pupil import pupil
from gpusim.kernels.optics.splat import splat
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.color import color
from gpusim.kernels.processor.linear import linear
from gpusim.kernels.sensor.expose import expose
from gpusim.kernels.sensor.noise import noise
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.spectral.materials import materials
from gpusim.planner.highlights import point_kernels
from gpusim.planner.plan import BORDER_REACH, Plan, plan
from gpusim.planner.rendering import Rendering, rendering
from gpusim.report import Error, Report, StageReport

DEMOSAICS = {"bilinear": bilinear, "adaptive": adaptive}


@dataclass(frozen=True, eq=False)
class Exposure:
    """The noise-free capture of a scene: computed once, drawn from many times.

    mean: mean electrons of every pixel without dark current, array of the device, shape (rows, cols) [e-].
    exposure_time: [s]. rendering: how its values become colours. ms: milliseconds per stage that it took.
    """

    plan: Plan
    mean: Any
    exposure_time: float
    rendering: Rendering
    ms: dict = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Frame:
    """One simulated picture.

    camera, exposure_time [s], rendering: what it was taken and developed with.
    mean: mean electrons without noise, float32 (rows, cols) [e-]. raw: digital numbers, uint16 (rows, cols) [DN].
    linear: linear display RGB before clipping, float32 (3, rows, cols). rgb: sRGB codes, uint8 (rows, cols, 3).
    """

    camera: Camera
    exposure_time: float
    rendering: Rendering
    mean: np.ndarray
    raw: np.ndarray
    linear: np.ndarray
    rgb: np.ndarray
    report: Report

    def save(self, path):
        """Write .png, .exr, .dng or .npz: see `gpusim.io.frames.write_frame`."""
        write_frame(path, self)


class Simulator:
    """A camera on a device.

    camera: what takes the picture. device: a name for `open_device`, or a Device. tolerance: a preset's name, a
    relative RMS error or a Tolerance: wavelengths are fused into the fewest planes that are predicted to meet it, and
    with `verify` the report says whether it is met; without one every wavelength is exact. guaranteed: predict for the
    worst spectrum there can be, a monochromatic point, and not for the scene's own. reach: pixels of surroundings on
    each side that take part in the blur.
    Raises DeviceError, UnknownName, OutOfRange (a tolerance below what float32 can hold).
    """

    def __init__(self, camera: Camera, *, device: Device | str = "auto", tolerance: Tolerance | str | None = None,
                 guaranteed: bool = False, reach: int = BORDER_REACH):
        self.camera = camera
        self.guaranteed = guaranteed
        self.reach = reach
        self.device = open_device(device) if isinstance(device, str) else device
        self.tolerance = None if tolerance is None else Tolerance.parse(tolerance)
        if self.tolerance and self.tolerance.rms and self.tolerance.rms < 1e-6 and self.device.kind != "numpy":
            raise OutOfRange("tolerance rms", self.tolerance.rms, "rms >= 1e-6 in float32; below it use device numpy")
        sensor = camera.sensor
        if not (sensor.is_monochrome or sensor.bayer_phase):
            raise UnknownName(f"sensor.cfa of camera {camera.name!r}", "/".join(sensor.cfa),
                              ["RG/GB", "GR/BG", "GB/RG", "BG/GR", "one letter"])
        self._kept: dict = {}  # what -> (key, value): tables of the last plan, for the next frame of the same kind

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
        exposure = self.expose(scene)
        mean = np.array(self.device.numpy(exposure.mean), np.float32)
        error = None
        if verify:
            # surroundings as large as the frame: the border's error is part of the true error, and no light wraps
            reference = Simulator(self.camera, device="numpy", reach=max(scene.shape)).expose(
                scene, exposure.exposure_time)
            error = Error.between(mean, reference.mean, self.camera.sensor.read_noise)
        for number in range(first, first + count):
            with self.device.timed() as ms:
                raw = self.draw(exposure.mean, exposure.exposure_time, seed=seed, frame=number)
                shown, rgb = self.develop(raw, exposure)
            raw, shown, rgb = (np.array(self.device.numpy(array)) for array in (raw, shown, rgb))
            report = self._report(exposure, ms, seed, number, error, kept=number > first)
            yield Frame(self.camera, exposure.exposure_time, exposure.rendering, mean, raw, shown, rgb, report)

    def plan(self, scene: Scene) -> Plan:
        """What a frame of `scene` takes. Raises BadData, DoesNotFit."""
        most = LENGTHS[-1] // 2 - 2 * scene.margin if scene.border == "zero" else (
            LENGTHS[-1] - 2 * (self.reach + scene.margin))
        if max(scene.shape) > most:
            raise OutOfRange("scene size", "x".join(map(str, scene.shape[::-1])), f"up to {most} pixels each way")
        made = plan(scene, self.camera, transform_lengths, self._sampled_tables, self.tolerance, self.guaranteed,
                    self.reach)
        available = self.device.memory
        needed = made.bytes_needed * (4 if self.device.kind == "numpy" else 1)  # float64 and complex temporaries
        if needed > available:
            raise DoesNotFit(f"{scene.name} ({scene.shape[1]}x{scene.shape[0]})", needed, available, self.device.name)
        return made

    def expose(self, scene: Scene, exposure_time: float | None = None) -> Exposure:
        """Mean electrons of `scene`; the exposure time [s] is the camera's unless given, automatic if that is None.

        Automatic exposure takes the brightest pixel to 95 % of saturation. Raises BadData, DoesNotFit, OutOfRange.
        """
        made = self.plan(scene)
        sensor = self.camera.sensor
        with self.device.timed() as ms:
            rates = self._rates(made)
            exposure_time = exposure_time or sensor.exposure_time
            if exposure_time is None:
                per_second = self._expose(made, rates, 1.0)
                exposure_time = auto_exposure(self.device.numpy(per_second), sensor.saturation)
            mean = self._expose(made, rates, exposure_time)
        return Exposure(made, mean, float(exposure_time), rendering(made, float(exposure_time)), dict(ms))

    def draw(self, mean, exposure_time: float, *, seed: int = 0, frame: int = 0):
        """Digital numbers (rows, cols) uint16 drawn around mean electrons [e-]; equal on every device for equal means.

        mean: NumPy array or array of the device; the result is of the same kind.
        """
        sensor = self.camera.sensor
        return noise(mean, dark_electrons=sensor.dark_current * exposure_time, read_noise=sensor.read_noise,
                     prnu=sensor.prnu, dsnu=sensor.dsnu, full_well=sensor.full_well,
                     gain=sensor.gain_dn_per_electron, black_level=sensor.black_level, white_level=sensor.white_level,
                     photon_noise=sensor.photon_noise, seed=seed, sensor_seed=sensor.fixed_pattern_seed, frame=frame,
                     device=self.device)

    def develop(self, raw, exposure: Exposure):
        """Linear display RGB (3, rows, cols) and sRGB codes (rows, cols, 3) of digital numbers."""
        sensor, processor = self.camera.sensor, self.camera.processor
        transform = exposure.rendering
        scale = 1 / (sensor.white_level - sensor.black_level)
        if sensor.is_monochrome:
            camera_rgb = linear(raw, black_level=sensor.black_level, scale=scale, device=self.device)
        else:
            phase = "".join(sensor.cfa)
            camera_rgb = DEMOSAICS[processor.demosaic](raw, phase=phase, black_level=sensor.black_level, scale=scale,
                                                       device=self.device)
        shown = color(camera_rgb, self.device.array(transform.display_from_camera), ceiling=transform.ceiling,
                      device=self.device)
        return shown, srgb(shown, device=self.device)

    def _rates(self, made: Plan):
        """Electrons per second, planes (1 or C, rows, cols), and the mosaic's pattern over these planes."""
        device, content, margin = self.device, made.content, made.scene.margin
        cfa = self.camera.sensor.cfa_indices
        inner = slice(margin, -margin or None)
        if made.gains is None:  # no blur: nothing outside the frame is needed
            return self._planes(content, made.table, (inner, inner)), cfa
        planes = self._planes(content, made.table, (slice(None), slice(None)))
        border = "edge" if made.scene.border == "scene" else made.scene.border
        if made.folded:
            rates = mosaic(planes, self._transfer(made), made.gains, cfa, border, made.period, margin=margin,
                           device=device)
        else:
            rates = blur(planes, self._transfer(made), made.gains, border, made.period, margin=margin, device=device)
            if made.highlights is None:
                return rates, cfa
            rates = expose(rates, cfa, 1.0, 0.0, device=device)  # the mosaic, for one second
        if made.highlights is not None:
            rates = self._with_highlights(made, rates, cfa)
        return device.reshape(rates, (1, *rates.shape)), np.zeros((1, 1), np.int32)

    def _with_highlights(self, made: Plan, rates, cfa):
        """The mosaic with the plan's highlights added."""
        lights, device = made.highlights, self.device
        assert lights is not None
        reach = int(lights.reach.max())
        kernels = self._keep("points", (made.q.tobytes(), reach), lambda: point_kernels(
            made.q, np.sqrt(self.camera.sensor.fill_factor), reach))
        weights = lights.spectra[:, None] * made.weights  # (kernels, channels, L)
        places = np.column_stack([lights.places, lights.light, lights.reach])
        return splat(rates, device.array(cfa, np.int32), device.array(places, np.int32),
                     device.array(lights.strength), device.array(np.tensordot(weights, kernels.cores, 1)),
                     device.array(np.tensordot(weights, kernels.profiles, 1)), kernels.step, kernels.parts,
                     kernels.spread, device=device)

    def _keep(self, what, key, make):
        """What `make` gave for `key` the last time, or gives now; one value of each kind is kept."""
        if self._kept.get(what, (None,))[0] != key:
            self._kept[what] = (key, make())
        return self._kept[what][1]

    def _sampled_tables(self, q, aperture, rows, cols):
        """Transfer tables for the planner, float64."""
        return self._keep("sampled", (q.tobytes(), aperture, rows, cols),
                          lambda: self._bands(q, rows, cols, open_device("numpy")))

    def _planes(self, content, table, window):
        """The planes that are transformed, or the channels themselves, as an array of the device."""
        device = self.device
        if isinstance(content, Materials):
            ids, shading = content.ids[window], content.shading[window]
            return materials(device.array(ids, np.uint16), device.array(shading), device.array(table), device=device)
        stored = content.values if isinstance(content, Cube) else content.coefficients
        stored = device.array(stored[(slice(None), *window)])
        return stored if table is None else integrate(stored, device.array(table), device=device)

    def _transfer(self, made: Plan):
        """Transfer tables (groups, planes, ...) of the plan, kept for the next frame of the same kind."""
        assert made.gains is not None  # a plan with blur
        key = (made.q.tobytes(), made.period, made.gains.shape,
               made.transfers.tobytes() if made.transfers is not None else None)
        return self._keep("transfer", key, lambda: self._make_transfer(made))

    def _bands(self, q, rows, cols, device):
        """Transfer tables of every wavelength: quarters where the optics is the same at every angle, else halves."""
        optics, sensor = self.camera.optics, self.camera.sensor
        pitch = sensor.pixel_pitch
        aperture = sensor.aperture / pitch
        if optics.is_ideal:
            return airy(device.array(q), aperture, rows, cols, device=device)
        waves = optics.waves(q * pitch / optics.working_f_number * 1e9)
        return pupil(optics.pupil, waves, device.array(q), aperture, rows, cols, device=device,
                     spots=tuple(length / pitch for length in optics.birefringence), diffuser=optics.diffuser / pitch)

    def _make_transfer(self, made):
        device = self.device
        bands = self._bands(made.q, *made.period, device)
        if made.transfers is None:
            return device.reshape(bands, (1, *bands.shape))
        channels, planes, count = made.transfers.shape
        tables = integrate(bands, device.array(made.transfers.reshape(channels * planes, count)), device=device)
        return device.reshape(tables, (channels, planes, *bands.shape[1:]))

    def _expose(self, made: Plan, rates, exposure_time):
        planes, cfa = rates
        return expose(planes, cfa, exposure_time, made.slope, device=self.device)

    def _report(self, exposure, ms, seed, number, error, kept):
        made, camera = exposure.plan, self.camera
        sensor, processor = camera.sensor, camera.processor
        times = dict(ms) if kept else {**exposure.ms, **ms}
        on = [name for name, used in (
            ("photon", sensor.photon_noise), ("dark current", sensor.dark_current), ("read", sensor.read_noise),
            ("PRNU", sensor.prnu), ("DSNU", sensor.dsnu)) if used]
        demosaic = "processor.linear" if sensor.is_monochrome else f"processor.{processor.demosaic}"
        models = made.models | {
            "sensor.noise": f"{', '.join(on) or 'no noise'}; full well, {sensor.bits} bit",
            demosaic: "monochrome" if sensor.is_monochrome else f"{processor.demosaic} demosaicking",
            "processor.color": exposure.rendering.model, "display.srgb": "sRGB, 8 bit"}
        order = ("spectral.integrate", "spectral.materials", "optics.airy", "optics.pupil", "optics.blur",
                 "optics.mosaic", "optics.splat", "sensor.expose", "sensor.noise", demosaic, "processor.color",
                 "display.srgb")
        stages = [StageReport(name, models[name], times.get(name, 0.0)) for name in order if name in models]
        scene = made.scene
        form = type(scene.content).__name__.lower()
        notes = [] if scene.light_is_known else ["the scene's light is unknown: colours are rendered for D65, "
                                                 "saturation is display white"]
        return Report(
            {"name": scene.name, "rows": scene.shape[0], "cols": scene.shape[1], "form": form, "border": scene.border,
             "wavelengths_nm": [float(scene.wavelengths[0]), float(scene.wavelengths[-1])],
             "bands": len(scene.wavelengths)},
            {"name": camera.name, "f_number": camera.optics.f_number, "exposure_time_s": exposure.exposure_time,
             "exposure_value": float(exposure_value(camera.optics.f_number, exposure.exposure_time))},
            {"name": self.device.name, "kind": self.device.kind}, number, seed, stages, made.predicted, made.left_out,
            error, self.tolerance, notes)
