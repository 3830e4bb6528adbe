"""Pictures of a scene by a client's camera.

A slider recomputes only the steps that depend on it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from gpusim.apps.preview.half import HalfLoop
from gpusim.apps.preview.measures import edge, error_map, light, on_host
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Scenes
from gpusim.backends import Device
from gpusim.captures.capture import Capture, Light
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, Conflict
from gpusim.io.scene.scenes import relight
from gpusim.judge.truth import mean_and_truth, require_truth
from gpusim.measure.checker import checker_of
from gpusim.measure.mosaic import color_mosaic
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.loop import Loop
from gpusim.pipeline.report import Error
from gpusim.pipeline.simulator import Simulator

SPREAD = 4.0  # standard deviations of noise from black to white
RAW_GAMMA = 2.2  # of the mosaic's picture
NUMBERS = 2**32  # of frames of a scene that does not move


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture: codes, uint8 (rows, cols, 3).

    number: of the frame. ms: time it took. facts: data for the page.
    """

    codes: np.ndarray
    number: int
    ms: float
    facts: dict = field(default_factory=dict)


class Producer:
    """A client's pictures of scenes. One thread at a time may use it, and another one `half_picture`.

    It holds no memory of the device before its first picture, and after `release`.

    Attributes:
        period: Least time between frames of moving scenes [s], 0 for still ones.
        frames: Number of frames.
        device: The device.
    """

    def __init__(
        self,
        scenes: Scenes,
        device: Device,
        period: float = 0.0,
        capture: Capture | None = None,
    ):
        if capture is not None and capture.has_frames:
            reason = "a preview shows one frame of each scene"
            raise Conflict("capture", reason, "merge its frames")
        self._scenes, self.device, self.period = scenes, device, period
        self._capture = capture
        self.frames = NUMBERS if scenes.is_still else scenes.count
        self._choosing = Lock()  # of camera and scene
        self.release()

    def release(self) -> None:
        """Forget all that pictures have in common. The next one takes as long as the first."""
        self._built: tuple[State | None, Camera | None] = None, None
        self._loop: Loop | None = None
        self._half = HalfLoop()
        self._tolerance: str | None = None
        self._shown: tuple = (None, None)  # number and scene
        self._arriving, self._next = self._scenes.between(0, 0), -1
        self._lit: tuple = (None, None, None, None)
        self._other: Producer | None = None
        self._checker: tuple = (None, None)

    @property
    def holds_memory(self) -> bool:
        """Whether there is something to `release`."""
        return self._loop is not None or self._shown[1] is not None

    def picture(self, state: State, number: int, drafts: bool = False) -> Picture:
        """Return a picture of a state. drafts: see `Loop.update`.

        Raises as camera, light and simulation do.
        """
        begun = time.perf_counter()
        loop = self._update(state, number, drafts)
        other = None
        if state.other is None:
            self._other = None  # frees its memory on the device
        else:
            self._other = self._other or Producer(self._scenes, self.device, capture=self._capture)
            other = self._other.picture(state.other, number, drafts).codes
        return self._show(loop, state, number, begun, other)

    def half_picture(self, state: State, number: int) -> Picture | None:
        """Return a draft of half as many rows and columns; None if there is none.

        It plans nothing, and may be called while another thread calls other methods, which may plan.

        Raises as camera, light and simulation do.
        """
        begun = time.perf_counter()
        if self._capture is not None or state.other is not None or not self._scenes.is_still:
            return None
        loop = self._loop
        if loop is not None and self._tolerance == state.tolerance:
            camera, scene = self._build(state), self._scene_in(state, number)
            half = self._half.update(loop, camera, scene)
            if half is not None:
                made = self._show(half, state, number, begun)
                return replace(made, facts=made.facts | {"is half": True})
        return None

    def _show(self, loop, state, number, begun, other=None):
        """Return the picture of a loop. other: codes to show beside it."""
        show = {
            "rendered": self._render,
            "raw": self._raw,
            "electrons": self._electrons,
            "noise": self._noise,
        }
        shown = self._shown_frame(loop, state.seed, number)
        codes = np.ascontiguousarray(show[state.view](shown))
        account, exposure = loop.account, loop.expose()
        plan = loop.plan
        tolerance = None if plan.is_draft else loop.simulator.tolerance
        verdict = None if tolerance is None else account.verdict(tolerance)
        facts = {
            "error": account.total.rms,
            "left out": plan.left_out,
            "draft": plan.is_draft,
            "verdict": verdict and verdict.state,
            "unknown": verdict.unknown if verdict else account.unknown,
            "exposure": exposure.exposure_time,
            "gain": exposure.gain,
        }
        if other is not None:
            codes = _beside(codes, other, state.split)
        return Picture(codes, number, 1e3 * (time.perf_counter() - begun), facts)

    def frame(self, state: State, number: int) -> Frame:
        """Return a frame to save, from a new simulator, as of `gpusim simulate`.

        Raises as `picture`.
        """
        simulator = Simulator(state.build(), device=self.device, tolerance=state.asked)
        scene = self._scene_in(state, number)
        if self._capture is not None:
            first = number * self._capture.count
            (frame,) = self._capture.take(simulator, scene, seed=state.seed, first=first)
            return frame.complete()
        return next(simulator.frames(scene, 1, seed=state.seed, first=number)).complete()

    def error(self, state: State, number: int) -> Callable[[], tuple[np.ndarray, Error]]:
        """Return a function that returns a map of the error of the mean electrons, and that error.

        It takes seconds, in any thread. The map is codes (rows, cols, 3) of the frame that `frame`
        returns. Raises as `picture` and `Simulator` with `verify` do; the function raises BadData
        for a large frame with a blur that varies over the field.
        """
        simulator = Simulator(state.build(), device=self.device, tolerance=state.asked)
        scene = self._scene_in(state, number)
        require_truth(simulator.camera, scene)
        exposure = simulator.expose(scene)
        exposure = replace(exposure, mean=self._on_host(exposure.mean))

        def compare():
            mean, truth = mean_and_truth(simulator, scene, exposure)
            if mean.ndim == 1:
                raise BadData(
                    "error map: the frame is too large for the reference of a blur that varies over "
                    "the field"
                )
            error = Error.between(mean, truth, simulator.camera.sensor.read_sigma)
            return error_map(mean, truth), error

        return compare

    def statistics(
        self,
        state: State,
        number: int,
        at: tuple[int, int] | None = None,
        part: tuple[slice, slice] | None = None,
    ) -> dict:
        """Return the measurements next to the picture, see `gpusim.apps.preview.measures`.

        at: row and column of a pixel. part: rows and columns of an edge, or None. Raises as
        `picture`.
        """
        loop = self._update(state, number, drafts=True)
        exposure = loop.exposure
        found = light(loop, exposure.split_layers(self._on_host(exposure.mean)), at)
        scene = loop.scene
        if self._checker[0] is not scene:
            self._checker = scene, checker_of(scene)
        checker = self._checker[1]
        if part is None and checker is None:
            return found
        linear, rendering = loop.linear(seed=state.seed, first=number)
        linear = np.moveaxis(self._on_host(linear), 0, -1)
        if part is not None:
            found["edge"] = edge(linear, part)
        if checker is not None and linear.shape[:2] == scene.shape:
            differences = checker.differences(linear, rendering.diffuser, exposure.camera.display)
            found["difference"] = float(differences.mean())
        return found

    def _build(self, state):
        """Return the camera of a state."""
        with self._choosing:
            last, camera = self._built
            wanted = state.camera, state.changes
            if last is None or camera is None or (last.camera, last.changes) != wanted:
                camera = state.build()
                self._built = state, camera
            return camera

    def _update(self, state, number, drafts):
        camera, scene = self._build(state), self._scene_in(state, number)
        if self._loop is None or self._tolerance != state.tolerance:
            simulator = Simulator(camera, device=self.device, tolerance=state.asked)
            self._loop, self._tolerance = simulator.loop(scene), state.tolerance
        changes = {}
        must_plan = not drafts and self._loop.plan.is_draft
        if camera is not self._loop.simulator.camera or must_plan:
            changes["camera"] = camera
        if scene is not self._loop.scene:
            changes["scene"] = scene
        if changes:
            before = self._loop.simulator.camera, self._loop.scene
            try:
                self._loop.update(**changes, drafts=drafts)
                self._loop.expose()  # raises errors now
            except Exception:
                self._loop.update(camera=before[0], scene=before[1])
                self._built = None, None
                raise
        return self._loop

    def _scene_in(self, state, number):
        """Return the scene of a frame in the light of a state."""
        with self._choosing:
            return self._lit_scene(state, number)

    def _lit_scene(self, state, number):
        number = 0 if self._scenes.is_still else number % self._scenes.count
        if self._shown[0] != number:
            if number != self._next:
                self._arriving = self._scenes.between(number, self._scenes.count)
            self._next = -1  # if the scene cannot be read, the next request starts anew
            self._shown = number, next(self._arriving)
            self._next = number + 1
        own = self._shown[1]
        if state.light is None and state.luminance is None:
            return own
        light, luminance, last, scene = self._lit
        if last is not own or (light, luminance) != (state.light, state.luminance):
            scene = relight(own.name, own, state.light, state.luminance)
            self._lit = state.light, state.luminance, own, scene
        return scene

    def _on_host(self, array):
        return on_host(self.device, array)

    def _shown_frame(self, loop, seed, number):
        """Return the frame that is shown: its values are computed when they are read."""
        if self._capture is None:
            return _Shown(self, loop, seed, number)
        first = number * self._capture.count
        shots = self._capture.shots(Light.of(self._capture, loop, first), seed, first)
        return self._capture.frames(loop.simulator, shots)[0]

    def _render(self, frame):
        return frame.rgb

    def _raw(self, frame):
        sensor = frame.camera.sensor
        span = sensor.white_level - sensor.black_level
        codes = _encode((frame.raw - np.float32(sensor.black_level)) / span)
        return color_mosaic(sensor, codes)

    def _electrons(self, frame):
        sensor = frame.camera.sensor
        return color_mosaic(sensor, _encode(frame.mean / sensor.saturation))

    def _noise(self, frame):
        sensor = frame.camera.sensor
        expected = np.minimum(
            frame.mean * sensor.gain_dn_per_electron + sensor.dark_level, sensor.white_level
        )
        sigma = np.sqrt(np.maximum(frame.mean, 0) + sensor.read_sigma**2)
        sigma *= sensor.gain_dn_per_electron
        shown = np.clip(0.5 + (frame.raw - expected) / (2 * SPREAD * np.maximum(sigma, 1e-9)), 0, 1)
        return _grey(np.uint8(255 * shown + 0.5))


