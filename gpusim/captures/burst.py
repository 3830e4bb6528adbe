"""Bursts: frames with the same exposure, of a static scene or of a shaking camera's views."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gpusim.captures.capture import Capture
from gpusim.captures.merge import merge_burst
from gpusim.captures.regression import check_enlargement
from gpusim.domain.errors import BadData, Conflict, checked_count
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import short_repr
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


@dataclass(frozen=True)
class Burst(Capture):
    """Frames with one exposure time and gain, one after the other.

    A frame in motion opens when the last row of the frame before has closed. `merged` merges by
    `merge_burst`, aligned to the first frame.

    Args:
        size: Number of frames.
        enlarge: Pixels of the merged picture per pixel of the camera, along rows and columns, 1 to
            3.

    Raises:
        Conflict: Frames that are not merged cannot be enlarged.
        OutOfRange: A number is not allowed.
    """

    size: int = 8
    enlarge: float = 1.0

    _merges = True
    __repr__ = short_repr

    def __post_init__(self):
        super().__post_init__()
        checked_count("frames of a burst", self.size, 1 + self.merged)
        check_enlargement(self.enlarge)
        if self.enlarge != 1 and not self.merged:
            raise Conflict("enlarge", "only merged frames have samples enough", "add merged")

    @property
    def count(self) -> int:
        """Number of frames."""
        return self.size

    @property
    def keeps_size(self) -> bool:
        """True if its pictures have as many pixels as the camera."""
        return self.enlarge == 1

    def _exposures(self, light):
        exposures, after = [], 0.0
        for _ in range(self.size):
            exposures.append(light.expose(after))
            after += exposures[-1].exposure_time + light.readout_time
        return exposures

    def _merge(self, simulator, frames):
        return merge_burst(simulator, frames, enlarge=self.enlarge)


def burst(
    simulator: Simulator,
    scenes: Scene | Iterable[Scene],
    count: int = 1,
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> list[Frame]:
    """Capture frames with one exposure time and gain, as `merge_burst` takes them.

    `Burst` does the same for one scene, also in motion. The mean electrons of each scene are
    computed once. Automatic exposure meters the first scene.

    Args:
        simulator: simulator whose camera takes the frames.
        scenes: one scene or several, for example the views of a shaking hand.
        count: frames per scene.
        seed: seed of the noise.
        first: number of the first frame.
        plan: plan to use for all scenes; None plans each. See `Simulator`.

    Returns:
        `count` frames of the first scene, then of the next.

    Raises:
        BadData: if there are no scenes.
        OutOfRange: if `count` is not a whole number of 1 or more.
        GpusimError: as raised by `Simulator.frames`.
    """
    checked_count("count of frames", count)
    views = [scenes] if isinstance(scenes, Scene) else list(scenes)
    if not views:
        raise BadData("burst: no scenes; wanted one or more")
    exposures = [simulator.expose(views[0], plan=plan)]
    exposures += [
        simulator.expose(view, exposures[0].exposure_time, exposures[0].gain, plan)
        for view in views[1:]
    ]
    return [
        frame
        for number, exposure in enumerate(exposures)
        for frame in exposure.frames(count, seed=seed, first=first + number * count)
    ]


def average(
    simulator: Simulator, exposure: Exposure, count: int, *, seed: int = 0, first: int = 0
) -> np.ndarray:
    """Return the mean raw values of many frames of an exposure, see `Readout.average`.

    Args:
        simulator: simulator that made the exposure.
        exposure: exposure to read out.
        count: number of frames.
        seed: seed of the noise.
        first: number of the first frame.

    Returns:
        Mean raw values [DN], float64, with the shape of a frame's raw values.

    Raises:
        OutOfRange: if `count`, `seed` or `first` is out of range.
    """
    mean = simulator.readout.average(
        exposure.chip_mean,
        exposure.exposure_time,
        count,
        gain=exposure.gain,
        seed=seed,
        first=first,
    )
    return exposure.split_layers(mean)
