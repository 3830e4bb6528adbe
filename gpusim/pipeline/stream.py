"""Frames of a sequence of scenes. The next scene is uploaded while this one is computed."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, GpusimError, checked_count
from gpusim.domain.memory import CPU, Pinned, dlpack_kind, is_array, to_host
from gpusim.domain.scene import Scene, checked_scene
from gpusim.pipeline.loop import Loop, SharedOptics, checked_capture, checked_output
from gpusim.planner.plan import Plan

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

SLOTS = 2  # one is read while the other is written
COPIERS = 4  # threads that copy to pinned memory
STAGED = (
    1 << 24
)  # [byte] that threads copy faster than a driver, which copies smaller arrays itself


class Stream(Iterator):
    """An iterator over one frame of each scene, see `Simulator.stream`.

    Several devices take the scenes in turn. One thread starts their work: launches do not wait for a device, and two
    threads would wait for Python's lock. A frame is launched while the devices before are still at work, see
    `Loop.begin`. It is handed out when the plan is known to fit its scene, and made again if the plan does not. So the
    bits are those of one device.

    Args:
        simulator: The Simulator.
        scenes: The scenes.
        output: A key of `gpusim.pipeline.loop.OUTPUTS`.
        seed: Seed of the noise.
        first: Number of the first frame.
        plan: Plan for all frames.
        settings: Further arguments of `Loop`.

    Attributes:
        plan: Plan of the last frame; before the first frame the given one, or None.

    Raises:
        BadData: No scenes.
        OutOfRange: The number of the first frame is not allowed.
        UnknownName: There is no such output.
    """

    def __init__(
        self,
        simulator: "Simulator",
        scenes: Iterable[Scene],
        output: str = "codes",
        *,
        seed: int = 0,
        first: int = 0,
        plan: Plan | None = None,
        **settings: Any,
    ):
        checked_output(output)
        checked_count("first", first, 0)
        if not isinstance(scenes, Iterable) or isinstance(scenes, str | bytes) or is_array(scenes):
            raise BadData(
                f"scenes of a stream: {type(scenes).__name__}, wanted several, e.g. [scene]"
            )
        checked_capture(settings.get("capture"))
        self.plan, self._settings = plan, settings | {"plan": plan}
        self._frames = self._generate(simulator.on_devices(), scenes, output, seed, first)

    def __next__(self) -> Any:
        return next(self._frames)

    def close(self) -> None:
        """End the stream. Waits for uploads."""
        self._frames.close()

    def _generate(self, simulators, scenes, output, seed, number):
        capture, turn = self._settings.get("capture"), 0
        loops: list[Loop] = []  # one for each device
        begun: deque[Loop] = deque()  # those with the next scenes, in order
        last: Loop | None = None  # that with the statistics of the last frame
        end: Exception | None = None  # what ended the scenes
        devices = [simulator.device for simulator in simulators]
        uploaded = _upload_scenes(devices, map(checked_scene, scenes))
        try:
            while True:
                while end is None and len(begun) < len(devices):
                    try:
                        scene = next(uploaded)
                        if len(loops) < len(devices):
                            before = SharedOptics(devices[turn], loops[0].before) if loops else None
                            loop = Loop(simulators[turn], scene, before=before, **self._settings)
                            loops.append(loop)
                        else:
                            loop = loops[turn].update(scene=scene)
                    except Exception as error:  # raised after the frames before
                        end = error
                        break
                    begun.append(loop)
                    turn = (turn + 1) % len(devices)
                    if len(begun) > 1:
                        with suppress(GpusimError):  # raised again in its turn
                            loop.begin(seed=seed, first=number + len(begun) - 1)
                if not begun:
                    break
                last = loop = begun.popleft()
                frame = loop.output(output, seed=seed, first=number)
                number += capture.count if capture else 1
                self.plan = loop.plan_of_output
                if begun:
                    last = begun[0]
                    last.follow(loop)
                yield frame
            if last is not None:
                last.judge()
            if end is not None and not isinstance(end, StopIteration):
                raise end
        finally:
            uploaded.close()


def _upload_scenes(
    devices: Sequence[Device], scenes: Iterator[Scene]
) -> Generator[Scene, None, None]:
    """Yield the scenes, each with its samples on the next device, while as many later ones are uploaded.

    A scene's arrays may be rewritten when the scene `len(devices) + 1` later is requested. An error of the iterator is
    raised after the scenes before.
    """
    if devices[0].on_host or devices[0].kind == "numpy":
        yield from scenes
        return
    slots: list[list[dict]] = [[{} for _ in range(SLOTS)] for _ in devices]
    sent: deque[_Upload] = deque()
    earlier: _Upload | None = None
    end: Exception | None = None
    number = 0
    # each device has a thread that sends what must be copied first; all share threads that copy to pinned memory
    pools = [ThreadPoolExecutor(1) for _ in devices]
    copiers = ThreadPoolExecutor(COPIERS)
    try:
        while True:
            if earlier is not None:
                earlier.wait()
            while end is None and len(sent) <= len(devices):
                turn, place = number % len(devices), number // len(devices) % SLOTS
                try:
                    scene = next(scenes)
                    pair = pools[turn], copiers
                    sent.append(_Upload(devices[turn], scene, slots[turn][place], *pair))
                except Exception as error:
                    end = error
                number += 1
            if not sent:
                break
            earlier = sent.popleft()
            yield earlier.scene()
        if end is not None and not isinstance(end, StopIteration):
            raise end
    finally:
        for one in (earlier, *sent):
            if one is not None:
                with suppress(GpusimError):  # raised by `scene`
                    one.wait()
        for pool in (*pools, copiers):
            pool.shutdown()


class _Upload:
    """A scene on its way to a device.

    slot: memory that it overwrites, by name: device arrays, which nothing that is launched from now on reads, and
    pinned memory. pool: a thread that sends large samples that are not pinned. copiers: threads that copy to pinned
    memory.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        slot: dict,
        pool: ThreadPoolExecutor,
        copiers: ThreadPoolExecutor,
    ):
        self._scene, content = scene, scene.content
        given = {name: getattr(content, name) for name in content.samples}
        coming = {  # the others are already there
            name: values
            for name, values in given.items()
            if isinstance(values, np.ndarray) or dlpack_kind(values) == CPU[0]
        }
        # behind the mark the arrays of the slot may be written to
        asked = device, content, coming, slot, device.mark() if coming else None, copiers
        self._transfers: Callable[[], dict]
        if not any(_is_staged(content, name, values) for name, values in coming.items()):
            transfers = _send(*asked)
            self._transfers = lambda: transfers
        else:
            self._transfers = pool.submit(_send, *asked).result

    def scene(self) -> Scene:
        """Return the scene. Later launches wait for its upload."""
        arrays = {name: transfer.join() for name, transfer in self._transfers().items()}
        return self._scene.stored(**arrays) if arrays else self._scene

    def wait(self):
        """Wait for the upload."""
        for transfer in self._transfers().values():
            transfer.wait()


