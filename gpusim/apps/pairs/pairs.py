"""Noisy frames of photographs, and the same frames without noise.

Samples pass through three steps that work at the same time: threads read and plan photographs, one
thread computes on the device, and threads encode. Their order is the order of their numbers.
"""

import json
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.pairs.pace import Pace
from gpusim.apps.pairs.shards import npy
from gpusim.apps.pairs.variety import Variety, scene_options
from gpusim.apps.video.pipeline import ahead
from gpusim.captures.capture import Capture, Light
from gpusim.color.speed import gains_of
from gpusim.domain.account import Account
from gpusim.domain.cores import count_cores
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Sensor
from gpusim.io.frame.frames import named_labels
from gpusim.io.frame.images import png_bytes
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.loop import Loop, read_facts
from gpusim.pipeline.reading import is_read_on_device
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.facts import Facts
from gpusim.planner.plan import Plan

HELD = 2**29  # bytes of scenes that are read ahead, and of samples that wait for their encoding
SHOTS = 2  # computed samples that wait between two threads
LISTED = 4096  # samples of scenes that are read ahead
UNIT = 100.0  # [cd m-2] of scenes whose light is scaled to a drawn luminance


@dataclass(frozen=True, eq=False)
class _Read:
    """A photograph's scene in one light, and its facts; None: each plan reads its own."""

    scene: Scene
    facts: Facts | None


@dataclass(frozen=True)
class _Ready:
    """A scene that was read ahead, and its plan. None: the loop makes one, or has a given one."""

    scene: Scene
    plan: Plan | None


@dataclass(frozen=True, eq=False)
class _Shot:
    """A computed sample that is not encoded yet.

    Attributes:
        number: Its number.
        values: Its drawn settings.
        exposure: Its exposure. Of its arrays only the shapes are used.
        account: Errors of the exposure at its exposure time.
        nbytes: Memory of its arrays [byte].
        mean, raw, codes: Functions that return arrays of the host; codes: None without pictures.
        pair: The complete sample of a capture, instead of the arrays.
    """

    number: int
    values: dict
    exposure: Exposure
    account: Account
    nbytes: int
    mean: Callable[[], np.ndarray] | None = None
    raw: Callable[[], np.ndarray] | None = None
    codes: Callable[[], np.ndarray] | None = None
    pair: dict = field(default_factory=dict)


