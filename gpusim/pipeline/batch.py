"""Several frames at once in one array: of several scenes, or of one by several settings."""

from collections.abc import Iterable
from math import prod
from typing import Any

import numpy as np

from gpusim.domain.camera import checked_camera
from gpusim.domain.errors import BadData, DoesNotFit, UnknownName, checked_count
from gpusim.domain.foreign import is_array
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shortened
from gpusim.pipeline.cache import Cache, same
from gpusim.pipeline.outputs import OUTPUTS
from gpusim.pipeline.planning import planned_by
from gpusim.pipeline.program import Program, SharedOptics
from gpusim.planner.plan import Plan

MOST = 2**16  # items: each has a program of its own


class Batch:
    """`count` frames a call in one array of the device, by a Simulator.

    output: a name of `gpusim.pipeline.outputs.OUTPUTS`. Every item is the frame that a `Program` gives: what was
    computed for one call serves the next; what items have in common, such as a scene and its blur, is computed once.
    Scenes that the plan was not made for are looked at on the device, and judged before the next call.
    planned_for: a scene whose plan frames all of its kind that it fits, however they come together in calls; others
    are planned by themselves. Without it plans are those of scenes that came before.
    plan: makes all frames instead, see `Program`. plans: of the items of the last call.
    """

    def __init__(
        self,
        simulator,
        count: int,
        output: str = "codes",
        planned_for: Scene | None = None,
        plan: Plan | None = None,
    ):
        if output not in [*OUTPUTS]:
            raise UnknownName("output", str(output), OUTPUTS)
        self.count, self.output = checked_count("count of a batch", count, 1, MOST), output
        self._simulator, self._cache = simulator, Cache(simulator.device)
        self._items: list[Program | None] = [None] * self.count
        self._planned_for, self._plan = None if plan is not None else planned_for, plan
        self.plans: list[Plan] = []

    def __repr__(self):
        return shortened(f"Batch({self.count} of {self.output}, {self._simulator!r})")

    def __call__(
        self,
        scenes: Scene | Iterable[Scene],
        *,
        camera=None,
        exposure_time=None,
        gain=1.0,
        seed=0,
        frame=0,
    ) -> Any:
        """Frames of the scenes, shape (count, ...), type as of one frame; written anew by the next call.

        scenes: one for all, or one for each item. camera: the simulator's if None. exposure_time, gain: as for
        `Simulator.expose`. seed: of the noise. frame: number of the first item's, the others count on. Each of them may
        be one for every item too. Automatic exposure meters every item's own light, and waits for it.
        Raises as `Simulator.frames` does, and BadData for items of unlike shapes and for numbers of values that are not
        those of the items.
        """
        if is_array(scenes):
            checked_scene(scenes)  # which refuses it
        given = {
            "scenes": scenes,
            "camera": self._simulator.camera if camera is None else camera,
            "exposure_time": exposure_time,
            "gain": gain,
            "seed": seed,
            "frame": frame,
        }
        values = {name: one_each(name, value, self.count) for name, value in given.items()}
        if isinstance(frame, int | np.integer):
            values["frame"] = [frame + item for item in range(self.count)]
        sizes = {scene.shape for scene in map(checked_scene, values["scenes"])}
        if len(sizes) > 1:
            raise BadData(
                "batch: scenes of "
                + ", ".join(f"{cols}x{rows}" for rows, cols in sorted(sizes))
                + " pixels; wanted one size"
            )
        try:
            return self._frames(values)
        except BaseException:
            self._items = [
                None
            ] * self.count  # what was left undone would be judged in the next call
            raise

    def _frames(self, values):
        programs, frames, plans = [], [], []
        for item, (own, by, its_time, its_gain, its_seed, number) in enumerate(
            zip(*values.values(), strict=True)
        ):
            program = self._program(item, own, by).update(
                scene=own, exposure_time=its_time, gain=its_gain
            )
            if not item:
                self._require_memory(program.plan)
            programs.append(program)
            frames.append(program.output(self.output, seed=its_seed, frame=number))
            plans.append(program.plan)
        if self._planned_for is not None:
            for item, (own, by, its_time, its_gain, its_seed, number) in enumerate(
                zip(*values.values(), strict=True)
            ):
                programs[item].judge()
                if (
                    programs[item].before.plan is None
                ):  # a program of its own; the next call has another one
                    self._items[item] = None
                    programs[item] = Program(
                        self._simulator.apart(by, Cache()), own, its_time, its_gain
                    )
                    frames[item] = programs[item].output(self.output, seed=its_seed, frame=number)
                    plans[item] = programs[item].plan
        shapes = {tuple(array.shape) for array in frames}
        if len(shapes) > 1:
            raise BadData(
                f"batch: frames of {' and '.join(map(str, sorted(shapes)))} values; wanted cameras whose "
                "frames have one shape"
            )
        self.plans = plans
        return self._cache("frames", stack_frames, *frames, device=self._simulator.device)

    def judge(self) -> None:
        """Wait for what the device saw of the scenes: see `Program.judge`. Every call does it for the one before."""
        for program in self._items:
            if program is not None:
                program.judge()

    def _program(self, item, scene, camera):
        """The program of an item, which shares with the others what their plans have in common."""
        program = self._items[item]
        if program is not None and program.simulator.camera is camera:
            return program
        asked = self._simulator.tolerance
        by = planned_by(checked_camera(camera), asked)

        def is_alike(other):
            return same(planned_by(other.simulator.camera, asked), by)

        if program is not None:
            if is_alike(program):
                return program.update(camera=camera)
            program.judge()  # its last call
        in_use = [other for other in self._items if other is not None and other is not program]
        alike = next(filter(is_alike, in_use), None)
        tables = alike.simulator.tables if alike else Cache() if in_use else self._simulator.tables
        simulator, shared = (
            self._simulator.apart(camera, tables),
            alike is not None and self._planned_for is None,
        )
        program = self._items[item] = Program(
            simulator,
            self._planned_for or scene,
            before=alike.before if shared else SharedOptics(simulator.device),
            plan=self._plan,
        )
        if self._planned_for is not None:
            program.plan  # noqa: B018  it is made, for all scenes to come
        return program

    def _require_memory(self, plan):
        """Raise DoesNotFit where the items' arrays do not fit beside what one frame takes."""
        (rows, cols), device = plan.scene.shape, self._simulator.device
        needed = plan.bytes_needed + self.count * bytes_of_item(plan, self.output)
        if needed > device.memory:
            raise DoesNotFit(
                f"a batch of {self.count} frames of {cols}x{rows}",
                needed,
                device.memory,
                device.name,
            )


def stack_frames(*frames, device) -> Any:
    """Return frames in one array."""
    return device.stack(frames)


def bytes_of_item(plan: Plan, output: str) -> int:
    """Return the memory of an output of `gpusim.pipeline.outputs.OUTPUTS` in a batch, where it is copied [byte]."""
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


def one_each(name: str, value, count: int) -> list:
    """A value for every item: of one for all, or of one for each. Raises BadData for other numbers of them."""
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