class _Shown:
    """A frame of a loop, with the fields of a Frame that the preview shows."""

    def __init__(self, producer, loop, seed, number):
        self._producer, self._loop, self._numbers = producer, loop, {"seed": seed, "first": number}

    @property
    def camera(self):
        return self._loop.expose().camera

    @property
    def rgb(self):
        return self._producer._on_host(self._loop.codes(**self._numbers))

    @property
    def raw(self):
        exposure = self._loop.expose()
        return exposure.split_layers(self._producer._on_host(self._loop.raw(**self._numbers)))

    @property
    def mean(self):
        exposure = self._loop.expose()
        return exposure.split_layers(self._producer._on_host(exposure.mean))


def _encode(light):
    """Return codes of light, 1 for white."""
    return np.uint8(255 * np.clip(light, 0, 1) ** (1 / RAW_GAMMA) + 0.5)


def _beside(codes, others, split):
    """Return one picture on the left of a line, and another on its right."""
    if codes.shape != others.shape:
        raise BadData(
            f"the other camera's frame has {others.shape[1]}x{others.shape[0]} pixels; wanted "
            f"{codes.shape[1]}x{codes.shape[0]}, as this one's has"
        )
    at = round(split * codes.shape[1])
    codes = np.concatenate([codes[:, :at], others[:, at:]], axis=1)
    codes[:, max(at - 1, 0) : at + 1] = 255
    return codes


def _grey(values):
    return np.repeat(
        (values if values.ndim == 2 else values.mean(axis=0).astype(np.uint8))[..., None], 3, axis=2
    )
