"""A world without end by Gaussians: frames against sums in real space, which know no Gaussian and no transform."""

import dataclasses

import numpy as np
import pytest
from devices import ALL_KINDS
from scipy.interpolate import CubicSpline
from test_border import camera, images, relative, scene_of, truth

import gpusim as gs
from gpusim.data.weights import electrons_per_content
from gpusim.domain.content import Cube
from gpusim.domain.errors import OutOfRange
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene, unit_light
from gpusim.kernels.optics.far import far
from gpusim.optics.otf import transfer
from gpusim.planner.knobs import border as model
from gpusim.planner.knobs.farfield import FarField

MUST = 1e-5  # relative RMS of a frame whose border goes on to infinity
BAND = 2.5  # times what is predicted that it may be


def seen(monkeypatch, scene, lens, reach, device="numpy"):
    """Mean electrons of a second, and the plan, where so many pixels of surroundings are blurred."""
    monkeypatch.setattr(model, "FAR_REACHES", (reach,))
    monkeypatch.setattr(model, "OVERLAPS", ())
    simulator = gs.Simulator(lens, device=device, tolerance=1e-7 if device == "numpy" else 1e-6)
    exposure = simulator.expose(scene, 1.0)
    assert (
        exposure.plan.find(FarField) is not None
        and f"more than {reach} pixels" in exposure.plan.models["optics.far"]
    )
    return simulator.device.numpy(exposure.mean), exposure.plan


def judged(monkeypatch, q, reach, border, pupils):
    """Errors of frames by round pupils, of obscurations, each of another kind of scene: right, and as predicted."""
    random, margin = np.random.default_rng(int(10 * q)), 7 if border == "scene" else 0
    for hole, kind in pupils:
        scene = scene_of(images(kind, (70 + 2 * margin, 91 + 2 * margin), random), border, margin)
        lens = camera(
            q,
            {"pupil": Pupil(obscuration=hole)} if hole else None,
            "phone" if kind == "blocks" else "mono",
        )
        mean, plan = seen(monkeypatch, scene, lens, max(reach, 32) if hole else reach)
        own = truth(scene, plan, hole=hole)
        error, predicted = relative(mean - own, own), plan.account.bounds["border"].rms
        print(
            f"q {q}, reach {reach}, {border}, {kind}, hole {hole}: {error:.1e}, predicted {predicted:.1e}"
        )
        # the light of rims nearer to one another rings farther: more of it, as is predicted
        assert error < (6 if hole else 1) * MUST
        assert error < BAND * predicted


@pytest.mark.parametrize(
    "q, reach, border, pupils",
    [
        (2.0, 16, "edge", [(0.0, "leaves")]),
        (6.0, 96, "reflect", [(0.0, "blocks"), (0.3, "edge")]),
        (6.0, 96, "scene", [(0.5, "leaves")]),
        (2.0, 32, "zero", [(0.3, "edge")]),
    ],
)
def test_frames_of_a_world_without_end(monkeypatch, q, reach, border, pupils):
    judged(monkeypatch, q, reach, border, pupils)


@pytest.mark.slow
@pytest.mark.parametrize("q, reach", [(0.5, 16), (1.1, 16), (2.0, 16), (2.0, 32), (6.0, 96)])
@pytest.mark.parametrize("border", ["edge", "reflect", "zero", "scene"])
def test_frames_of_a_world_without_end_at_length(monkeypatch, q, reach, border):
    """Clear pupils are within 1e-5 everywhere."""
    judged(
        monkeypatch,
        q,
        reach,
        border,
        [(0.0, "leaves"), (0.3, "edge"), (0.5, "leaves"), (0.0, "blocks")],
    )


@pytest.mark.parametrize(
    "q, reach, seed", [(3.0, 16, 1), (2.0, 16, 2), pytest.param(4.0, 32, 3, marks=pytest.mark.slow)]
)
def test_points_of_light_are_seen_where_the_transform_repeats_them(monkeypatch, q, reach, seed):
    """Their waves are most of the error, which is told within 2.5; without them it is told too low."""
    random = np.random.default_rng(seed)
    picture = images("leaves", (70, 91), random)
    picture[:, random.integers(8, 62, 9), random.integers(8, 83, 9)] *= 60
    scene = scene_of(picture, "zero")
    mean, plan = seen(monkeypatch, scene, camera(q, None, "mono"), reach)
    own = truth(scene, plan)
    error, predicted = relative(mean - own, own), plan.account.bounds["border"].rms
    print(f"q {q}, reach {reach}: {error:.1e}, predicted {predicted:.1e}")
    assert predicted / BAND < error < BAND * predicted
    monkeypatch.setattr("gpusim.planner.knobs.farfield._image_error", lambda *_: 0.0)
    _, without = seen(monkeypatch, scene, camera(q, None, "mono"), reach)
    assert without.account.bounds["border"].rms < error / 1.5


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("border", ["edge", "zero"])
def test_devices_see_the_same_world(monkeypatch, device, border):
    """Float32 transforms beside it: 2.5e-7."""
    scene = scene_of(images("leaves", (63, 90), np.random.default_rng(5)), border)
    mean, plan = seen(monkeypatch, scene, camera(1.5, name="phone"), 32, device)
    own = truth(scene, plan)
    print(f"{device}, {border}: {relative(mean - own, own):.1e}")
    assert relative(mean - own, own) < MUST


