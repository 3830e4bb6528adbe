"""Raw values of many frames of a scene at rest."""

import numpy as np

from gpusim.domain.scene import Scene
from gpusim.frame import Exposure
from gpusim.simulator import Simulator


def burst(simulator: Simulator, scene: Scene, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
    """Raw values of `count` frames, numbered from `first`, drawn at once: NumPy, count x the shape of a frame's [DN].

    Raises as `Simulator.frames` does, and DoesNotFit for frames that the device cannot hold at once.
    """
    exposure = simulator.expose(scene)
    raw = simulator.draw(exposure, seed=seed, frame=first, frames=count)
    return exposure.layered(np.array(simulator.device.numpy(raw)))


def average(simulator: Simulator, exposure: Exposure, count: int, *, seed: int = 0, first: int = 0) -> np.ndarray:
    """Mean raw values of `count` frames of an exposure [DN], float64: see `Readout.average`. Raises OutOfRange."""
    return exposure.layered(simulator.readout.average(
        exposure.chip_mean, exposure.exposure_time, count, gain=exposure.gain, seed=seed, first=first))
