"""Frames of a video, computed while the next scenes are read and the last frames are written."""

import glob
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.video.codecs import PART, Encoder
from gpusim.apps.video.loops import NO_LOOPS, Loops
from gpusim.apps.video.manifest import PARTS
from gpusim.apps.video.pipeline import Clock, ahead, in_groups, in_pool
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.scenes import Moving, Scenes
from gpusim.apps.video.segments import numbered_path
from gpusim.captures.capture import Capture, Light
from gpusim.domain.account import Account
from gpusim.domain.animation import Animation
from gpusim.domain.camera import Camera
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import BadFile, Conflict, OutOfRange
from gpusim.io.frame.frames import LOSSY, RAW_ARRAY, suffix_of
from gpusim.kernels.common.channels import put_channels_last
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.frame import Frame, Parts
from gpusim.pipeline.simulator import Simulator

NO_RAMPS, ONE_FRAME = Ramps(), Capture()
READ, COMPUTED = 2, 3  # scenes and frames that are computed ahead
HELD = 2**30  # [byte] of frames that wait for their encoders, at most
THREADS = 4  # of an encoder; as many cores work for each segment that is encoded at the same time
# the part of a frame that a file of this suffix holds, if it is one of OUTPUT_OF
PART_OF = dict.fromkeys((".png", *LOSSY), "rgb") | dict.fromkeys(
    (".tif", ".tiff", ".exr", ".npy"), "linear"
)
OUTPUT_OF = {"rgb": "codes", "linear": "linear", "raw": "raw"}
PARTS_OF = {".dng": ("raw", "rendering"), ".npz": ("mean", "raw"), RAW_ARRAY: ("raw",)}


