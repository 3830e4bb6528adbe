"""Several reads of one growing charge."""

import numpy as np

from gpusim.domain.scene import Scene
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


def read_nondestructively(
    simulator: Simulator,
    scene: Scene,
    times,
    *,
    seed: int = 0,
    frame: int = 0,
    plan: Plan | None = None,
) -> np.ndarray:
    """Raw values of reads that leave the charge in the pixels: NumPy, reads x the shape of a frame's [DN].

    times: of the reads since the reset [s], rising; the last one is the exposure time. See `Readout.nondestructive`.
    plan: see `Simulator`.
    Raises as `Simulator.expose` does.
    """
    times = simulator.readout.checked_reads(times)
    exposure = simulator.expose(scene, float(times[-1]), plan=plan)
    return exposure.layered(
        simulator.readout.nondestructive(
            exposure.mean, exposure.exposure_time, times, gain=exposure.gain, seed=seed, frame=frame
        )
    )
