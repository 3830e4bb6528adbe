"""Several frames in one array, of several scenes or with several settings."""

from collections.abc import Iterable
from contextlib import suppress
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import BadData, DoesNotFit, GpusimError, checked_count
from gpusim.domain.memory import is_array, type_of
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.optics.labels import carry_labels
from gpusim.pipeline.cache import Cache, same
from gpusim.pipeline.loop import Capture, Loop, SharedOptics, checked_capture, checked_output
from gpusim.pipeline.planning import plan_inputs
from gpusim.planner.plan import Plan

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

MOST = 2**16  # items; each has a loop


class Batch:
    """A simulator's frames, `count` in each call, in one device array.

    Each item is the frame of a `Loop`, so results are reused from call to call. Results that items share, for
    example a scene's blur, are computed once on each device. Several devices take the items in turn, with the same
    bits, and copy the frames to the first one. The device measures each scene that the plan was not made for; the next
    call checks these measurements.

    Args:
        simulator: The Simulator.
        count: Number of items.
        output: A key of `gpusim.pipeline.loop.OUTPUTS`.
        planned_for: Scene whose plan is used for all scenes of its kind that it fits, in any order of calls. Other
            scenes get their own plans. None reuses plans of earlier scenes.
        plan: Plan for all frames, see `Loop`.
        capture: Capture of each item, see `Loop`. Frames that are not merged follow each other on the first axis,
            those of an item together: devices have four axes at most.

    Attributes:
        plans: Plans of the items of the last call.

    Raises:
        UnknownName: There is no such output.
        OutOfRange: The count is not allowed.
    """

    def __init__(
        self,
        simulator: "Simulator",
        count: int,
        output: str = "codes",
        planned_for: Scene | None = None,
        plan: Plan | None = None,
        capture: Capture | None = None,
    ):
        self.output, self._capture = checked_output(output), checked_capture(capture)
        self.count = checked_count("count of a batch", count, 1, MOST)
        self._simulator, self._cache = simulator, Cache(simulator.device)
        self._simulators = simulator.on_devices()
        self._items: list[Loop | None] = [None] * self.count
        self._planned_for, self._plan = None if plan is not None else planned_for, plan
        self.plans: list[Plan] = []
        self._seen: list = []

    @property
    def labels(self) -> list[dict[str, np.ndarray]]:
        """Labels and depth of each scene of the last call, see `gpusim.carry_labels`."""
        return [carry_labels(scene, camera) for scene, camera in self._seen]

    def __repr__(self):
        return shorten_repr(f"Batch({self.count} of {self.output}, {self._simulator!r})")

    def __call__(
        self,
        scenes: Scene | Iterable[Scene],
        *,
        camera: Camera | Iterable[Camera] | None = None,
        exposure_time: float | Iterable[float] | None = None,
        gain: float | Iterable[float] = 1.0,
        seed: int | Iterable[int] = 0,
        first: int | Iterable[int] = 0,
    ) -> Any:
        """Return frames of the scenes. The next call overwrites the array.

        Each argument is one value for all items, or one for each item. Automatic exposure meters each item, and waits
        for the device.

        Args:
            scenes: The scenes.
            camera: The cameras; None uses the simulator's.
            exposure_time: Exposure times [s]; None uses the camera's, see `Simulator.expose`.
            gain: Analog gains, next to the sensor's [1].
            seed: Seeds of the noise.
            first: Numbers of the frames. One number is for the first item; the others count up from it.

        Returns:
            A device array (count, ...) of the type of one frame, (count * frames, ...) of captures with frames.

        Raises:
            BadData: Items have different shapes, or an argument has another number of values than there are items.
        """
        if is_array(scenes):
            checked_scene(scenes)  # raises BadData
        given = {
            "scenes": scenes,
            "camera": self._simulator.camera if camera is None else camera,
            "exposure_time": exposure_time,
            "gain": gain,
            "seed": seed,
            "first": first,
        }
        values = {name: one_each(name, value, self.count) for name, value in given.items()}
        if isinstance(first, int | np.integer):
            each = 1 if self._capture is None else self._capture.count
            values["first"] = [first + item * each for item in range(self.count)]
        sizes = {scene.shape for scene in map(checked_scene, values["scenes"])}
        if len(sizes) > 1:
            raise BadData(
                "batch: scenes of "
                + ", ".join(f"{cols}x{rows}" for rows, cols in sorted(sizes))
                + " pixels; wanted one size"
            )
        try:
            return self._frames([*zip(*values.values(), strict=True)])
        except BaseException:
            # unfinished checks must not reach the next call
            self._items = [None] * self.count
            raise

    def _frames(self, rows):
        """Return a frame of each scene with its camera, exposure time, gain, seed and number."""
        device, ahead = self._simulator.device, len(self._simulators) - 1
        loops: list[Loop] = []
        frames = []
        plans = []
        for item, (scene, _, _, _, seed, number) in enumerate(rows):
            for own, camera, seconds, gain, *drawn in rows[len(loops) : item + 1 + ahead]:
                loop = self._loop(len(loops), own, camera)
                loops.append(loop.update(scene=own, exposure_time=seconds, gain=gain))
                if len(loops) > item + 1:
                    with suppress(GpusimError):  # raised again in its turn
                        loop.begin(seed=drawn[0], first=drawn[1])
            loop = loops[item]
            if not item and self._capture is None:  # the items' arrays and the memory of one frame
                plan = loop.plan
                needed = plan.bytes_needed + self.count * bytes_of_item(plan, self.output)
                if needed > device.memory:
                    size = "x".join(map(str, scene.shape[::-1]))
                    what = f"a batch of {self.count} frames of {size}"
                    raise DoesNotFit(what, needed, device.memory, device.name)
            frames.append(loop.output(self.output, seed=seed, first=number))
            plans.append(loop.plan_of_output)
        checked = rows if self._planned_for is not None else ()
        for item, (scene, camera, seconds, gain, seed, number) in enumerate(checked):
            loop = self._items[item]
            if self._capture is None:
                loop.settle()
            else:
                loop.judge()
            made, _ = loop.before.plan or (None, None)
            if made is not None and made.scene is self._planned_for:
                continue
            self._items[item] = None  # another plan is for this call only
            if made is None or plans[item].scene is not scene:  # the plan did not fit
                own = self._simulator_of(item).apart(camera, Cache())
                loop = Loop(own, scene, seconds, gain, capture=self._capture)
                frames[item] = loop.output(self.output, seed=seed, first=number)
                plans[item] = loop.plan_of_output
        shapes = {tuple(array.shape) for array in frames}
        if len(shapes) > 1:
            raise BadData(
                f"batch: frames of {' and '.join(map(str, sorted(shapes)))} values; wanted cameras whose "
                "frames have one shape"
            )
        frames = [
            _brought(frame, device) if item % len(self._simulators) else frame
            for item, frame in enumerate(frames)
        ]
        self.plans, self._seen = plans, [(scene, camera) for scene, camera, *_ in rows]
        function = join_frames if self._capture and self._capture.has_frames else stack_frames
        return self._cache("frames", function, *frames, device=device)

    def judge(self) -> None:
        """Wait for the device's measurements of the scenes, see `Loop.judge`.

        Each call does this for the call before. Raises BadData if a scene has light that is not finite.
        """
        for loop in self._items:
            if loop is not None:
                loop.judge()

    def _simulator_of(self, item):
        """Return the simulator on the device of an item."""
        return self._simulators[item % len(self._simulators)]

    def _loop(self, item, scene, camera):
        """Return the loop of an item. It shares the plan of items with the same, on its device optical results too."""
        loop = self._items[item]
        if loop is not None and loop.simulator.camera is camera:
            return loop
        tolerance = self._simulator.tolerance
        by = plan_inputs(checked_camera(camera), tolerance)

        def has_same_plan(other):
            return same(plan_inputs(other.simulator.camera, tolerance), by)

        if loop is not None:
            if has_same_plan(loop):
                return loop.update(camera=camera)
            loop.judge()  # its last call
        in_use = [other for other in self._items if other is not None and other is not loop]
        twins = [*filter(has_same_plan, in_use)]
        base = self._simulator_of(item)
        in_use = [other for other in in_use if other.simulator.device is base.device]
        twin = next((other for other in twins if other in in_use), None)
        tables = twin.simulator.tables if twin else Cache() if in_use else base.tables
        simulator = base.apart(camera, tables)
        before = SharedOptics(base.device)
        if self._planned_for is None and twins:
            before = twin.before if twin else SharedOptics(base.device, twins[0].before)
        loop = self._items[item] = Loop(
            simulator,
            self._planned_for or scene,
            before=before,
            plan=self._plan,
            capture=self._capture,
        )
        if self._planned_for is not None:
            loop.plan  # noqa: B018  makes the plan for all later scenes
        return loop