def _send(device, content, samples: dict, slot: dict, mark, copiers) -> dict:
    """Return the transfers of samples by name."""
    transfers = {}
    for name, values in samples.items():
        kind = content.stored_type(name)
        if not isinstance(values, np.ndarray):
            values = to_host(values, content.form)
        target, staged, last = slot.get((name, kind)) or (None, None, None)
        if last is not None and tuple(last.array.shape) != values.shape:
            target = staged = None
        if not _is_staged(content, name, values):
            values = np.ascontiguousarray(values, kind)
        else:
            if last is not None:
                last.wait()  # it reads from there
            staged = device.pinned(values.shape, kind) if staged is None else staged
            _copy(staged, values, copiers)
            values = staged
        transfers[name] = device.send(values, target, mark)
        slot[name, kind] = transfers[name].array, staged, transfers[name]
    return transfers


def _is_staged(content, name, values) -> bool:
    """Return True if samples are copied to pinned memory before they are sent."""
    nbytes = prod(values.shape) * content.stored_type(name).itemsize
    return not isinstance(values, Pinned) and nbytes >= STAGED


def _copy(target: np.ndarray, values: np.ndarray, copiers: ThreadPoolExecutor):
    """Copy values to contiguous memory by several threads."""
    if not values.flags.c_contiguous:
        np.copyto(target, values, casting="unsafe")
        return
    pairs = zip(
        *(np.array_split(array.ravel(), COPIERS) for array in (target, values)), strict=True
    )
    for done in [copiers.submit(np.copyto, to, part, "unsafe") for to, part in pairs]:
        done.result()
