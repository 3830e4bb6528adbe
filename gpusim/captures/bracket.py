"""One scene exposed for several times."""

import dataclasses
from math import prod
from time import perf_counter

from gpusim.domain.errors import OutOfRange
from gpusim.domain.exposure import bracket_times, checked_time
from gpusim.domain.scene import Scene
from gpusim.kernels.sensor.chip import chip
from gpusim.pipeline.frame import Exposure, Frame
from gpusim.pipeline.program import expose_mean
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


def bracket(
    simulator: Simulator,
    scene: Scene,
    stops,
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> list[Frame]:
    """Frames exposed `stops` longer than the camera would, such as (-2, 0, 2); numbered from `first`.

    The mean electrons are computed once. plan: see `Simulator`. Raises as `Simulator.frames` does. `merge_bracket`
    makes one picture of high dynamic range of them.
    """
    factors = bracket_times(1.0, stops)
    once = simulator.expose(scene, plan=plan)
    frames: list[Frame] = []
    for number, factor in enumerate(factors):
        exposure = lengthened(simulator, once, once.exposure_time * float(factor))
        if number == 0:
            exposure = dataclasses.replace(
                exposure, ms=once.ms | exposure.ms, wall_ms=once.wall_ms + exposure.wall_ms
            )
        frames += simulator.shoot(exposure, seed=seed, first=first + number)
    return frames


def lengthened(simulator: Simulator, exposure: Exposure, exposure_time: float) -> Exposure:
    """The same scene exposed for another time [s]; nothing but the mean electrons is computed anew.

    Raises OutOfRange.
    """
    if checked_time(exposure_time) is None:
        raise OutOfRange("exposure_time", "None", "a time [s]: the exposure has one of its own")
    device, shape, begun = simulator.device, exposure.mean.shape, perf_counter()
    with device.timed() as ms:
        mean = chip(
            device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1])),
            scale=exposure_time / exposure.exposure_time,
            device=device,
        )
        made = expose_mean(
            simulator, exposure.plan, device.reshape(mean, shape), exposure_time, exposure.gain
        )
    return dataclasses.replace(made, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begun))
