"""Frames of a sequence of scenes. The next scene is uploaded while this one is computed."""

from collections.abc import Generator, Iterable, Iterator
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, checked_count
from gpusim.domain.memory import CPU, dlpack_kind, is_array, to_host
from gpusim.domain.scene import Scene, checked_scene
from gpusim.pipeline.loop import checked_capture, checked_output
from gpusim.planner.plan import Plan

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

SLOTS = 2  # one is read while the other is written


class Stream(Iterator):
    """An iterator over one frame of each scene, see `Simulator.stream`.

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
        self._frames = self._generate(simulator, scenes, output, seed, first)

    def __next__(self) -> Any:
        return next(self._frames)

    def close(self) -> None:
        """End the stream. Waits for uploads."""
        self._frames.close()

    def _generate(self, simulator, scenes, output, seed, first):
        uploaded = _upload_scenes(simulator.device, map(checked_scene, scenes))
        loop = None
        try:
            capture = self._settings.get("capture")
            for number, scene in zip(count(first, capture.count if capture else 1), uploaded):
                loop = (
                    simulator.loop(scene, **self._settings)
                    if loop is None
                    else loop.update(scene=scene)
                )
                frame = loop.output(output, seed=seed, first=number)
                self.plan = loop.plan_of_output
                yield frame
            if loop is not None:
                loop.judge()
        finally:
            uploaded.close()


def _upload_scenes(device: Device, scenes: Iterator[Scene]) -> Generator[Scene, None, None]:
    """Yield the scenes with their samples on the device, while the next scene is uploaded.

    A scene's arrays may be rewritten when the scene after the next is requested.
    """
    if device.on_host or device.kind == "numpy":
        yield from scenes
        return
    slots: list[dict] = [{} for _ in range(SLOTS)]
    sent, earlier, number = None, None, 0
    try:
        while True:
            if earlier is not None:
                earlier.wait()
            coming = next(scenes, None)
            following = None if coming is None else _Upload(device, coming, slots[number % SLOTS])
            if sent is not None:
                yield sent.scene()
            if following is None:
                return
            sent, earlier, number = following, sent, number + 1
    finally:
        for one in (sent, earlier):
            if one is not None:
                one.wait()


class _Upload:
    """A scene on its way to a device.

    slot: device arrays that it overwrites, by name. Nothing that is launched from now on reads them.
    """

    def __init__(self, device, scene: Scene, slot: dict):
        self._scene, self._transfers, after = scene, {}, device.mark()
        content = scene.content
        for name in content.samples:
            values, kind = getattr(content, name), content.stored_type(name)
            if not isinstance(values, np.ndarray):
                if dlpack_kind(values) != CPU[0]:
                    continue  # already there
                values = to_host(values, content.form)
            values = np.ascontiguousarray(values, kind)
            target = slot.get((name, kind))
            if target is not None and tuple(target.shape) != values.shape:
                target = None
            self._transfers[name] = device.send(values, target, after)
            slot[name, kind] = self._transfers[name].array

    def scene(self) -> Scene:
        """Return the scene. Later launches wait for its upload."""
        arrays = {name: transfer.join() for name, transfer in self._transfers.items()}
        return self._scene.stored(**arrays) if arrays else self._scene

    def wait(self):
        """Wait for the upload."""
        for transfer in self._transfers.values():
            transfer.wait()
