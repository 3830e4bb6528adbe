"""While a lens is turned the plan for where it stood is used: how near that comes, and when it is not."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import camera_with

import gpusim as gs
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.planner.choices import Sketch

BASE = camera_with(gs.open_camera("phone"), sensor={"exposure_time": 0.01})
TOLERANCE = 1e-3


def zernike(**places):
    """Waves of terms in Noll's order."""
    terms = np.zeros(11)
    for name, waves in places.items():
        terms[{"defocus": 3, "astigmatism": 5, "coma": 7, "spherical": 10}[name]] = waves
    return {"wavefront": Wavefront(zernike=tuple(terms))}


TURNS = {  # from, to, of the optics
    "wider": ({}, {"f_number": 1.5}),
    "narrower": ({}, {"f_number": 2.4}),
    "large": ({"f_number": 8.0}, {"f_number": 6.5}),
    "defocus": ({"defocus": 4e-6}, {"defocus": 7e-6}),
    "into focus": ({"defocus": 3e-6}, {"defocus": 0.0}),
    "nearer": ({"object_distance": 2.0}, {"object_distance": 0.8}),
    "spherical": (zernike(spherical=0.05), zernike(spherical=0.06)),
    "coma": (zernike(coma=0.1), zernike(coma=0.13)),
    "astigmatism": (zernike(astigmatism=0.2), zernike(astigmatism=0.15)),
    "blades": ({"pupil": Pupil(6, 0, 0.1)}, {"pupil": Pupil(6, 0, 0.2)}),
    "ring": (
        {"pupil": Pupil(0, 0.3), **zernike(coma=0.1)},
        {"pupil": Pupil(0, 0.3), **zernike(coma=0.13)},
    ),
}


def numpy(loop):
    return np.array(loop.simulator.device.numpy(loop.exposure.mean), np.float64)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "deadleaves") for name in TURNS if name != "ring"),
        pytest.param("ring", "deadleaves", marks=pytest.mark.slow),
        ("wider", "points"),
        ("nearer", "points"),
    ],
)
def test_a_draft_is_near_what_is_planned_for_the_lens(name, kind):
    """Leaves within twice the tolerance; points of light, which show all of a blur, a fifth as wrong as no new frame.

    Lenses that are not round are sketched: about 1 % of the light is beyond the kernels.
    The truth is the exact frame, of every wavelength and of one transform, by which no draft is made.
    """
    before, after = (camera_with(BASE, optics=turned) for turned in TURNS[name])
    scene = gs.chart(kind, size=(360, 288))
    loop = gs.Simulator(before, device="opencl", tolerance=TOLERANCE).loop(scene)
    old = numpy(loop).copy()
    draft = numpy(loop.update(camera=after, drafts=True)).copy()
    assert loop.plan.is_draft and loop.plan.verdict is None
    is_sketched = loop.plan.find(Sketch) is not None
    assert is_sketched == (name in ("coma", "astigmatism", "blades", "ring"))
    truth = numpy(gs.Simulator(after, device="opencl").loop(scene))
    wrong, turned = (np.sqrt(np.mean((found - truth) ** 2)) for found in (draft, old))
    part = 0.01 if is_sketched else 2 * TOLERANCE
    assert wrong <= (part * truth.mean() if kind == "deadleaves" else turned / 5)
    settled = numpy(loop.update(camera=after))
    assert not loop.plan.is_draft
    assert np.array_equal(
        settled, numpy(gs.Simulator(after, device="opencl", tolerance=TOLERANCE).loop(scene))
    )
    again = numpy(loop.update(camera=before))
    assert np.array_equal(
        again, numpy(gs.Simulator(before, device="opencl", tolerance=TOLERANCE).loop(scene))
    )


SKETCHED = {  # changes that tiles and planes do not serve
    "too wide for the tiles": {"optics": {"f_number": 8.0}},
    "larger pixels": {"optics": {"f_number": 2.0}, "sensor": {"pixel_pitch": 3e-6}},
    "smaller apertures": {"sensor": {"fill_factor": 0.3}},
    "coma": {"optics": zernike(coma=0.2)},
    "astigmatism": {"optics": zernike(astigmatism=0.2)},
    "far out of focus": {"optics": {"defocus": 40e-6}},
    "blades out of focus": {"optics": {"defocus": 20e-6, "pupil": Pupil(5, 0, 0.1)}},
}


@pytest.mark.parametrize("name", SKETCHED)
def test_a_sketch_shows_what_changes(name):
    """From a round lens in focus: nothing is planned, and the error is at most a quarter of the change.

    A quarter is small enough to see what the slider does. A sketch leaves out light beyond its kernels, 2 q / (pi^2 r)
    of it beyond r, which is 4 % for f/8, and how the spread changes within a channel. The truth is the exact frame.
    Means are made equal first: else the change of the light would count. Afterwards the frame is exact, bit for bit.
    """
    change = SKETCHED[name]
    scene = gs.chart("deadleaves", size=(240, 192))
    loop = gs.Simulator(BASE, device="opencl", tolerance=TOLERANCE).loop(scene)
    old = numpy(loop).copy()
    camera, plan = camera_with(BASE, **change), loop.plan
    draft = numpy(loop.update(camera=camera, drafts=True)).copy()
    assert loop.plan.find(Sketch) and loop.before.plan[0] is plan
    truth = numpy(gs.Simulator(camera, device="opencl").loop(scene))
    wrong, changed = (
        np.sqrt(np.mean((one - two * truth.mean() / two.mean()) ** 2))
        for one, two in ((truth, draft), (truth, old))
    )
    assert abs(draft.mean() / truth.mean() - 1) < 0.01
    assert wrong <= changed / 4
    assert np.array_equal(
        numpy(loop.update(camera=camera)),
        numpy(gs.Simulator(camera, device="opencl", tolerance=TOLERANCE).loop(scene)),
    )
    assert not loop.plan.is_draft


@pytest.mark.parametrize(
    "change",
    [
        {"optics": {"f_number": 2.0, "lateral_color": 1e-3}},
        {"optics": {"model": "none"}},
        {"sensor": {"centre": (0.0, 0.1)}},
    ],
)
def test_what_has_no_draft_is_planned(change):
    scene, base = (
        gs.chart("deadleaves", size=(120, 96)),
        camera_with(BASE, sensor={"fill_factor": 0.5}),
    )
    loop = gs.Simulator(base, device="opencl", tolerance=TOLERANCE).loop(scene)
    loop.exposure  # noqa: B018
    camera = camera_with(base, **change)
    found = numpy(loop.update(camera=camera, drafts=True))
    assert not loop.plan.is_draft
    assert np.array_equal(
        found,
        numpy(gs.Simulator(camera, device="opencl", tolerance=TOLERANCE).loop(scene)),
    )


def test_another_scene_ends_a_draft():
    first, second = (gs.chart("deadleaves", size=(120, 96), seed=seed) for seed in (1, 2))
    loop = gs.Simulator(BASE, device="opencl", tolerance=TOLERANCE).loop(first)
    loop.exposure  # noqa: B018
    turned = replace(BASE, optics=replace(BASE.optics, f_number=2.0))
    loop.update(camera=turned, scene=second, drafts=True)
    assert not loop.plan.is_draft
