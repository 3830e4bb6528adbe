"""Pictures of a scene by a client's camera.

A slider recomputes only the steps that depend on it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from gpusim.apps.preview.comparison import compare
from gpusim.apps.preview.half import HalfLoop
from gpusim.apps.preview.looks import Made, Optics, Shown
from gpusim.apps.preview.measures import Inputs, error_map, find_clipping, mark_clipping, on_host
from gpusim.apps.preview.panels_light import describe_clipping
from gpusim.apps.preview.shelf import Shelf
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Scenes
from gpusim.backends import Device
from gpusim.captures.capture import Capture, Light
from gpusim.domain.camera import Camera
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadData, Conflict, GpusimError
from gpusim.domain.scene import PANORAMA
from gpusim.io.scene.scenes import open_again, relight
from gpusim.judge.truth import mean_and_truth, require_truth
from gpusim.measure.mosaic import color_mosaic
from gpusim.optics.labels import carry_labels
from gpusim.optics.panorama import view_panorama
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.loop import Loop
from gpusim.pipeline.report import Error
from gpusim.pipeline.simulator import Simulator

SPREAD = 4.0  # standard deviations of noise from black to white
RAW_GAMMA = 2.2  # of the mosaic's picture
NUMBERS = 2**32  # of frames of a scene that does not move
TIMED = 1.0  # [s] between two measurements of the time of frames
OF_FRAME = ("rendered", "raw", "electrons", "noise")  # views of the frame, pixel by pixel


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture: codes, uint8 (rows, cols, 3).

    number: of the frame. ms: time it took. facts: data for the page. count: pictures side by side.
    """

    codes: np.ndarray
    number: int
    ms: float
    facts: dict = field(default_factory=dict)
    count: int = 1


