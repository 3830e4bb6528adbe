"""Pictures of a scene by a client's camera: what a slider touches is computed anew, the rest is kept."""

import time
from dataclasses import dataclass, field
from math import log10

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.scene import Scene
from gpusim.frame import Frame
from gpusim.io.scenes import relit
from gpusim.preview.state import State
from gpusim.simulator import Simulator

BINS, SOME = 64, 60000  # of the histogram; pixels in it, about
SPREAD = 4.0  # standard deviations of noise from black to white
RAW_GAMMA = 2.2  # of the mosaic's picture


@dataclass(frozen=True, eq=False)
class Picture:
    """What is shown: codes, uint8 (rows, cols, 3). number: of the frame. ms: that it took. facts: for the page."""

    codes: np.ndarray
    number: int
    ms: float
    facts: dict = field(default_factory=dict)


class Producer:
    """A client's pictures of a scene. Used by one thread at a time, as all that share a device."""

    def __init__(self, scene: Scene, device: Device):
        self._scene, self._device = scene, device
        self._built: tuple[State | None, Camera | None] = None, None
        self._program = None
        self._tolerance: str | None = None
        self._lit: tuple = (None, None, scene)

    def picture(self, state: State, number: int, drafts: bool = False) -> Picture:
        """A frame of a state. drafts: see `Program.update`. Raises what the camera, the light and the simulation do."""
        begun = time.perf_counter()
        program = self._updated(state, drafts)
        show = {"rendered": self._rendered, "raw": self._raw, "electrons": self._electrons, "noise": self._noise}
        codes = np.ascontiguousarray(show[state.view](program, state.seed, number))
        account, exposure = program.account, program.exposure
        plan = program.plan
        tolerance = None if plan.is_draft else program.simulator.tolerance
        facts = {"error": account.total.rms, "left out": plan.left_out, "draft": plan.is_draft,
                 "verdict": None if tolerance is None else account.verdict(tolerance).met,
                 "exposure": exposure.exposure_time, "gain": exposure.gain}
        return Picture(codes, number, 1e3 * (time.perf_counter() - begun), facts)

    def frame(self, state: State, number: int) -> Frame:
        """A frame to be saved: of a simulator of its own, as `gpusim simulate` makes it. Raises as `picture`."""
        simulator = Simulator(state.built(), device=self._device, tolerance=state.asked)
        return next(simulator.frames(self._scene_in(state), 1, seed=state.seed, first=number)).complete()

    def statistics(self, state: State, at: tuple[int, int] | None = None) -> dict:
        """Histogram of the mean electrons, and what a pixel has.

        counts: of some of the pixels, in BINS from 0 to `full well`, of each channel's letter. at: row and column, or
        None. Raises as `picture`.
        """
        program = self._updated(state, drafts=True)
        exposure, sensor = program.exposure, program.exposure.camera.sensor
        mean = exposure.layered(self._on_host(exposure.mean))
        full = float(sensor.saturation)
        counts = {letter: np.histogram(np.minimum(values, full), BINS, (0, full))[0].tolist()
                  for letter, values in _some(sensor, mean)}
        found = {"counts": counts, "full well": full, "black level": float(sensor.dark_level)}
        if at is not None and mean.ndim == 2:
            y, x = (min(max(place, 0), n - 1) for place, n in zip(at, mean.shape, strict=True))
            electrons, noise = float(mean[y, x]), RawNoise.of(sensor, program.simulator.readout.averaged)
            sigma = float(noise.variance(electrons, temporal=True)) ** 0.5
            numbers = min(electrons * sensor.gain_dn_per_electron + sensor.dark_level, sensor.white_level)
            found["pixel"] = {"row": y, "col": x, "electrons": electrons, "dn": float(numbers),
                              "snr": 20 * log10(max(electrons, 1e-9) / max(sigma, 1e-9))}
        return found

    def _updated(self, state, drafts):
        last, camera = self._built
        if last is None or camera is None or (last.camera, last.changes) != (state.camera, state.changes):
            camera = state.built()
            self._built = state, camera
        scene = self._scene_in(state)
        if self._program is None or self._tolerance != state.tolerance:
            self._program = Simulator(camera, device=self._device, tolerance=state.asked).program(scene)
            self._tolerance = state.tolerance
        changes = {}
        if camera is not self._program.simulator.camera or (not drafts and self._program.plan.is_draft):
            changes["camera"] = camera
        if scene is not self._program.scene:
            changes["scene"] = scene
        if changes:
            before = self._program.simulator.camera, self._program.scene
            try:
                self._program.update(**changes, drafts=drafts)
                self._program.exposure  # noqa: B018  what is wrong is said now
            except Exception:
                self._program.update(camera=before[0], scene=before[1])
                self._built = None, None
                raise
        return self._program

    def _scene_in(self, state):
        light, luminance, scene = self._lit
        if (light, luminance) != (state.light, state.luminance):
            self._lit = state.light, state.luminance, relit(self._scene.name, self._scene, state.light, state.luminance)
            scene = self._lit[2]
        return scene

    def _on_host(self, array):
        return np.array(self._device.numpy(array))

    def _rendered(self, program, seed, number):
        return self._on_host(program.codes(seed=seed, frame=number))

    def _raw(self, program, seed, number):
        raw = self._on_host(program.raw(seed=seed, frame=number))
        sensor = program.exposure.camera.sensor
        shown = np.clip((raw - np.float32(sensor.black_level)) / (sensor.white_level - sensor.black_level), 0, 1)
        return _mosaic(sensor, program.exposure.layered(np.uint8(255 * shown ** (1 / RAW_GAMMA) + 0.5)))

    def _electrons(self, program, seed, number):
        mean = program.exposure.layered(self._on_host(program.exposure.mean))
        sensor = program.exposure.camera.sensor
        return _mosaic(sensor, np.uint8(255 * np.clip(mean / sensor.saturation, 0, 1) ** (1 / RAW_GAMMA) + 0.5))

    def _noise(self, program, seed, number):
        exposure, sensor = program.exposure, program.exposure.camera.sensor
        raw = exposure.layered(self._on_host(program.raw(seed=seed, frame=number)))
        mean = exposure.layered(self._on_host(exposure.mean))
        expected = np.minimum(mean * sensor.gain_dn_per_electron + sensor.dark_level, sensor.white_level)
        sigma = np.sqrt(mean + sensor.read_sigma**2) * sensor.gain_dn_per_electron
        shown = np.clip(0.5 + (raw - expected) / (2 * SPREAD * np.maximum(sigma, 1e-9)), 0, 1)
        return _grey(np.uint8(255 * shown + 0.5))


