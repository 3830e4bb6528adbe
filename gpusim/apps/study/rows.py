"""Rows of a study's table: each depends only on the design, its own number and the device."""

import math
from collections.abc import Generator, Iterable
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from gpusim.apps.study.design import Design
from gpusim.apps.study.shot import Shot
from gpusim.apps.video.pipeline import Clock, ahead
from gpusim.domain.camera import Camera
from gpusim.domain.errors import GpusimError
from gpusim.optics.blas import one_core
from gpusim.pipeline.cache import same
from gpusim.pipeline.loop import Loop
from gpusim.pipeline.planning import plan_inputs
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.facts import Facts
from gpusim.planner.plan import Plan

AHEAD = 2  # rows whose plans wait
KEPT = 16  # plans of each scene that other cameras may share


@dataclass(frozen=True, eq=False)
class _Planned:
    """A row before it is computed. camera, plan: None if they are refused; error: then the reason."""

    row: int
    camera: Camera | None = None
    plan: Plan | None = None
    error: str = ""


class Rows:
    """Computes rows. Plans are made in a second thread, ahead of the device's work.

    A plan is shared by the cameras of which no key that it depends on differs.

    Args:
        design: The design.
        device: Name of a device, or a Device.

    Attributes:
        clock: Seconds of the parts: "planning" next to "computing" and "measuring".
    """

    def __init__(self, design: Design, device: Any = "auto"):
        self.design, self.clock = design, Clock()
        base = design.varied.base
        self.simulator = Simulator(base, device=device, tolerance=design.tolerance)
        self._planner = self.simulator.on_devices()[0].apart(base, self.simulator.tables)
        self._loops: dict[str, Loop] = {}
        self._plans: dict[str, list[tuple[tuple, Plan]]] = {name: [] for name in design.places}
        self._camera: tuple[int, Camera] | None = None  # the last one
        self._simulator: tuple[Camera, Simulator] | None = (
            None  # of the last camera that was computed
        )

    def each(self, numbers: Iterable[int]) -> Generator[dict[str, Any], None, None]:
        """Yield rows by their numbers: columns of the table by name.

        A camera or a picture that is refused gives a row with the error in the column "error". A value that could not
        be measured is None.
        """
        with closing(ahead(map(self._plan, numbers), AHEAD)) as planned:
            for one in planned:
                with one_core():  # other threads plan, and other processes work
                    row = self._row(one)
                yield row

    def _plan(self, row) -> _Planned:
        """Return a row's camera and plan."""
        number, scene, _ = self.design.place_of(row)
        with self.clock.of("planning"):
            try:
                if self._camera is None or self._camera[0] != number:
                    self._camera = None
                    self._camera = number, self.design.camera(number)
                camera = self._camera[1]
                return _Planned(row, camera, self._plan_of(scene, camera))
            except GpusimError as error:
                return _Planned(row, error=str(error))

    def _plan_of(self, scene, camera) -> Plan:
        """Return the plan of a scene, which is a function of scene and camera only: facts are read anew."""
        kept, inputs = self._plans[scene], plan_inputs(camera, self.simulator.tolerance)
        for known, plan in kept:
            if same(known, inputs):
                return plan
        if self._planner.camera is not camera:
            self._planner = self._planner.update(camera)
        picture = self.design.places[scene].scene
        plan = self._planner.plan(picture, Facts.of(picture))
        self._plans[scene] = [(inputs, plan), *kept[: KEPT - 1]]
        return plan

    def _row(self, planned: _Planned) -> dict[str, Any]:
        design = self.design
        number, scene, seed = design.place_of(planned.row)
        values = design.sampling.draw(number)
        own = [one for one in design.measures if scene in one.scenes]
        measured: dict[str, float | None] = {one.name: None for one in own}
        errors = [planned.error] if planned.error else []
        if planned.camera is not None and planned.plan is not None:
            try:
                shot = self._shoot(scene, planned.camera, planned.plan, seed, number)
            except GpusimError as error:
                errors.append(str(error))
            else:
                with self.clock.of("measuring"):
                    self._measure(shot, own, measured, errors)
        judged = {one.name: one.judge(scene, measured) for one in design.requirements}
        place = {"row": planned.row, "camera": number, "scene": scene, "seed": seed}
        row = place | values | measured | judged | {"error": "; ".join(errors)}
        return {name: row.get(name) for name in design.columns}

    def _shoot(self, scene, camera, plan, seed, number) -> Shot:
        """Return the picture of a camera.

        In a random sample each camera has noise of its own: its frame has its number. Cameras of a grid are compared
        in the same noise.
        """
        number = number if self.design.sampling.is_random else 0
        with self.clock.of("computing"):
            if self._simulator is None or self._simulator[0] is not camera:
                self._simulator = camera, self.simulator.update(camera)
            simulator = self._simulator[1]
            loop = self._loops.pop(scene, None)  # after an error another one begins
            place = self.design.places[scene]
            if loop is None:
                loop = simulator.loop(place.scene)
            else:
                loop.update(camera=camera)
                loop.simulator = simulator
            loop.restart(plan, camera)
            shot = Shot(loop, place, seed, number)
            self._loops[scene] = loop
            return shot

    @staticmethod
    def _measure(shot, measures, measured, errors):
        """Measure a picture. A value that is not a number counts as not measured."""
        for one in measures:
            try:
                value = one.make(shot)
            except GpusimError as error:
                errors.append(f"{one.name}: {str(error).removeprefix(f'{one.name}: ')}")
                continue
            if math.isnan(value):
                errors.append(f"{one.name}: not a number")
            else:
                measured[one.name] = value
