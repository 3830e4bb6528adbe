"""Frames of a video, computed while the next scenes are read and the last frames are written."""

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.video.codecs import PART, Encoder
from gpusim.apps.video.loops import NO_LOOPS, Loops
from gpusim.apps.video.manifest import PARTS
from gpusim.apps.video.pipeline import ahead
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.scenes import Moving, Scenes
from gpusim.apps.video.segments import numbered_path
from gpusim.captures.capture import Capture, Light
from gpusim.domain.account import Account
from gpusim.domain.animation import Animation
from gpusim.domain.camera import Camera
from gpusim.domain.errors import Conflict, OutOfRange
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.simulator import Simulator

NO_RAMPS, ONE_FRAME = Ramps(), Capture()
READ, COMPUTED = 2, 3  # scenes and frames that are computed ahead


@dataclass(frozen=True)
class Made:
    """A frame of a video.

    Attributes:
        number: Number of the frame.
        values: A Frame, or an array for a codec.
        account: Predicted errors.
        exposure_time: Exposure time [s].
        gain: Analog gain in addition to the sensor's.
        plan: Name of the plan.
    """

    number: int
    values: Any
    account: Account
    exposure_time: float
    gain: float
    plan: str = ""

    @classmethod
    def of(cls, number: int, values: Any, account: Account, exposure: Exposure) -> "Made":
        """Return the frame of an exposure."""
        return cls(
            number, values, account, exposure.exposure_time, exposure.gain, exposure.plan.name
        )


def within_period(camera: Camera, rate: Fraction) -> Camera:
    """Return the camera with automatic exposure limited to the period of a frame.

    Args:
        camera: Camera of the video.
        rate: Frames per second.

    Raises:
        OutOfRange: If the camera has a longer fixed exposure time.
    """
    sensor, longest = camera.sensor, float(1 / rate)
    if sensor.exposure_time is None:
        automatic = sensor.auto_exposure
        if automatic.longest is None or automatic.longest > longest:
            sensor = replace(sensor, auto_exposure=replace(automatic, longest=longest))
    elif sensor.exposure_time > longest:
        allowed = f"up to the frame's period, {longest:.4g} s at {float(rate):g} frames per second"
        raise OutOfRange("exposure time of a video", f"{sensor.exposure_time:.4g} s", allowed)
    return replace(camera, sensor=sensor)


def frames(
    simulator: Simulator,
    scenes: Scenes,
    segments: Iterable[list[int]],
    *,
    seed: int = 0,
    output: str | None = None,
    ramps: Ramps = NO_RAMPS,
    loops: Loops = NO_LOOPS,
) -> Iterator[Made]:
    """Yield the wanted frames of each segment, in order.

    A camera that meters exposes each frame for the light of the previous one, and the first for its
    own.

    Args:
        simulator: Camera and device.
        scenes: Scenes of all frames.
        segments: For each segment its first frame, then the wanted ones.
        seed: Seed of the noise.
        output: Output of `Simulator.stream`. None: a Frame.
        ramps: Settings that change over all frames.
        loops: Settings of the camera's control loops for all frames.
    """
    loop, last = None, max(scenes.count - 1, 1)
    meters = simulator.camera.sensor.exposure_time is None and loops.seconds is None
    for first, *wanted in segments:
        if scenes.is_still and not ramps.ranges and loops == NO_LOOPS:
            loop = loop or simulator.loop(next(scenes.between(0, 1)))
            yield from (_make_frame(loop, number, seed, output) for number in wanted)
            continue
        lead = first - (meters and first > 0)
        with closing(ahead(scenes.between(lead, wanted[-1] + 1), READ)) as arriving:
            for number, shown in enumerate(arriving, lead):
                scene = ramps.scene(shown, number / last)
                camera = loops.camera(ramps.camera(simulator.camera, number / last), number)
                operation = loops.operation(camera, number)
                if number == lead or loop is None:
                    own = simulator.update(camera)
                    loop = own.loop(scene, meters_late=meters, **operation)
                else:
                    if camera is not loop.simulator.camera:
                        operation["camera"] = camera
                    loop.update(scene=scene, **operation)
                # even an unwanted one: the next frame meters it
                made = _make_frame(loop, number, seed, output)
                if number in wanted:
                    yield made
        if loop is not None:
            loop.judge()


def captured_frames(
    simulator: Simulator,
    scenes: Scenes,
    segments: Iterable[list[int]],
    *,
    seed: int = 0,
    output: str | None = None,
    ramps: Ramps = NO_RAMPS,
    loops: Loops = NO_LOOPS,
    capture: Capture = ONE_FRAME,
    blur: bool = True,
) -> Iterator[Made]:
    """Yield frames with motion blur, rolling shutter and flicker, or merged captures; see `frames`.

    Each frame meters its first view.

    Args:
        simulator: Camera and device.
        scenes: Scenes of all frames.
        segments: As for `frames`.
        seed: Seed of the noise.
        output: As for `frames`.
        ramps: As for `frames`.
        loops: As for `frames`.
        capture: Capture of each frame. Movement and flicker are the scenes'.
        blur: Whether scenes move during a capture; False shows each as it is at its start.

    Raises:
        Conflict: The capture has several frames that are not merged.
    """
    if capture.has_frames:
        reason = "a video shows one frame of each scene"
        raise Conflict("capture", reason, "merge its frames")
    last, still = max(scenes.count - 1, 1), simulator
    moving = scenes if blur and isinstance(scenes, Moving) else None
    if moving is not None:
        capture = replace(
            capture, motion=moving.motion, flicker=moving.flicker, period=moving.period
        )
    source: Scenes = scenes if moving is None else moving.still
    for _, *wanted in segments:
        for number in wanted:
            scene: Any = ramps.scene(next(source.between(number, number + 1)), number / last)
            if moving is not None and moving.actors:
                scene = Animation(scene, moving.actors)
            camera = loops.camera(ramps.camera(still.camera, number / last), number)
            simulator = still if camera is still.camera else still.update(camera)
            first, operation = number * capture.count, loops.operation(camera, number)
            light = Light(capture, simulator, scene, first, **operation)
            shots = capture.shots(light, seed, first)
            exposure = shots[0].exposure
            values: Any
            if output is None or capture.merged:
                (values,) = capture.frames(simulator, shots)
                values = values.complete()
                if output is not None:
                    values = {"raw": values.raw, "codes": values.rgb}.get(output, values.linear)
            else:
                values = _on_host(simulator, shots[0].output(output), output)
            account = exposure.plan.account.at(exposure.exposure_time)
            yield Made.of(number, values, account, exposure)


