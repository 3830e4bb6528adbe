"""What a planner's caller keeps between plans is given again for what it was made for, and for nothing else."""

from dataclasses import replace

import numpy as np

from gpusim.data.charts import chart
from gpusim.domain.account import Tolerance
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.cache import Cache
from gpusim.planner.plan import plan

PHONE = open_camera("phone")


def camera(pixels=None, **optics):
    return replace(
        PHONE,
        optics=replace(PHONE.optics, **optics),
        sensor=replace(PHONE.sensor, **(pixels or {})),
    )


def parts(made):
    """All that a plan says of its blur."""
    return made.models, made.account, made.beside, made.flat, made.table, made.mix, made.transfers


# each other than the one before in one thing that what is kept depends on
CAMERAS = [
    camera(),
    camera(f_number=4.0),
    camera({"fill_factor": 0.5}),
    camera({"offset": (0.25, 0.0)}),
    camera({"offset": (0.0, 0.25)}),
    camera(),
    camera(defocus=5e-6),
    camera(),
    camera({"qe": replace(PHONE.sensor.qe, values=PHONE.sensor.qe.values**2)}),
    replace(
        PHONE,
        sensor=replace(PHONE.sensor, cfa=("GR", "RB")),
        processor=replace(PHONE.processor, demosaic="bilinear"),
    ),
    camera(),
]
SCENES = [
    chart("colorchecker", size=(30, 20)),
    chart("deadleaves", size=(30, 20)),
    chart("colorchecker", size=(24, 16), light="A"),
    chart("colorchecker", size=(24, 16), samples_per_pixel=1.5),
]


def test_plans_are_those_of_a_planner_that_keeps_nothing():
    """Bit for bit, with cameras, scenes and tolerances in turn; and once more, when all of it is known."""
    kept = Cache()
    for number, one in enumerate(CAMERAS):
        for scene in SCENES if number % 5 == 0 else SCENES[:1]:
            tolerance = Tolerance(rms=(1e-2, 2e-3)[number % 3 % 2])
            wanted = parts(plan(scene, one, tolerance=tolerance))
            for _ in range(2):
                np.testing.assert_equal(
                    parts(plan(scene, one, tolerance=tolerance, cache=kept)), wanted
                )
