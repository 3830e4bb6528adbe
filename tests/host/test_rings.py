"""What a lens spreads far from a point, beside its tail: judged by the pupil's own Fourier integral."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.optics.lenses import open_lens
from gpusim.optics.tables import call_always
from gpusim.planner.facts import Facts
from gpusim.planner.knobs.farfield import Point, waves
from gpusim.planner.question import Question

SIDE, SIZE, NEAREST = 32, 65, 12  # [sample]


@pytest.mark.parametrize("hole", [0.0, 0.3])
@pytest.mark.parametrize("w040", [0.0, 0.05])
@pytest.mark.parametrize("q", [1.4, 2.3])
def test_rings_are_those_of_the_pupil(q, hole, w040):
    """Against a quadrature of the pupil, which has no series. The next order is q / (pi r) of it, of two rims each."""
    camera = gs.open_camera("mono")
    optics = replace(
        camera.optics,
        model="diffraction",
        f_number=4.0,
        pupil=Pupil(obscuration=hole),
        wavefront=Wavefront(seidel=(w040, 0.0, 0.0, 0.0, 0.0)),
    )
    sensor = replace(
        camera.sensor, fill_factor=1.0, pixel_pitch=550e-9 * optics.working_f_number / q
    )
    scene = gs.chart("deadleaves", size=(64, 64), wavelengths=np.array([550.0, 560.0]))
    question = Question.of(
        scene,
        replace(camera, optics=optics, sensor=sensor),
        Facts.of(scene),
        None,
        guaranteed=False,
        reach=None,
        period=None,
        cache=call_always,
    )
    y, x = np.indices((SIDE, SIDE), float)
    r = np.maximum(np.hypot(y, x), 1)
    rings = waves(Point.of(question), r, y / r, x / r)
    tails = question.lens.tails(question.scene.wavelengths)[0]
    mean = sum(part / r**power for part, power in zip(tails, (3, 5, 7), strict=True))
    spread = open_lens(optics, question.pitch, (1.0, 1.0), scene.shape).kernels(
        [550.0], (0.0, 0.0), SIZE
    )[0]
    true = spread[SIZE // 2 :, SIZE // 2 :][:SIDE, :SIDE]
    far = (r >= NEAREST) & (r < SIDE - 1)
    wrong, size = (np.sqrt(np.mean(part[far] ** 2)) for part in (mean + rings[0] - true, rings[0]))
    assert wrong < 3 * q / (np.pi * NEAREST) * size