class Producer:
    """A client's pictures of scenes. One thread at a time may use it, and another one `half_picture`.

    It holds no memory of the device before its first picture, and after `release`.

    Args:
        scenes: Scenes that are shown while a state names none.
        device: The device.
        period: Least time between frames of moving scenes [s], 0 for still ones.
        capture: Capture of each picture; None is one frame.
        shelf: Scenes that states name, and their files.

    Attributes:
        period: See there.
        frames: Number of frames.
        device: The device.
        shelf: See there.
    """

    def __init__(
        self,
        scenes: Scenes,
        device: Device,
        period: float = 0.0,
        capture: Capture | None = None,
        shelf: Shelf | None = None,
    ):
        if capture is not None and capture.has_frames:
            reason = "a preview shows one frame of each scene"
            raise Conflict("capture", reason, "merge its frames")
        self._scenes, self.device, self.period = scenes, device, period
        self._capture = capture
        self.shelf = shelf or Shelf()
        self.frames = NUMBERS if scenes.is_still else scenes.count
        self._choosing = Lock()  # of camera and scene
        self._begin()

    def release(self) -> None:
        """Free the shared parts of pictures, and open scenes. The next picture takes the time of a first one."""
        self._begin()
        self.shelf.forget_scenes()

    def _begin(self):
        """Have nothing in common with earlier pictures."""
        self._built: tuple[State | None, Camera | None] = None, None
        self._loop: Loop | None = None
        self._half = HalfLoop()
        self._shape: tuple[int, int] = 0, 0  # of the last picture that was no half draft
        self._tolerance: str | None = None
        self._shown: tuple = (None, None)  # number and scene
        self._arriving, self._next = self._scenes.between(0, 0), -1
        self._lit: tuple = (None, (), None)  # scene, light and luminance, and the lit scene
        self._seen: tuple = (None, (), None)  # panorama, what its view depends on, and the view
        self._others: list[Producer] = []
        self._optics = Optics(self.device)
        self._made: Made | None = None  # the last whole picture
        self._ms: dict[str, float] = {}  # of each step when it ran last
        self._timed = -TIMED  # when the steps of frames were timed last

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
        others = state.others
        del self._others[len(others) :]  # frees their memory on the device
        while len(self._others) < len(others):
            self._others.append(self._companion())
        pairs = zip(self._others, others, strict=True)
        codes = [own.picture(other, number, drafts).codes for own, other in pairs]
        return self._show(loop, state, number, begun, drafts, codes)

    def half_picture(self, state: State, number: int) -> Picture | None:
        """Return a draft of half as many rows and columns; None if there is none.

        It plans nothing, and may be called while another thread calls other methods, which may plan.

        Raises as camera, light and simulation do.
        """
        begun, loop = time.perf_counter(), self._loop
        is_whole = self._capture is not None or state.others or not self._scenes.is_still
        if is_whole or loop is None or state.view not in OF_FRAME:
            return None
        if self._tolerance != state.tolerance:
            return None
        camera = self._build(state)
        half = self._half.update(loop, camera, self._scene_in(state, number, camera))
        if half is None:
            return None
        made = self._show(half, state, number, begun, True)
        return replace(made, facts=made.facts | {"is half": True})

    def _show(self, loop, state, number, begun, drafts, others=None):
        """Return the picture of a loop. others: codes to show with it; None: it has half the size."""
        is_half = others is None
        show = {
            "rendered": self._render,
            "raw": self._raw,
            "electrons": self._electrons,
            "noise": self._noise,
            "scene": lambda _: self._optics.scene_codes(loop.scene),
            "irradiance": lambda _: self._optics.irradiance_codes(
                loop.simulator.camera, loop.scene, state.asked, drafts
            ),
        }
        shown = self._shown_frame(loop, state.seed, number)
        codes = np.ascontiguousarray(show[state.view](shown))
        if not is_half:
            self._shape = codes.shape[:2]
            self._optics.forget(state.view)
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
            "gain": exposure.camera.sensor.analog_gain,
            "metered": {
                "sensor.exposure_time_ms": 1e3 * exposure.exposure_time,
                "sensor.gain_dn_per_e": exposure.camera.sensor.gain_dn_per_electron,
            },
            "scene": state.scene.key,
            "shape": self._shape,
            "has depth": loop.scene.depth is not None,
        }
        made = Made(state, loop, shown, None if plan.is_draft else account, tolerance)
        if not is_half:  # panels do not follow those
            self._made = made
        if state.marks_clipped:
            codes, facts["clipped"] = _mark_clipping(codes, made)
        if others:
            codes = compare(codes, others, state.compare, state.split)
        count = 1 + len(others) if others and state.compare == "side by side" else 1
        return Picture(codes, number, 1e3 * (time.perf_counter() - begun), facts, count)

    def frame(self, state: State, number: int) -> Frame:
        """Return a frame to save, from a new simulator, as of `gpusim simulate`.

        Raises as `picture`.
        """
        simulator = Simulator(self.build(state), device=self.device, tolerance=state.asked)
        scene = self._scene_in(state, number, simulator.camera)
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
        simulator = Simulator(self.build(state), device=self.device, tolerance=state.asked)
        scene = self._scene_in(state, number, simulator.camera)
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

    def inputs(self, needs: frozenset[str] = frozenset(), has_irradiance: bool = False) -> Inputs:
        """Return what panels need of the whole picture that was made last.

        needs: names of arrays, see Inputs, and "times". has_irradiance: add the irradiance if it is
        known. Raises BadData before the first picture.
        """
        now = time.monotonic()
        if "times" in needs and now - self._timed < TIMED:
            needs = needs - {"times"}
        elif "times" in needs:
            self._timed = now
        if self._made is None:
            raise BadData("no picture yet; wanted one before measurements of it")
        irradiance = None
        if has_irradiance:
            irradiance = self._optics.known_irradiance(self._made)
        else:
            self._optics.forget_irradiance()
        return self._made.inputs(needs, self._ms, irradiance)

    def distance(self, pixel: tuple[int, int]) -> float:
        """Return the distance along the axis that a pixel of the last whole picture sees [m].

        Raises BadData if the scene has no depth, and as `carry_labels`.
        """
        made = self._made
        if made is None or made.loop.scene.depth is None:
            raise BadData(
                "focus: the scene has no depth; wanted a scene with the distance of its samples"
            )
        loop = made.loop
        depth = carry_labels(replace(loop.scene, labels={}), loop.simulator.camera)["depth"]
        # of binned pixels, which the picture counts
        row, col = (
            at * n // own for at, n, own in zip(pixel, depth.shape, self._shape, strict=True)
        )
        return float(depth[row, col])

    def irradiance(self) -> None:
        """Compute the irradiance of the picture that was made last, for `inputs`.

        It takes seconds for a large frame. Raises as `Optics.irradiance`.
        """
        if self._made is not None:
            self._optics.irradiance(self._made, self._capture)

    def _build(self, state):
        """Return the camera of a state."""
        with self._choosing:
            last, camera = self._built
            wanted = state.camera, state.changes, state.files
            if last is None or camera is None or (last.camera, last.changes, last.files) != wanted:
                camera = self.build(state)
                self._built = state, camera
            return camera

    def _update(self, state, number, drafts):
        camera = self._build(state)
        scene = self._scene_in(state, number, camera)
        if self._loop is None or self._tolerance != state.tolerance:
            simulator = Simulator(camera, device=self.device, tolerance=state.asked)
            self._loop, self._tolerance = simulator.loop(scene), state.tolerance
            self._ms = dict(self._loop.exposure.ms)
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
                if drafts:
                    self._loop.expose()  # raises errors now
                else:
                    self._ms.update(self._loop.exposure.ms)
            except Exception:
                self._loop.update(camera=before[0], scene=before[1])
                self._built = None, None
                raise
        return self._loop

    def build(self, state: State) -> Camera:
        """Return the camera of a state, whose files are the client's. Raises as `State.build` does."""
        uploads = self.shelf.uploads
        try:
            return state.with_paths(uploads.path).build()
        except GpusimError as error:
            raise uploads.shorten(error) from error

    def _companion(self):
        """Return a producer of the same scenes for a second camera."""
        return Producer(self._scenes, self.device, capture=self._capture, shelf=self.shelf)

    def _scene_in(self, state, number, camera):
        """Return the scene of a frame, in its light, as a camera sees it."""
        with self._choosing:
            return self._seen_scene(state, number, camera)

    def _seen_scene(self, state, number, camera):
        choice = state.scene
        own = self._given_scene(number) if choice.is_given else self.shelf.open(choice)
        scene = self._relight(own, state)
        if scene.projection != PANORAMA:
            return scene
        seen, seen_by, view = self._seen
        by = choice.size, digest(camera.optics), camera.sensor.pixel_pitch
        if seen is not scene or seen_by != by:
            view = view_panorama(scene, camera, size=choice.size)
            self._seen = scene, by, view
        return view

    def _given_scene(self, number):
        """Return the scene of a frame of those that the preview was started with."""
        number = 0 if self._scenes.is_still else number % self._scenes.count
        if self._shown[0] != number:
            if number != self._next:
                self._arriving = self._scenes.between(number, self._scenes.count)
            self._next = -1  # if the scene cannot be read, the next request starts anew
            self._shown = number, next(self._arriving)
            self._next = number + 1
        return self._shown[1]

    def _relight(self, own, state):
        if state.light is None and state.luminance is None:
            return own
        key = state.light, state.luminance, state.files.get(state.light)
        last, last_key, scene = self._lit
        if last is not own or key != last_key:
            change = relight if state.scene.is_given else open_again
            light = state.with_paths(self.shelf.uploads.path).light
            name = own.name if state.scene.is_given else state.scene.name
            scene = change(name, own, light=light, luminance=state.luminance)
            self._lit = own, key, scene
        return scene

    def _on_host(self, array):
        return on_host(self.device, array)

    def _shown_frame(self, loop, seed, number):
        """Return the frame that is shown: its values are computed when they are read."""
        if self._capture is None:
            return Shown(loop, seed, number)
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


def _mark_clipping(codes, made):
    """Return a picture with its clipped pixels marked, and their shares in words."""
    found = made.inputs(frozenset({"raw"}), {})
    shares = find_clipping(found.sensor, found.arrays["raw"], found.merged_rendering)
    if made.state.view in OF_FRAME:
        codes = mark_clipping(codes, *shares)
    return codes, describe_clipping(*shares)


def _encode(light):
    """Return codes of light, 1 for white."""
    return np.uint8(255 * np.clip(light, 0, 1) ** (1 / RAW_GAMMA) + 0.5)


def _grey(values):
    return np.repeat(
        (values if values.ndim == 2 else values.mean(axis=0).astype(np.uint8))[..., None], 3, axis=2
    )