@dataclass(frozen=True)
class Made:
    """A frame of a video.

    Attributes:
        number: Number of the frame.
        values: A Frame; for a codec an array, or a function that waits for it.
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
    parts: tuple[str, ...] = (),
    late: bool = False,
    clock: Clock | None = None,
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
        parts: Parts that a Frame has. (): all.
        late: Give functions that return an output, in any thread: nothing waits for the copy here.
        clock: Clock for the part "scenes", the time that frames wait for their scenes.
    """
    loop: Any = None
    last = max(scenes.count - 1, 1)
    wanted_of = {"seed": seed, "output": output, "parts": parts, "late": late}
    clock = clock or Clock()
    meters = simulator.camera.sensor.exposure_time is None and loops.seconds is None

    def operated(shown, number):
        """Return the scene of a frame, its camera, and arguments of `Loop.update`."""
        scene = ramps.scene(shown, number / last)
        camera = loops.camera(ramps.camera(simulator.camera, number / last), number)
        return scene, camera, loops.operation(camera, number)

    # views of one scene: every segment begins with the plan of the first frame
    planned: tuple | None = None  # the plan and its camera
    if isinstance(scenes, Moving) and scenes.is_one_scene and not ramps.ranges:
        begin, camera, operation = operated(next(scenes.between(0, 1)), 0)
        loop = simulator.update(camera).loop(begin, meters_late=meters, **operation)
        planned = loop.plan, camera
    for first, *wanted in segments:
        if scenes.is_still and not ramps.ranges and loops == NO_LOOPS:
            loop = loop or simulator.loop(next(scenes.between(0, 1)))
            yield from (_make_frame(loop, number, **wanted_of) for number in wanted)
            continue
        lead = first - (meters and first > 0)
        coming = clock.each("scenes", ahead(scenes.between(lead, wanted[-1] + 1), READ))
        with closing(coming) as arriving:
            for number, shown in enumerate(arriving, lead):
                scene, camera, operation = operated(shown, number)
                if number == lead and planned:
                    loop.restart(*planned)
                    scene = scene if number else begin
                if loop is None or (number == lead and not planned):
                    loop = simulator.update(camera).loop(scene, meters_late=meters, **operation)
                else:
                    if camera is not loop.simulator.camera:
                        operation["camera"] = camera
                    loop.update(scene=scene, **operation)
                if number == lead and planned:
                    loop.settle()
                # even an unwanted one: the next frame meters it
                made = _make_frame(loop, number, **wanted_of)
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
    parts: tuple[str, ...] = (),
    late: bool = False,
    clock: Clock | None = None,
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
        parts: Not used: a Frame has all parts.
        late: As for `frames`.
        clock: As for `frames`.

    Raises:
        Conflict: The capture has several frames that are not merged.
    """
    if capture.has_frames:
        reason = "a video shows one frame of each scene"
        raise Conflict("capture", reason, "merge its frames")
    last, still, clock = max(scenes.count - 1, 1), simulator, clock or Clock()
    moving = scenes if blur and isinstance(scenes, Moving) else None
    if moving is not None:
        capture = replace(
            capture, motion=moving.motion, flicker=moving.flicker, period=moving.period
        )
    source: Scenes = scenes if moving is None else moving.still
    for _, *wanted in segments:
        for number in wanted:
            with clock.of("scenes"):
                shown = next(source.between(number, number + 1))
            scene: Any = ramps.scene(shown, number / last)
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
                values = take_output(values.complete(), output, late)
            else:
                values = _fetch(simulator, shots[0].output(output), output)()
                values = partial(_same, values) if late else values
            account = exposure.plan.account.at(exposure.exposure_time)
            yield Made.of(number, values, account, exposure)


def take_output(frame: Frame, output: str | None, late: bool) -> Any:
    """Return an output of a frame, or the frame if it is None. late: as a function that returns it."""
    if output is None:
        return frame
    values = {"raw": frame.raw, "codes": frame.rgb}.get(output, frame.linear)
    return partial(_same, values) if late else values


def _same(values):
    return values


def _make_frame(loop, number, *, seed, output, parts, late):
    """Return a frame of a loop."""
    account, exposure = loop.account, loop.expose()
    values: Any
    if output is not None:
        values = _fetch(loop.simulator, loop.output(output, seed=seed, first=number), output)
        values = values if late else values()
    elif len(parts) == 1 and parts[0] in OUTPUT_OF:
        loop.settle()  # as `Loop.frame` does
        exposure, output = loop.expose(), OUTPUT_OF[parts[0]]
        device, found = loop.simulator.device, loop.output(output, seed=seed, first=number)
        if output == "linear":  # as files have it
            found = _fetch_own(device, put_channels_last(device, found))
        else:
            found = _fetch(loop.simulator, found, output)
        if output == "raw":
            found = partial(_split_layers, exposure, found)
        values = _picture(exposure, parts[0], found)
    else:
        values = loop.frame(seed=seed, first=number)
        for part in parts:
            getattr(values, part)
        values = values if parts else values.complete()
    return Made.of(number, values, account, exposure)


def _split_layers(exposure, found):
    """Return the raw values of a function with the layers of stacked pixels on an axis."""
    return exposure.split_layers(found())


class _Fetched(Parts):
    """A part of a frame that a function returns."""

    def __init__(self, found: Callable):
        self._found = found

    def compute(self, name, frame):
        """See `Parts`."""
        return self._found()


def _picture(exposure, part, found) -> Frame:
    """Return a frame that has only one part. found: function that returns it."""
    others: dict[str, Any] = dict.fromkeys(("rendering", "mean", "raw", "linear", "rgb", "report"))
    others[part] = _Fetched(found)
    return Frame(exposure.camera, exposure.exposure_time, labels={}, **others)


def _fetch(simulator: Simulator, values, output) -> Callable[[], np.ndarray]:
    """Begin to copy an output to the host; call the result for it. Linear light has its channels last."""
    device = simulator.device
    if _is_shared(device):  # the next frame is written to the same memory
        values = np.array(device.numpy(values))
    found = _fetch_own(device, values)
    return (lambda: np.moveaxis(found(), 0, -1)) if output == "linear" else found


def _fetch_own(device, values) -> Callable[[], np.ndarray]:
    """Begin to copy values to the host that no later frame writes to; call the result for them."""
    return partial(_same, device.numpy(values)) if _is_shared(device) else device.fetch(values)


def _is_shared(device):
    """Return whether arrays of the device are in the host's memory."""
    return device.on_host or device.kind == "numpy"


def _arrived(one: Made) -> Made:
    """Return a frame with its values, which are waited for."""
    return replace(one, values=one.values())


