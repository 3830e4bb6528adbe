"""Frames by tiles: against sums in real space, and against the reference, on scenes of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS
from test_border import camera, images, relative, scene_of, truth

import gpusim as gs
from gpusim.domain.errors import BadData
from gpusim.domain.pupil import Pupil
from gpusim.kernels.optics.tiles import tiles
from gpusim.optics.lengths import Tiling, tiling
from gpusim.planner import plan as planner
from gpusim.planner.knobs import border as model

MUST, BAND = 5e-5, 2.5


def seen(monkeypatch, scene, lens, overlap, device="numpy", tolerance=1e-6):
    """Mean electrons of a second, and the plan, by tiles of this overlap and every wavelength."""
    monkeypatch.setattr(model, "OVERLAPS", (overlap,))
    monkeypatch.setattr(
        planner,
        "choose_option",
        lambda found, tolerance: max(
            (option for option in found if option.around.tiling),
            key=lambda option: option.way.count,
        ),
    )
    simulator = gs.Simulator(lens, device=device, tolerance=tolerance)
    exposure = simulator.expose(scene, 1.0)
    assert exposure.plan.find(Tiling).overlap >= overlap and "optics.tiles" in exposure.plan.models
    return simulator.device.numpy(exposure.mean), exposure.plan


def judged(monkeypatch, q, overlap, border, kind, hole=0.0, name="phone"):
    """True and predicted error of a frame."""
    random, margin = np.random.default_rng(int(10 * q)), 7 if border == "scene" else 0
    scene = scene_of(images(kind, (81 + 2 * margin, 106 + 2 * margin), random), border, margin)
    lens = camera(q, {"pupil": Pupil(obscuration=hole)} if hole else None, name)
    mean, plan = seen(monkeypatch, scene, lens, overlap)
    own = truth(scene, plan, hole=hole)
    error, predicted = relative(mean - own, own), plan.account.bounds["border"].rms
    print(
        f"q {q}, overlap {overlap}, {border}, {kind}, hole {hole}: {error:.1e}, predicted {predicted:.1e}"
    )
    return error, predicted


@pytest.mark.parametrize(
    "q, overlap, border, kind",
    [
        (1.1, 8, "edge", "leaves"),
        (0.7, 8, "zero", "texture"),
        (2.2, 16, "reflect", "leaves"),
        (1.1, 12, "scene", "edge"),
    ],
)
def test_tiles_of_natural_scenes(monkeypatch, q, overlap, border, kind):
    error, predicted = judged(monkeypatch, q, overlap, border, kind)
    assert error < MUST
    assert error / BAND < predicted


@pytest.mark.slow
@pytest.mark.parametrize("q, overlap", [(0.5, 8), (0.7, 8), (1.1, 8), (1.4, 12), (2.2, 16)])
@pytest.mark.parametrize("border", ["edge", "reflect", "zero", "scene"])
def test_tiles_of_natural_scenes_at_length(monkeypatch, q, overlap, border):
    """Most predictions within 2.5, none below a fifth."""
    rows = np.array(
        [
            judged(monkeypatch, q, overlap, border, kind, hole, name)
            for kind, hole, name in (
                ("leaves", 0.0, "phone"),
                ("edge", 0.0, "mono"),
                ("texture", 0.0, "phone"),
                ("leaves", 0.3, "phone"),
            )
        ]
    )
    ratio = rows[:, 1] / rows[:, 0]
    assert rows[:3, 0].max() < MUST
    assert np.mean((ratio > 1 / BAND) & (ratio < BAND)) >= 0.5 and ratio.min() > 0.2


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("samples", [1.0, 2.0])
def test_devices_see_the_same_tiles(monkeypatch, device, samples):
    """As the reference does, whose Gaussians have no splines: these err by 1e-6. Pixels of several samples, too."""
    random = np.random.default_rng(3)
    scene = replace(scene_of(images("leaves", (64, 90), random), "edge"), samples_per_pixel=samples)
    lens = camera(0.7)
    found = [seen(monkeypatch, scene, lens, 8, name)[0] for name in (device, "numpy")]
    assert relative(found[0] - found[1], found[1]) < 3e-6


@pytest.mark.parametrize("tolerance", [1e-3, 3e-5])
def test_a_lit_wall_in_the_dark_has_edges_all_around(monkeypatch, tolerance):
    """What splines err of them is predicted from the wall's own light: no two samples of it differ."""
    scene, lens = scene_of(np.ones((2, 150, 100)), "zero"), camera(0.9)
    (mean, plan), (true, _) = (
        seen(monkeypatch, scene, lens, 8, name, tolerance) for name in ("opencl:pocl", "numpy")
    )
    error, predicted = relative(mean - true, true), plan.account.bounds["border"].rms
    print(f"{tolerance:g}: {error:.1e}, predicted {predicted:.1e}")
    assert predicted / BAND < error < BAND * predicted


def test_lights_far_brighter_than_the_rest_stay_in_their_tile():
    """What a float32 transform errs of a point of 1e9 is nowhere but in the tiles that see it."""
    random = np.random.default_rng(1)
    plane = random.uniform(0.5, 1, (200, 200)).astype(np.float32)
    plane[100, 100] = 1e9
    f = np.arange(33) / 64
    table = np.exp(-2 * (np.pi * 0.7) ** 2 * (f[:, None] ** 2 + f**2)).astype(np.float32)
    given = {
        "tables": table[None, None],
        "mix": np.ones((1, 1)),
        "cfa": None,
        "border": "edge",
        "side": 64,
        "overlap": 8,
    }
    found = tiles(plane[None], **given, device="opencl:pocl")[0]
    true = tiles(plane[None], **given, device="numpy")[0]
    wrong = np.abs(found - true) > 1e-5
    assert (
        wrong.any() and not wrong[:48].any() and not wrong[:, :48].any() and not wrong[144:].any()
    )


def test_tiles_fit_their_mosaic():
    assert tiling(8, (2, 2)) == (Tiling(64, 8), True)
    assert tiling(9, (4, 4)) == (Tiling(64, 10), True)
    assert tiling(8, (6, 6)) == (Tiling(48, 9), True)
    assert tiling(8, (5, 5)) == (Tiling(64, 8), False)
    plane = np.ones((1, 9, 9), np.float32)
    for side, overlap, period in ((65, 8, 1), (64, 32, 1), (64, 9, 4), (72, 8, 1), (64, 8, 3)):
        with pytest.raises(BadData, match=r"^tiles of \d+ samples, .*wanted"):
            tiles(
                plane,
                np.ones((1, 1, 33, 33)),
                np.ones((1, 1)),
                np.zeros((period, period), np.int32),
                "edge",
                side,
                overlap,
                device="opencl:pocl",
            )
