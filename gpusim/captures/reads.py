"""Nondestructive readout: several reads of one growing charge."""

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.scene import Scene
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


def read_nondestructively(
    simulator: Simulator,
    scene: Scene,
    times: ArrayLike,
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> np.ndarray:
    """Return the raw values of reads that leave the charge in the pixels.

    See `Readout.nondestructive`.

    Args:
        simulator: simulator whose camera takes the exposure.
        scene: scene to capture.
        times: times of the reads since the reset [s], rising; the last one is the exposure time.
        seed: seed of the noise.
        first: number of the frame.
        plan: plan to use; None plans the scene. See `Simulator`.

    Returns:
        Raw values on the host [DN]: one array per read, each with the shape of a frame's raw
        values.

    Raises:
        GpusimError: as raised by `Simulator.expose`.
    """
    checked: np.ndarray = simulator.readout.checked_reads(times)
    exposure = simulator.expose(scene, float(checked[-1]), plan=plan)
    return exposure.split_layers(
        simulator.readout.nondestructive(
            exposure.mean,
            exposure.exposure_time,
            checked,
            gain=exposure.gain,
            seed=seed,
            first=first,
        )
    )
