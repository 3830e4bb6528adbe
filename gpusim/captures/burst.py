"""Many frames exposed alike: of a scene at rest, or of what a camera that shakes sees."""

from collections.abc import Iterable

import numpy as np

from gpusim.domain.errors import BadData, checked_count
from gpusim.domain.scene import Scene
from gpusim.pipeline.frame import Exposure, Frame
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


def burst(
    simulator: Simulator,
    scenes: Scene | Iterable[Scene],
    count: int = 1,
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> list[Frame]:
    """Frames of one exposure time and gain, numbered from `first`: as `merge_burst` takes them.

    scenes: one, or several, such as the views of a hand that shakes. count: frames of each; its mean electrons are
    computed once. Automatic exposure meters the first scene. plan: see `Simulator`. Raises as `Simulator.frames` does.
    """
    checked_count("count of frames", count)
    views = [scenes] if isinstance(scenes, Scene) else list(scenes)
    if not views:
        raise BadData("burst: no scenes, wanted one or several")
    exposures = [simulator.expose(views[0], plan=plan)]
    exposures += [
        simulator.expose(view, exposures[0].exposure_time, exposures[0].gain, plan)
        for view in views[1:]
    ]
    return [
        frame
        for number, exposure in enumerate(exposures)
        for frame in simulator.shoot(exposure, count, seed=seed, first=first + number * count)
    ]


def average(
    simulator: Simulator, exposure: Exposure, count: int, *, seed: int = 0, first: int = 0
) -> np.ndarray:
    """Mean raw values of `count` frames of an exposure [DN], float64: see `Readout.average`. Raises OutOfRange."""
    return exposure.layered(
        simulator.readout.average(
            exposure.chip_mean,
            exposure.exposure_time,
            count,
            gain=exposure.gain,
            seed=seed,
            first=first,
        )
    )