class NumberedFiles:
    """A file for every frame: `a.png` gives a_0000.png, ...

    Args:
        path: Path of the output; its suffix sets the format.
        count: Number of frames.
        quality: Quality of files with loss. None: the default.
    """

    folders = ()

    def __init__(self, path: Path, count: int, quality: int | None = None):
        self._path, self._count, self._quality = path, count, quality

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

    def write(self, make: Callable, segments: list[range], clock: Clock) -> Iterator[Made]:
        """Write the missing frames of the segments; yield each written one, without its values.

        Args:
            make: `frames` or `captured_frames` of a simulator and its scenes.
            segments: Segments to write.
            clock: Clock for the parts "frames", the time that files wait for them, and "scenes".

        Raises:
            GpusimError: As `Frame.save` does.
        """
        missing = [
            [segment.start, *(number for number in segment if not self.name(number).exists())]
            for segment in segments
        ]
        missing = [segment for segment in missing if len(segment) > 1]
        suffix = suffix_of(self._path).lower()
        parts = (PART_OF[suffix],) if suffix in PART_OF else PARTS_OF.get(suffix, ())
        made = ahead(make(missing, parts=parts, clock=clock), COMPUTED)
        with closing(clock.each("frames", made)) as computed:
            written = in_pool(computed, self._save, count_cores())
            with closing(written):
                for one in written:
                    yield replace(one, values=None)

    def _save(self, one: Made) -> None:
        one.values.save(self.name(one.number), quality=self._quality)


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

    def write(self, make: Callable, segments: list[range], clock: Clock) -> Iterator[Made]:
        """Encode the missing segments, several at a time; yield each encoded frame. Raises BadFile.

        make, segments, clock: as for `NumberedFiles.write`.
        """
        missing = [segment for segment in segments if not self.part(segment).exists()]
        with closing(self._compute(make, missing, clock)) as computed:
            encoded = in_groups(
                computed,
                [len(segment) for segment in missing],
                lambda number, arriving: self._encode(missing[number], map(_arrived, arriving)),
                workers=max(count_cores() // THREADS, 2),
                held=max(HELD // self._encoder.frame_bytes, 2 * COMPUTED),
            )
            with closing(encoded):
                yield from encoded

    def _compute(self, make, missing, clock):
        """Yield the frames of the missing segments."""
        made = make(
            [[part.start, *part] for part in missing],
            output=self._encoder.codec.output,
            late=True,
            clock=clock,
        )
        return clock.each("frames", ahead(made, COMPUTED))

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


class RawFile(EncodedFile):
    """A video whose frames all take the same number of bytes: .y4m.

    Threads write them to their places in one file, in the folder of the incomplete work. An empty
    file marks a complete segment.
    """

    @property
    def _frames(self):
        return self.folder / f"frames{self.path.suffix}"

    def write(self, make: Callable, segments: list[range], clock: Clock) -> Iterator[Made]:
        """See `EncodedFile.write`."""
        missing = [segment for segment in segments if not self.part(segment).exists()]
        ends = {number: segment for segment in missing for number in segment}
        left = Counter({segment.start: len(segment) for segment in missing})
        with self._writing(segments) as file, closing(self._compute(make, missing, clock)) as made:

            def write(one):
                self._encoder.write_raw(file, one.number, one.values())

            with closing(in_pool(made, write, count_cores())) as written:
                for one in written:
                    segment = ends[one.number]
                    left[segment.start] -= 1
                    if not left[segment.start]:
                        self.part(segment).touch()
                    yield replace(one, values=None)

    @contextmanager
    def _writing(self, segments):
        """Yield the number of the open file; errors become BadFile.

        If no segment becomes complete, the file is removed, unless other shards may use it.
        """
        file = None
        try:
            file = os.open(self._frames, os.O_RDWR | os.O_CREAT, 0o666)
            yield file
        except OSError as error:
            raise BadFile(self.path, f"cannot be written: {error.strerror or error}") from error
        finally:
            if file is not None:
                os.close(file)
            if self.is_empty() and segments == self._segments:
                with suppress(OSError):
                    self._frames.unlink(missing_ok=True)

    def finish(self) -> bool:
        """Give the file its name if all segments exist. Return whether they do. Raises BadFile."""
        if not self._is_complete():
            return False
        with self._writing(()) as file:
            os.truncate(file, self._encoder.raw_place(self._segments[-1][-1] + 1))
            os.replace(self._frames, self.path)
        self._remove_segments()
        return True