def _some(sensor, values):
    """Channels' letters, and values of some of their pixels."""
    if values.ndim == 3:
        step = max(1, values[0].size // SOME)
        return zip(sensor.channels, values.reshape(len(values), -1)[:, ::step], strict=True)
    cfa = sensor.cfa_indices
    high, wide = cfa.shape
    step = max(1, round((values.size / SOME) ** 0.5))
    return [(letter, np.concatenate([values[y :: high * step, x :: wide * step].ravel()
                                     for y, x in np.argwhere(cfa == index)]))
            for index, letter in enumerate(sensor.channels)]


def _mosaic(sensor, values):
    """Codes (rows, cols, 3) of a mosaic in its filters' colours; of one channel or of other letters, in grey."""
    if values.ndim == 3:
        shown = values if len(values) == 3 else np.repeat(values.mean(axis=0, dtype=np.float32)[None], 3, 0)
        return np.moveaxis(shown.astype(np.uint8), 0, -1)
    if not {*sensor.channels} <= {*"RGB"} or sensor.is_monochrome:
        return _grey(values)
    shape = values.shape
    colours = np.array(["RGB".index(letter) for letter in sensor.channels])[sensor.cfa_indices]
    tiled = np.tile(colours, [-(-n // m) for n, m in zip(shape, colours.shape, strict=True)])[: shape[0], : shape[1]]
    return values[..., None] * (tiled[..., None] == np.arange(3))


def _grey(values):
    return np.repeat((values if values.ndim == 2 else values.mean(axis=0).astype(np.uint8))[..., None], 3, axis=2)