class Pairs:
    """Noisy and clean frames of photographs.

    Each pair depends only on its photograph, its number and the seed, whichever others the run
    makes. A photograph is read and blurred once for neighbouring pairs that show the same light,
    whatever its luminance. With a tolerance, its plan is for the longest exposure and the highest
    luminance that may be drawn. Each pair has the errors of its own light.

    Args:
        simulator: Camera and device.
        photographs: Files of the photographs.
        opened: Function from a path and the drawn values to a scene. Threads call it.
        variety: Settings that are drawn for each pair.
        each: Pairs per photograph.
        seed: Seed of the noise and of the variety.
        pictures: Whether pairs have display codes.
        plan: Plan of all pairs, see `Simulator`. None: each pair has its own.
        capture: Capture of each pair. The frames of a capture that is not merged are on a first
            axis.
        relit: Function from a path, the scene `opened(path, {})` and drawn values of the light to
            the scene in this light. None: `opened` reads the file again for each light. A luminance
            only scales the light.

    Attributes:
        pace: Times of the steps of `files`.
        threads: Threads of `files` that read, and that encode. The device has one more.
    """

    def __init__(
        self,
        simulator: Simulator,
        photographs: list[Path],
        opened: Callable[[Path, dict], Scene],
        variety: Variety,
        each: int = 1,
        seed: int = 0,
        pictures: bool = False,
        plan: Plan | None = None,
        capture: Capture | None = None,
        relit: Callable[[Path, Scene, dict], Scene] | None = None,
    ):
        if capture is not None:
            capture.check_size("pairs")
        self._capture = capture
        self._simulator, self._photographs, self._opened = simulator, photographs, opened
        self._variety, self._each, self._seed = variety, each, seed
        self._pictures, self._plan, self._relit = pictures, plan, relit
        self._loop: Loop | None = None
        self._ready: _Ready | None = None  # the loop's
        self._last: tuple | None = None  # key and result of the last `pair` that was read
        self.pace, self.threads = Pace(), count_cores()

    def __len__(self):
        return self._each * len(self._photographs)

    def open(self, number: int) -> Scene:
        """Return the scene of a pair."""
        values = self._variety.draw(self._seed, number)
        scene = self._read(self._key(number, values))
        return self._lit(number, scene, scene_options(values))

    def files(self, numbers: Iterable[int]) -> Generator[tuple[str, dict[str, bytes]], None, None]:
        """Yield key and files by suffix of each pair; see `gpusim pairs --help`.

        Raises as `Simulator.frames` does, after all pairs before the wrong one.
        """
        workers = self.threads
        waiting: deque[tuple[int, int, Future]] = deque()
        held, failure = 0, None
        readers, encoders = (ThreadPoolExecutor(workers) for _ in range(2))

        def take():
            nonlocal held
            number, nbytes, files = waiting.popleft()
            with self.pace.during("encoding"):
                found = files.result()
            held -= nbytes
            return f"{number:08d}", found

        try:
            with closing(ahead(self._shots(numbers, readers, workers), SHOTS)) as shots:
                try:
                    for shot in shots:
                        files = encoders.submit(self._encode, shot)
                        waiting.append((shot.number, shot.nbytes, files))
                        held += shot.nbytes
                        while waiting and (
                            len(waiting) > 2 * workers or held > HELD or waiting[0][-1].done()
                        ):
                            found = take()
                            with self.pace.during("writing"):
                                yield found
                except Exception as error:  # after the pairs before it
                    failure = error
                while waiting:
                    yield take()
                if failure is not None:
                    raise failure
        finally:
            for pool in (readers, encoders):
                pool.shutdown(cancel_futures=True)

    def pair(self, number: int) -> dict:
        """Return raw values, clean values, codes (with pictures), a record of the settings, and labels."""
        values = self._variety.draw(self._seed, number)
        key = self._key(number, values)
        if self._last is None or self._last[0] != key:
            self._last = None
            lit = self._light(key, self._read(key))
            self._last = key, self._prepare(key, lit)
        return self._finish(self._compute(number, values, self._last[1]))

    @cached_property
    def _gain_of(self) -> Callable[[float], float]:
        """The function from an ISO speed to the sensor's analog gain."""
        return gains_of(self._simulator.camera.sensor)

    @property
    def _is_scaled(self) -> bool:
        """True if a scene is read at UNIT, and its light scaled to the drawn luminance."""
        return self._relit is not None and self._plan is None and self._capture is None

    def _key(self, number, values) -> tuple:
        """Return the number of a pair's photograph, its light, and what else its plan depends on."""
        light, more = scene_options(values), tuple[Any, ...]()
        if self._simulator.tolerance is not None:
            most = self._variety.most
            more = most.get("exposure"), self._brightness(most)
        if self._is_scaled and "luminance" in light:
            light["luminance"] = UNIT
        return number // self._each, tuple(light.items()), more

    def _brightness(self, values) -> float:
        """Return the factor on the light of a pair's scene."""
        return values.get("luminance", UNIT) / UNIT if self._is_scaled else 1.0

    def _read(self, key) -> Scene:
        """Return the scene of a photograph, before `_relit` changes its light."""
        photograph, light, _ = key
        return self._opened(
            self._photographs[photograph], {} if self._relit is not None else dict(light)
        )

    def _lit(self, number, scene: Scene, light: dict) -> Scene:
        """Return the scene of a pair that was read in its light."""
        if self._relit is None or not light:
            return scene
        return self._relit(self._photographs[number // self._each], scene, light)

    def _light(self, key, scene: Scene) -> _Read:
        """Return a scene that was read in its light, and its facts if they are read here."""
        photograph, light, _ = key
        scene, device = (
            self._lit(photograph * self._each, scene, dict(light)),
            self._simulator.device,
        )
        is_planned = self._plan is None and self._capture is None
        if not is_planned or is_read_on_device(device, scene):
            return _Read(scene, None)
        return _Read(scene, read_facts(scene, device))

    def _prepare(self, key, lit: _Read) -> _Ready:
        """Return a scene in its light, and its plan if the loop needs none of its own."""
        if lit.facts is None:
            return _Ready(lit.scene, None)
        seconds, brightness = key[-1] or (None, 1.0)
        plan = self._simulator.plan(lit.scene, lit.facts, seconds, brightness=brightness)
        plan.name  # noqa: B018  computed here, next to the device's work
        return _Ready(lit.scene, plan)

    def _read_ahead(self, numbers, pool, workers) -> Iterator[tuple[int, dict, Future]]:
        """Yield number, drawn values and the future scene of each pair, read by a pool ahead of their use."""
        listed: deque[tuple[int, dict, Future]] = deque()
        begun: deque[Future] = deque()  # different scenes of `listed`
        files: dict[tuple, Future] = {}  # the last file
        lights: dict[tuple, Future] = {}  # and what it shows in each light
        key, most = None, 2

        def light(key, file):
            return self._light(key, file.result())

        def prepare(key, lit):
            return self._prepare(key, lit.result())

        for number in numbers:
            values = self._variety.draw(self._seed, number)
            own = self._key(number, values)
            while len(listed) >= LISTED or (own != key and len(begun) >= most):
                yield (taken := listed.popleft())
                nbytes = taken[-1].result().scene.content.nbytes
                most = min(max(HELD // nbytes, 2), workers + 2)
                if not listed or listed[0][-1] is not taken[-1]:
                    begun.popleft()
            if own != key or not begun:
                key, file = own, own[:1] if self._relit is not None else own[:2]
                if file not in files:
                    files, lights = {file: pool.submit(self._read, key)}, {}
                if key[:2] not in lights:
                    lights[key[:2]] = pool.submit(light, key, files[file])
                begun.append(pool.submit(prepare, key, lights[key[:2]]))
            listed.append((number, values, begun[-1]))
        yield from listed

    def _shots(self, numbers, pool, workers) -> Iterator[_Shot]:
        """Yield the computed pairs."""
        for number, values, future in self._read_ahead(numbers, pool, workers):
            with self.pace.during("reading"):
                ready = future.result()
            with self.pace.during("computing"):
                shot = self._compute(number, values, ready)
            with self.pace.during("waiting"):
                yield shot

    def _compute(self, number, values, ready: _Ready) -> _Shot:
        """Return a pair whose arrays are computed, or on their way from the device."""
        simulator = self._simulator
        gain = 1.0
        if "iso" in values:  # in addition to the sensor's own
            gain = self._gain_of(values["iso"]) / simulator.camera.sensor.analog_gain
        if self._capture is not None:
            return self._capture_pair(number, values, ready.scene, gain, self._capture)
        loop, self._loop = self._loop_of(ready, values, gain), None
        exposure = loop.expose()
        if ready.plan is not None:
            account = ready.plan.account.at(exposure.exposure_time * exposure.brightness)
        else:
            account = loop.account
        raw = self._fetch(loop.raw(seed=self._seed, first=number))
        if simulator.camera.sensor.binning == (1, 1):
            mean = self._fetch(loop.values["mean"])
        else:
            binned = loop.values["mean of pixels"]

            def mean():
                return binned

        codes = None
        if self._pictures:
            codes = self._fetch(loop.codes(seed=self._seed, first=number))
        self._loop, self._ready = loop, ready  # unless there was an error
        nbytes = (12 if codes is None else 18) * int(np.prod(exposure.mean.shape))
        return _Shot(number, values, exposure, account, nbytes, mean, raw, codes)

    def _loop_of(self, ready, values, gain) -> Loop:
        """Return the loop, of this scene and exposure. Only a scene with a plan follows another one."""
        loop, simulator, seconds = self._loop, self._simulator, values.get("exposure")
        is_same = ready is self._ready and simulator.tolerance is None
        if loop is None or (ready.plan is None and self._plan is None and not is_same):
            loop = simulator.loop(ready.scene, seconds, gain, plan=self._plan)
        else:
            loop.update(scene=ready.scene, exposure_time=seconds, gain=gain)
        loop.update(brightness=self._brightness(values))
        if ready.plan is not None:
            loop.before.plan = ready.plan, simulator.camera
            loop.before.probing.set_plan(ready.plan)
        return loop

    def _fetch(self, array) -> Callable[[], np.ndarray]:
        """Return a function that waits for the values of a device array that will be written to again."""
        device = self._simulator.device
        if not device.on_host and device.kind != "numpy":
            return device.fetch(array)
        copied = np.array(device.numpy(array))
        return lambda: copied

    def _encode(self, shot: _Shot) -> dict[str, bytes]:
        """Return the files of a pair by suffix."""
        pair = self._finish(shot)
        files = {"raw.npy": npy(pair["raw"]), "clean.npy": npy(pair["clean"])}
        if "rgb" in pair:
            shown = pair["rgb"]
            if shown.ndim == 4:  # the frames of a capture, one below the other
                shown = shown.reshape(-1, *shown.shape[2:])
            files["rgb.png"] = png_bytes(shown, self._simulator.camera.display)
        files |= {f"{name}.npy": npy(label) for name, label in named_labels(pair["labels"]).items()}
        return files | {"json": (json.dumps(pair["record"], sort_keys=True) + "\n").encode()}

    def _finish(self, shot: _Shot) -> dict:
        """Return the arrays and the record of a pair."""
        if shot.pair:
            return shot.pair
        exposure, sensor = shot.exposure, shot.exposure.camera.sensor
        assert shot.raw is not None and shot.mean is not None  # a single frame
        clean = np.asarray(shot.mean(), np.float32) * np.float32(sensor.gain_dn_per_electron)
        clean += np.float32(sensor.dark_level)
        pair = {"raw": exposure.split_layers(shot.raw()), "clean": clean}
        if shot.codes is not None:
            pair["rgb"] = shot.codes()
        record = self._record(shot.number, shot.values, exposure, sensor, shot.account)
        return pair | {"record": record, "labels": exposure.labels}

    def _capture_pair(self, number, values, scene, gain, capture: Capture) -> _Shot:
        """Return the pair of a capture."""
        simulator = self._simulator
        first = number * capture.count
        seconds = values.get("exposure")
        light = Light(capture, simulator, scene, first, seconds, gain, self._plan)
        shots = capture.shots(light, self._seed, first)
        frames = capture.frames(simulator, shots)
        cleans = []
        for frame, shot in zip(frames, shots, strict=False):
            sensor, own = frame.camera.sensor, shot.exposure
            mean = own.values()["mean of pixels"] * np.float32(
                frame.exposure_time / own.exposure_time if capture.merged else 1.0
            )
            scale = np.float32(sensor.gain_dn_per_electron)
            cleans.append(mean * scale + np.float32(sensor.dark_level))
        parts = {"raw": [frame.raw for frame in frames], "clean": cleans}
        if self._pictures:
            parts["rgb"] = [frame.rgb for frame in frames]
        is_one = capture.merged or not capture.has_frames
        pair: dict[str, Any] = {
            name: part[0] if is_one else np.stack(part) for name, part in parts.items()
        }
        nbytes = 2 * sum(part.nbytes for part in pair.values())
        plan, exposure = shots[0].exposure.plan, shots[0].exposure
        account = plan.account.at(exposure.exposure_time)
        record = self._record(number, values, exposure, frames[0].camera.sensor, account)
        times = [frame.exposure_time for frame in frames]
        pair |= {
            "labels": exposure.labels,
            "record": record
            | {
                "frame": first,
                "exposure_time_s": times[0] if is_one else times,
                "capture": str(capture),
            },
        }
        return _Shot(number, values, exposure, account, nbytes, pair=pair)

    def _record(self, number, values, exposure, sensor: Sensor, account: Account) -> dict:
        """Return the settings of a pair."""
        simulator = self._simulator
        record = {
            "photograph": self._photographs[number // self._each].name,
            "camera": simulator.camera.name,
            "seed": self._seed,
            "frame": number,
            **values,
            "exposure_time_s": exposure.exposure_time,
            "gain": exposure.gain,
            "black_level": float(sensor.dark_level),
            "white_level": float(sensor.white_level),
            "gain_dn_per_e": float(sensor.gain_dn_per_electron),
            "read_noise_e": float(sensor.read_sigma),
            "cfa": list(sensor.cfa),
            "plan": exposure.plan.name,
            "predicted_rms": account.total.rms,
        }
        if simulator.tolerance is not None:
            record["verdict"] = account.verdict(simulator.tolerance).as_dict()
        return record