def _brought(frame, device):
    """Return a copy of another device's array."""
    kind = type_of(frame)
    if device.on_host:  # the other device will write to the array's memory again
        frame = np.array(frame)
    return device.array(frame, kind)


def stack_frames(*frames, device) -> Any:
    """Return frames in one array."""
    return device.stack(frames)


def join_frames(*frames, device) -> Any:
    """Return arrays of frames in one array, one after the other."""
    count, *shape = frames[0].shape
    flat = device.stack([device.reshape(array, (count * prod(shape),)) for array in frames])
    return device.reshape(flat, (len(frames) * count, *shape))


def bytes_of_item(plan: Plan, output: str) -> int:
    """Return the memory of one item of a batch, its copy included [byte].

    Args:
        plan: Plan of the item.
        output: A key of `gpusim.pipeline.loop.OUTPUTS`.

    Returns:
        The memory [byte].
    """
    pixels, channels = prod(plan.scene.shape), len(plan.weights)
    if output in ("irradiance", "electrons"):
        return 8 * pixels * (len(plan.scene.wavelengths) if output == "irradiance" else channels)
    # both means, raw values, and the copy of one of them
    raw = 14 * (channels if plan.camera.sensor.stacked else 1)
    developed = {
        "camera": 8 * channels,
        "linear": 4 * channels + 24,
        "xyz": 4 * channels + 36,
        "codes": 4 * channels + 18,
    }
    return pixels * (raw + developed.get(output, 0))


def one_each(name: str, value: Any, count: int) -> list:
    """Return a list with one value for each item.

    Args:
        name: Name of the argument, for the message.
        value: One value for all items, or several.
        count: Number of items.

    Returns:
        The list.

    Raises:
        BadData: The number of values is not `count`.
    """
    if (
        not isinstance(value, Iterable)
        or isinstance(value, str)
        or getattr(value, "shape", None) == ()
    ):
        return [value] * count
    values = list(value)
    if len(values) != count:
        raise BadData(
            f"batch: {len(values)} of {name}, wanted one for all items or {count} of them"
        )
    return values
