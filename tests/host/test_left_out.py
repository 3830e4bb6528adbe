"""Nothing is left out without a bound: the one way to do it, and the places that once did it silently."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lights import as_photons

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.account import STATUS, UNKNOWN, Account, Bound, Tolerance, total, worst_state
from gpusim.domain.errors import BadData, NotMet
from gpusim.optics.depth import DepthPlan

ROOT = Path(gs.__file__).parent
WHITE = Tolerance.parse("video")


def test_there_is_one_way_to_leave_something_out():
    """No file but planner/question.py adds to `left_out` or to `beside`, and every call gives words and a bound."""
    calls = 0
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "leave_out":
                calls += 1
                assert len(node.args) >= 2, f"{path}:{node.lineno}"
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and path.name != "question.py"
            ):
                changes = node.func.attr in ("append", "extend", "insert")
                assert not (changes and getattr(node.func.value, "attr", "") == "left_out"), (
                    f"{path}:{node.lineno}"
                )
    assert calls >= 10


@pytest.mark.parametrize(
    ("bounds", "doubt", "state"),
    [
        ({"planes": Bound(1e-4, 0.01, 0.01)}, "", "met"),
        ({"planes": Bound(1e-4, 0.01, 0.01), "depth": UNKNOWN}, "", "not judged"),
        (
            {"planes": Bound(1e-4, 1.0, 1.0), "depth": UNKNOWN},
            "",
            "not met",
        ),  # what is known breaks it already
        ({"planes": Bound(1e-4, 0.01, 0.01)}, "it is small", "not judged"),
        ({"planes": Bound(1e-4, 1.0, 1.0)}, "it is small", "not met"),
    ],
)
def test_states_of_a_verdict(bounds, doubt, state):
    account = Account(bounds, doubt=doubt)
    for one in (account, account.at(0.5), account.at(2.0)):
        verdict = one.verdict(WHITE, "more would")
        assert verdict.state == state and verdict.is_met == (state == "met")
    verdict = account.verdict(WHITE, "more would")
    assert str(verdict).startswith(
        {"met": "met: ", "not met": "NOT met: ", "not judged": "cannot be judged: "}[state]
    )
    if state == "not judged":
        assert verdict.unknown == ((doubt,) if doubt else ("depth",)) and verdict.unknown[0] in str(
            verdict
        )
    assert total(bounds.values()).is_known  # figures are those of the known causes


def test_unknown_errors_are_null_in_json():
    plain = Account({"depth": UNKNOWN}).as_dict()
    assert plain["bounds"]["depth"] == {"rms": None, "p999_sigma": None, "max_sigma": None}


def test_the_worst_state():
    assert worst_state(["met", "not judged", "met"]) == "not judged"
    assert worst_state(["not judged", "not met"]) == "not met" and worst_state([]) == "met"
    assert [STATUS[state] for state in ("met", "not met", "not judged")] == [0, 1, 3]


def scene_with_depth(near=0.4, far=2.0, size=(96, 64)):
    scene = gs.chart("deadleaves", size=size, seed=3)
    depth = np.full(size[::-1], far, np.float32)
    depth[:, size[0] // 2 :] = near
    return replace(scene, depth=depth)


def camera_with(kind):
    camera = gs.open_camera("phone").with_(object_distance_m=2.0, exposure_time_ms=5)
    rows, cols = 64, 96
    if kind == "calibration":  # a pinhole without any coefficient
        lens = {
            "distortion": gs.Calibration(cols, rows, 2000.0, 2000.0, (cols - 1) / 2, (rows - 1) / 2)
        }
    elif kind == "measured":
        psf = gs.PointSpread(np.array([380.0, 780.0]), np.ones((2, 3, 3)), 1.4e-6, integrated=True)
        lens = {"model": "measured", "psf": psf}
    return replace(camera, optics=replace(camera.optics, **lens))


@pytest.mark.parametrize("kind", ["calibration", "measured"])
def test_depth_next_to_a_real_lens_is_seen(kind):
    """Halves at 2.0 and 0.4 m, focus at 2 m: the circle of confusion is (f/N) s (1/2 - 1/0.4) / pitch, 5.4 pixels."""
    camera, scene = camera_with(kind), scene_with_depth()
    plan = gs.Simulator(camera, device="numpy", tolerance="video").plan(scene)
    assert plan.find(DepthPlan) and not any(line.startswith("depth: ") for line in plan.left_out)
    image = 1 / (1 / camera.optics.focal_length - 1 / 2)
    wide = camera.optics.focal_length / camera.optics.f_number * image * (1 / 2 - 1 / 0.4)
    assert plan.find(DepthPlan).kernels.min() == pytest.approx(
        wide / camera.sensor.pixel_pitch, rel=1e-6
    )
    if kind == "measured":  # at one distance: the rest is a model
        assert plan.verdict.state != "met"
        assert not plan.account.bounds["distance of measured spreads"].is_known


def test_depth_in_focus_next_to_a_real_lens_is_met():
    """All of it 2 m away, so no wave out of focus."""
    plan = gs.Simulator(camera_with("calibration"), device="numpy", tolerance=1e-2).plan(
        scene_with_depth(2.0, 2.0)
    )
    assert plan.verdict.is_met, str(plan.verdict)


def test_depth_through_a_pinhole_s_calibration_is_the_ideal_lens_s():
    """Every sample is its own place, so only rounding of places and of the flux factor, 1e-5 each, may differ."""
    ideal = gs.open_camera("phone").with_(object_distance_m=2.0, exposure_time_ms=5)
    optics = replace(ideal.optics, relative_illumination="none")
    ideal, found = replace(ideal, optics=optics), camera_with("calibration")
    found = replace(found, optics=replace(found.optics, relative_illumination="none"))
    wanted, found = (
        np.asarray(gs.Simulator(one, device="numpy").expose(scene_with_depth()).mean)
        for one in (ideal, found)
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-3)


@pytest.mark.parametrize(
    "setting",
    [
        {"defocus": 4e-6},
        {"wavefront": gs.open_camera("phone").optics.wavefront.__class__((0, 0, 0, 0.05))},
        {"wavefront": gs.open_camera("phone").optics.wavefront.__class__(seidel=(0.1, 0, 0, 0, 0))},
        {"birefringence": (1e-6, 0.0)},
        {"diffuser": 1e-6},
        {"lateral_color": 1e-4},
        {"pupil": gs.open_camera("phone").optics.pupil.__class__(blades=6)},
        {"pupil": gs.open_camera("phone").optics.pupil.__class__(obscuration=0.3)},
    ],
    ids=str,
)
def test_measured_spreads_refuse_what_they_would_ignore(setting):
    optics = camera_with("measured").optics
    with pytest.raises(
        BadData, match=r'with model = "measured" the point spreads hold it.*leave it out'
    ):
        replace(optics, **setting)


def test_a_field_of_view_that_is_replaced_cannot_be_judged():
    scene = replace(gs.chart("deadleaves", size=(96, 64), seed=3), fov=np.radians(60))
    plan = gs.Simulator(camera_with("calibration"), device="numpy", tolerance=1e-2).plan(scene)
    assert plan.verdict.state == "not judged" and "field of view" in str(plan.verdict)
    with pytest.raises(NotMet, match="cannot be judged"):
        gs.Simulator(camera_with("calibration"), device="numpy", tolerance=1e-2, strict=True).plan(
            scene
        )


def test_light_outside_the_wavelengths_has_a_figure():
    """A flat cube of 500 .. 600 nm in steady light: electrons outside over those inside by a trapezoid sum."""
    from gpusim.domain.content import Cube
    from gpusim.domain.scene import Scene

    nodes = np.linspace(500.0, 600.0, 11)
    light = as_photons("D65")
    camera = gs.open_camera("phone")
    plan = gs.Simulator(camera, device="numpy").plan(
        Scene(Cube(nodes, np.ones((11, 16, 16), np.float32)), light)
    )
    fine = np.linspace(camera.sensor.qe.wavelengths[0], camera.sensor.qe.wavelengths[-1], 20001)
    seen = camera.sensor.qe.at(fine).sum(axis=0) * camera.optics.transmission_at(fine)
    electrons = light.at(fine, outside=None) * seen
    inside = (fine >= 500) & (fine <= 600)
    # steps of 1 nm against 0.02 nm, of a table of 1 to 10 nm: percents at the two edges
    assert plan.beside["light outside the wavelengths"] == pytest.approx(
        electrons[~inside].sum() / electrons[inside].sum(), rel=0.03
    )


def test_the_first_line_without_a_tolerance_says_the_border_error():
    """An endless edge: the world beyond what the transforms see is not there (finding T14)."""
    frame = gs.Simulator(gs.open_camera("phone"), device="numpy")(
        gs.chart("slanted-edge", size=(96, 64))
    )
    first, border = str(frame.report).split("\n")[0], frame.report.account.bounds["border"]
    assert first.startswith("no tolerance given: ") and f"border: {border.rms:.2g}" in first
    with_one = gs.Simulator(gs.open_camera("phone"), device="numpy", tolerance="video")(
        gs.chart("slanted-edge", size=(96, 64))
    )
    assert str(with_one.report).startswith("tolerance met: ")


def test_a_blur_that_is_left_out_is_not_the_camera_s_choice():
    """The camera has a lens that blurs: its report names the blur's error, not a setting that it does not have."""
    scene = gs.chart("slanted-edge", size=(96, 64))
    for model, words in (("diffraction", "blur: relative rms"), ("none", "optics.model is")):
        camera = gs.open_camera("mono").with_(model=model)
        left = gs.Simulator(camera, device="numpy", tolerance=1e-1).plan(scene).left_out
        [reported] = [one for one in left if "blur" in one or "optics.model" in one]
        assert words in reported