def test_what_comes_from_infinity_counts(monkeypatch):
    """What no Gaussian of a few frames' width tells of a world that goes on as its edge."""
    from gpusim.planner.knobs import farfield

    scene, lens = scene_of(images("edge", (70, 91), np.random.default_rng(2)), "edge"), camera(1.1)
    mean, plan = seen(monkeypatch, scene, lens, 16)
    whole = relative(mean - truth(scene, plan), truth(scene, plan))
    all_of_them = farfield.energies
    monkeypatch.setattr(
        farfield,
        "energies",
        lambda sigmas, tails, border=None: (
            all_of_them(sigmas, tails, border) * (np.isfinite(sigmas) if border else 1)
        ),
    )
    mean, plan = seen(monkeypatch, scene, lens, 16)
    assert relative(mean - truth(scene, plan), truth(scene, plan)) > 10 * whole


@pytest.mark.parametrize(
    "waves, q, reach",
    [
        (2.0, 1.1, 64),
        pytest.param(0.5, 1.1, 32, marks=pytest.mark.slow),
        pytest.param(1.0, 0.7, 32, marks=pytest.mark.slow),
    ],
)
def test_defocus_spreads_the_tail(monkeypatch, waves, q, reach):
    """Rays land up to 4 waves q from the image: three powers of the distance, down to the same error."""
    scene, own = scene_of(images("leaves", (80, 75), np.random.default_rng(3)), "edge"), camera(q)
    metres = 600e-9 * waves  # at the longer wavelength
    lens = camera(q, {"defocus": 8 * own.optics.f_number**2 * metres})
    mean, plan = seen(monkeypatch, scene, lens, reach)
    expected = truth(scene, plan, waves=(waves * 600 / 500, waves))
    error, predicted = relative(mean - expected, expected), plan.account.bounds["border"].rms
    print(f"{waves} waves, q {q}, reach {reach}: {error:.1e}, predicted {predicted:.1e}")
    assert error < MUST
    assert predicted > error / 2.5


@pytest.mark.parametrize("device", ALL_KINDS[1:])
def test_small_frames_and_narrow_gaussians_are_refused(device):
    small, own = np.ones((1, 7, 9), np.float32), np.ones((1, 9, 9), np.float32)
    pattern, sigmas = np.zeros((1, 1), np.int32), np.array([8.0, np.inf])
    with pytest.raises(OutOfRange, match="9 x 7 samples"):
        far(small[0], small, np.ones((1, 1, 2)), sigmas, pattern, "edge", device=device)
    with pytest.raises(OutOfRange, match="growing ones from 4 samples on"):
        far(own[0], own, np.ones((1, 1, 2)), sigmas / 3, pattern, "edge", device=device)


COMA = (0,) * 6 + (0.05,)
ASIDE = {"displaced": ({"offset": (0.4, -0.3)}, {}), "coma": ({}, {"wavefront": Wavefront(COMA)})}


def columns(own, bands, row, weights, offset):
    """Light of each column of an endless world whose rows are all `row` and go on: by a transform of 2^16 columns.

    Along the rows only frequencies across count. The step at the other end is 3e4 columns away. Two places a column
    hold all frequencies.
    """
    length, n, pitch = 2**16, len(row), own.sensor.pixel_pitch
    before = (length - n) // 2
    world = np.zeros(2 * length)
    world[::2] = 2 * np.pad(row.astype(float), (before, length - n - before), mode="edge")
    f = np.arange(length + 1) / length  # cycles a column
    few, total = np.linspace(0, 1, 1500), 0.0
    for band, weight in zip(bands, weights, strict=True):
        q = band * 1e-9 * own.optics.working_f_number / pitch
        waves = own.optics.waves(np.array([band]))
        some = transfer(own.optics.pupil, waves, few, 0 * few)[0]
        passed = CubicSpline(few, some)(np.minimum(f * q, 1)) * (f * q < 1)
        # the pixel's aperture, and its place
        passed = passed * np.sinc(f * own.sensor.aperture[1] / pitch)
        passed = passed * np.exp(2j * np.pi * f * offset)
        total = total + weight * np.fft.irfft(np.fft.rfft(world) * passed)[::2]
    return total[before : before + n]


@pytest.mark.parametrize("name", ASIDE)
def test_light_from_afar_that_is_not_round(name):
    """Displaced pixels, and coma, before an edge without end, which the frame knows only by its border's rule."""
    sensor, optics = ASIDE[name]
    made = gs.open_camera("machine-vision")
    own = dataclasses.replace(
        made,
        sensor=dataclasses.replace(made.sensor, **sensor),
        optics=dataclasses.replace(
            made.optics,
            f_number=1.2 * made.sensor.pixel_pitch / 550e-9,
            relative_illumination="none",
            object_distance=np.inf,
            **optics,
        ),
    )
    bands = np.array([530.0, 570.0])
    values = np.full((2, 48, 56), 0.02, np.float32)
    values[:, :, 34:] = 1
    scene = Scene(Cube(bands, values), unit_light(bands), "edge")
    exposures = [
        gs.Simulator(own, device="numpy", tolerance=tolerance).expose(scene, 1.0)
        for tolerance in (2e-5, None)
    ]
    plan = exposures[0].plan
    assert plan.find(FarField) is not None
    cfa, rates = own.sensor.cfa_indices, electrons_per_content(scene, own)
    each = np.stack(
        [
            columns(own, bands, values[0, 0], channel, sensor.get("offset", (0, 0))[1])
            for channel in rates
        ]
    )
    y, x = np.indices(scene.shape)
    truth = each[cfa[y % cfa.shape[0], x % cfa.shape[1]], x]
    wrong, plain = (
        float(np.sqrt(np.mean((np.asarray(one.mean, float) - truth) ** 2) / np.mean(truth**2)))
        for one in exposures
    )
    predicted = plan.account.total.rms
    print(f"{name}: {wrong:.1e}, predicted {predicted:.1e}, without the world beyond {plain:.1e}")
    assert wrong < BAND * predicted and wrong < plain / 5
