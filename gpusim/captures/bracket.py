"""Exposure brackets: one scene captured with several exposure times."""

import dataclasses
from collections.abc import Sequence
from math import prod
from time import perf_counter

from gpusim.domain.errors import OutOfRange
from gpusim.domain.exposure import bracket_times, checked_time
from gpusim.domain.scene import Scene
from gpusim.kernels.sensor.chip import chip
from gpusim.pipeline.exposure import Exposure, expose_mean
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


def bracket(
    simulator: Simulator,
    scene: Scene,
    stops: Sequence[float],
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> list[Frame]:
    """Capture a scene with several exposure times.

    The mean electrons are computed once. `merge_bracket` merges the frames into one high dynamic
    range picture.

    Args:
        simulator: simulator whose camera takes the frames.
        scene: scene to capture.
        stops: exposure of each frame relative to the camera's, in stops: (-2, 0, 2) for a quarter,
            once and four times the exposure time.
        seed: seed of the noise.
        first: number of the first frame.
        plan: plan to use; None plans the scene. See `Simulator`.

    Returns:
        One frame per stop.

    Raises:
        BadData: if `stops` is not a list of numbers.
        OutOfRange: if a stop gives no valid exposure time.
        GpusimError: as raised by `Simulator.frames`.
    """
    factors = bracket_times(1.0, stops)
    metered = simulator.expose(scene, plan=plan)
    frames: list[Frame] = []
    for number, factor in enumerate(factors):
        exposure = change_exposure_time(simulator, metered, metered.exposure_time * float(factor))
        if number == 0:
            exposure = dataclasses.replace(
                exposure, ms=metered.ms | exposure.ms, wall_ms=metered.wall_ms + exposure.wall_ms
            )
        frames.append(exposure.frame(seed=seed, first=first + number))
    return frames


def change_exposure_time(
    simulator: Simulator, exposure: Exposure, exposure_time: float
) -> Exposure:
    """Return an exposure of the same scene with another exposure time.

    Only the electrons of the chip are computed again; the light on the pixels is reused.

    Args:
        simulator: simulator that made the exposure.
        exposure: exposure to change.
        exposure_time: new exposure time [s].

    Returns:
        The new exposure, with the plan and gain of the old one.

    Raises:
        OutOfRange: if `exposure_time` is None or not a valid time.
    """
    if checked_time(exposure_time) is None:
        raise OutOfRange("exposure_time", "None", "a time [s]")
    device, shape, start = simulator.device, exposure.mean.shape, perf_counter()
    with device.timed() as ms:
        rows = device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1]))
        mean = chip(rows, scale=exposure_time / exposure.exposure_time, device=device)
        mean = device.reshape(mean, shape)
        changed = expose_mean(simulator, exposure.plan, mean, exposure_time, exposure.gain)
    return dataclasses.replace(changed, ms=dict(ms), wall_ms=1e3 * (perf_counter() - start))