def test_plan_has_three_exit_statuses(tmp_path, capsys):
    camera = tmp_path / "calibrated.toml"
    camera.write_text('base = "phone"\n[optics]\ncalibration = "camera.yaml"\n')
    (tmp_path / "camera.yaml").write_text(
        "image_width: 96\nimage_height: 64\ndistortion_model: plumb_bob\ncamera_matrix:\n  data: "
        "[2000, 0, 47.5, 0, 2000, 31.5, 0, 0, 1]\ndistortion_coefficients:\n  data: [0, 0, 0, 0, 0]\n"
    )
    common = ["plan", "deadleaves", "--size", "96x64", "--device", "numpy", "--camera"]
    assert main([*common, "phone", "--tolerance", "1e-2"]) == 0
    assert main([*common, "phone", "--tolerance", "1e-9"]) in (1, 2)
    assert main([*common, str(camera), "--tolerance", "1e-2", "--fov", "60"]) == 3
    assert "cannot be judged: field of view" in capsys.readouterr().out
    assert main([*common, str(camera), "--tolerance", "1e-2", "--fov", "60", "--strict"]) == 2
    assert "cannot be judged" in capsys.readouterr().err


@pytest.mark.parametrize("size", [1, 3, 8])
def test_layers_in_focus_are_the_flat_picture(size):
    """A sheet in the plane of what it covers, all in focus: the frame must be that of the flat picture."""
    from gpusim.domain.content import Cube
    from gpusim.domain.scene import Layer, Scene

    random, wavelengths = np.random.default_rng(2), np.array([450.0, 550.0, 650.0])
    behind, front = (
        random.random((3, 64 // size, 96 // size))
        .repeat(size, 1)
        .repeat(size, 2)
        .astype(np.float32)
        for _ in range(2)
    )
    rows, cols = behind.shape[1:]
    alpha = np.zeros((rows, cols), np.float32)
    alpha[:, : cols // 2] = 1
    light, depth = as_photons("D65"), np.full((rows, cols), 2.0)
    layers = (Layer(Cube(wavelengths, front), alpha, 2.0),)
    camera = gs.open_camera("phone").with_(object_distance_m=2.0, exposure_time_ms=5)
    simulate = gs.Simulator(camera, device="numpy", tolerance=1e-3)
    layered = simulate.expose(Scene(Cube(wavelengths, behind), light, layers=layers, depth=depth))
    flat = simulate.expose(Scene(Cube(wavelengths, np.where(alpha > 0, front, behind)), light))
    error = np.asarray(layered.mean) - np.asarray(flat.mean, np.float64)
    true = np.sqrt(np.mean(error**2) / np.mean(np.square(flat.mean, dtype=np.float64)))
    # both frames may err by the tolerance, and each does by about 6e-5; the product of blurred layers erred by 4e-3
    assert true < 2e-4 and layered.plan.verdict.is_met
