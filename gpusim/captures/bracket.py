"""Exposure brackets: one scene captured with several exposure times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gpusim.captures.capture import Capture
from gpusim.captures.merge import merge_bracket
from gpusim.domain.exposure import bracket_times
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import short_repr
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


@dataclass(frozen=True)
class Bracket(Capture):
    """Frames with several exposure times, one after the other.

    A frame in motion opens when the last row of the frame before has closed. `merged` merges by
    `merge_bracket`.

    Args:
        stops: Exposure of each frame relative to the camera's, in stops: (-2, 0, 2) for a quarter,
            once and four times the exposure time.
        align: Align the frames before they are merged, see `merge_bracket`.

    Raises:
        BadData: `stops` is not a list of numbers.
        OutOfRange: A stop gives no valid exposure time.
    """

    stops: Sequence[float] = (-2.0, 0.0, 2.0)
    align: bool = True

    _merges = True
    __repr__ = short_repr

    def __post_init__(self):
        super().__post_init__()
        factors = bracket_times(1.0, self.stops)
        object.__setattr__(self, "_factors", [float(factor) for factor in factors])
        object.__setattr__(self, "stops", tuple(np.atleast_1d(self.stops).tolist()))

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.stops)

    def _exposures(self, light):
        exposures, after = [], 0.0
        for factor in self._factors:
            exposure = light.expose(after, factor)
            after += exposure.exposure_time + light.readout_time
            if not exposures and not light.is_moving:
                rest = light.rest
                exposure = replace(
                    exposure, ms=rest.ms | exposure.ms, wall_ms=rest.wall_ms + exposure.wall_ms
                )
            exposures.append(exposure)
        return exposures

    def _merge(self, simulator, frames):
        return merge_bracket(simulator, frames, align=self.align)


def bracket(
    simulator: Simulator,
    scene: Scene,
    stops: Sequence[float],
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> list[Frame]:
    """Capture a scene with several exposure times, see `Bracket`.

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
    return Bracket(stops).take(simulator, scene, seed=seed, first=first, plan=plan)
