"""What a planner's caller keeps between plans is given again for what it was made for, and for nothing else."""

from dataclasses import replace
from typing import get_args, get_type_hints

import numpy as np

from gpusim.data.charts import chart
from gpusim.domain.account import Tolerance
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.fusion import Watch
from gpusim.pipeline.cache import Cache
from gpusim.planner.choices import Blur, Fusion, Planes
from gpusim.planner.plan import Plan, plan

PHONE = open_camera("phone")


def camera(pixels=None, **optics):
    return replace(
        PHONE,
        optics=replace(PHONE.optics, **optics),
        sensor=replace(PHONE.sensor, **(pixels or {})),
    )


def parts(made):
    """All that a plan says of its blur."""
    choices = [
        choice for choice in made.choices if isinstance(choice, Planes | Blur | Fusion | Watch)
    ]
    return made.models, made.account, made.beside, made.flat, [vars(one) for one in choices]


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


def test_no_field_of_a_plan_is_coded_by_none():
    """A part that frames do without is not listed; every listed kind is listed once."""
    hints = get_type_hints(Plan)
    assert not [name for name, hint in hints.items() if type(None) in get_args(hint)]
    for scene in SCENES:
        for tolerance in (None, Tolerance(rms=1e-2)):
            made = plan(scene, PHONE, tolerance=tolerance)
            assert not [name for name in hints if getattr(made, name) is None]
            kinds = list(map(type, made.choices))
            assert len(kinds) == len(set(kinds)) and type(None) not in kinds
            for kind in kinds:
                assert type(made.find(kind)) is kind