def _make_frame(loop, number, seed, output):
    """Return a frame of a loop."""
    account, exposure = loop.account, loop.expose()
    if output is None:
        values = loop.frame(seed=seed, first=number).complete()
    else:
        values = loop.output(output, seed=seed, first=number)
        values = _on_host(loop.simulator, values, output)
    return Made.of(number, values, account, exposure)


def _on_host(simulator: Simulator, values, output):
    """Return a host copy of an output, with the channels of linear light last."""
    copied = np.array(simulator.device.numpy(values))
    return np.moveaxis(copied, 0, -1) if output == "linear" else copied


class NumberedFiles:
    """A file for every frame: `a.png` gives a_0000.png, ...

    Args:
        path: Path of the output; its suffix sets the format.
        count: Number of frames.
    """

    folders = ()

    def __init__(self, path: Path, count: int):
        self._path, self._count = path, count

    @property
    def words(self) -> str:
        """The output in words, for messages."""
        return f"the files {self.name(0).name} ..."

    def is_empty(self) -> bool:
        """Return whether nothing was written yet."""
        pattern = f"{glob.escape(self._path.stem)}_*{self._path.suffix}"
        return not any(self._path.parent.glob(pattern))

    def name(self, number: int) -> Path:
        """Return the path of a frame."""
        return numbered_path(self._path, number, self._count)

    def write(self, make: Callable, segments: list[range]) -> Iterator[Made]:
        """Write the missing frames of the segments; yield each written one.

        Args:
            make: `frames` or `captured_frames` of a simulator and its scenes.
            segments: Segments to write.

        Raises:
            GpusimError: As `Frame.save` does.
        """
        missing = [
            [segment.start, *(number for number in segment if not self.name(number).exists())]
            for segment in segments
        ]
        missing = [segment for segment in missing if len(segment) > 1]
        workers = os.cpu_count() or 1
        made = ahead(make(missing), COMPUTED)
        with ThreadPoolExecutor(workers) as pool, closing(made) as computed:
            writing: dict = {}
            for one in computed:
                writing[pool.submit(one.values.save, self.name(one.number))] = one
                while len(writing) > workers:
                    done = wait(writing, return_when=FIRST_COMPLETED).done
                    yield from _finish_tasks(writing, done)
            yield from _finish_tasks(writing, wait(writing).done)


def _finish_tasks(writing, done):
    """Yield the frames of finished tasks, in order."""
    for task in sorted(done, key=lambda task: writing[task].number):
        one = writing.pop(task)
        task.result()  # raises the error of the task
        yield one


class EncodedFile:
    """A video file. Until it is complete, a folder next to it holds a file for each segment.

    Args:
        path: Path of the video.
        encoder: Encoder of the segments.
        segments: All segments.
    """

    def __init__(self, path: Path, encoder: Encoder, segments: list[range]):
        self.path, self._encoder, self._segments = path, encoder, segments
        self.folder = path.with_name(path.name + PARTS)

    @property
    def words(self) -> str:
        """The output in words, for messages."""
        return f"the folder {self.folder}"

    @property
    def result(self) -> str:
        """The finished output, for messages."""
        return str(self.path)

    def is_empty(self) -> bool:
        """Return whether nothing was written yet."""
        return not any(self.folder.glob(f"*{PART}"))

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders that the output needs, in the order of their creation."""
        return (self.folder,)

    def part(self, segment: range) -> Path:
        """Return the file of a segment."""
        return self.folder / f"{segment.start:08d}{PART}"

    def write(self, make: Callable, segments: list[range]) -> Iterator[Made]:
        """Encode the missing segments; yield each encoded frame. Raises BadFile.

        make, segments: as for `NumberedFiles.write`.
        """
        missing = [segment for segment in segments if not self.part(segment).exists()]
        parts = [[part.start, *part] for part in missing]
        made = make(parts, output=self._encoder.codec.output)
        with closing(ahead(made, COMPUTED)) as computed:
            for segment in missing:
                yield from self._encode(segment, computed)

    def _encode(self, segment, computed):
        """Encode a segment; yield each of its frames."""
        taken: list[Made] = []

        def values():
            for one in islice(computed, len(segment)):
                taken.append(replace(one, values=None))
                yield one.values

        for number in self._encoder.segment(self.part(segment), values()):
            yield taken[number]

    def finish(self) -> bool:
        """Join the segments and remove them, if all exist. Return whether they did."""
        if not self._is_complete():
            return False
        self._join(self.path)
        self._remove_segments()
        return True

    def _is_complete(self):
        """Return whether all segments exist."""
        return all(self.part(segment).exists() for segment in self._segments)

    def _join(self, path):
        """Join the segments to a file."""
        self._encoder.join(path, [(part.start, self.part(part)) for part in self._segments])

    def _remove_segments(self):
        """Remove the files of the segments and their folder."""
        for path in self.folder.iterdir():
            path.unlink()
        self.folder.rmdir()
