"""Fused bands against a transform per band, in one run: time and true error of a frame's blur.

    python bench/fusion.py --device opencl --repeat 5 [--json bench/results/fusion-NAME.json]

All forms start from the 31 planes of a cube and end with mean electrons on the host. The base is
gpusim/bench/baseline.py, the error the relative RMS against float64.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from results import add_repeat, add_size, compared, parser, ready, start

from gpusim.bench.baseline import Baseline
from gpusim.bench.loops import SECONDS, make_cube
from gpusim.bench.timing import find_rms
from gpusim.data.charts import chart
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.errors import OutOfRange
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.outside import BORDER_REACH
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Fusion

RANKS = (3, 4, 6)


def main():
    """Print milliseconds, ratios with their spread, and errors."""
    made = parser(__doc__, "opencl")
    add_size(made)
    add_repeat(made, 5)
    arguments = made.parse_args()
    device, old = ready(arguments, "fusion")
    camera = open_camera("phone")
    camera = replace(camera, optics=replace(camera.optics, f_number=2.8))
    scene = chart("deadleaves", size=arguments.size, surfaces="objects")
    values = make_cube(scene)
    scene = replace(scene, content=Cube(scene.wavelengths, values))
    exact = Simulator(camera, device=device, reach=BORDER_REACH)
    forms = {"per band, SciPy": partial(Baseline(exact, scene).mean, values, SECONDS)}
    forms |= {
        f"rank {rank}, folded": partial(_mean, *_of_rank(camera, device, scene, rank))
        for rank in RANKS
    }
    forms["every band, folded"] = partial(_mean, exact, exact.plan(scene))
    truth = Simulator(camera, device="numpy", reach=BORDER_REACH).expose(scene, SECONDS).mean
    errors = {name: f"rms {find_rms(form(), truth):.1e}" for name, form in forms.items()}
    compared(
        arguments,
        "fusion",
        device,
        old,
        forms,
        dict.fromkeys(list(forms)[1:], "per band, SciPy"),
        errors,
        size=arguments.size,
        bands=len(values),
    )


def _of_rank(camera, device, scene, rank):
    """Return a simulator and its plan, with a tolerance for which the planner chooses `rank`."""
    for limit in np.geomspace(1e-2, 1e-6, 60):
        simulator = Simulator(
            camera, device=device, tolerance=Tolerance(rms=limit), reach=BORDER_REACH
        )
        plan = simulator.plan(scene)
        if plan.count == rank and plan.find(Fusion) is not None:
            return simulator, plan
    raise OutOfRange("rank", rank, "one that some tolerance gives for this scene")


def _mean(simulator, plan):
    values = simulator.imaging.values(plan)
    values.set_numbers(exposure_time=SECONDS)
    return simulator.device.numpy(values["mean"])


if __name__ == "__main__":
    start(main)
