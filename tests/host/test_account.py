"""The account of a plan's errors: how they add up, when a tolerance is met, and what is left out by it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cameras import PHONE

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.account import SAFETY, Account, Bound, Tolerance, total
from gpusim.domain.content import Cube
from gpusim.domain.errors import NotMet
from gpusim.domain.pupil import Pupil
from gpusim.domain.scene import Scene, unit_light
from gpusim.optics.lengths import Tiling
from gpusim.optics.windows import Windows
from gpusim.planner.choices import Blur
from gpusim.planner.knobs.farfield import FarField, ring_errors
from gpusim.planner.knobs.pixels import without_negligible
from gpusim.planner.plan import plan
from gpusim.planner.probes import INNER, RIM, SIDE
from gpusim.planner.search import HEADROOM, WIDER, cost_of


def test_errors_of_independent_causes_add_in_the_mean_square():
    found = total([Bound(3.0, 0.3, 1.5), Bound(4.0, 0.4, 2.0)])
    assert found.rms == pytest.approx(5) and found.p999_sigma == pytest.approx(0.5)
    assert found.max_sigma == pytest.approx(2.5) and total([]) == Bound()


@pytest.mark.parametrize(
    ("tolerance", "met", "unit"),
    [
        (Tolerance(rms=SAFETY * 5.01e-4), True, " rms"),
        (Tolerance(rms=SAFETY * 4.99e-4), False, " rms"),
        (Tolerance(rms=1.0, p999_sigma=SAFETY * 0.49), False, " sigma at 99.9 %"),
        (Tolerance(rms=1.0, p999_sigma=SAFETY * 0.51), True, " sigma at 99.9 %"),
        (Tolerance(p999_sigma=10.0, max_sigma=SAFETY * 2.2), False, " sigma"),
    ],
)
def test_a_verdict_names_the_figure_that_binds_and_the_cause(tolerance, met, unit):
    account = Account({"border": Bound(3e-4, 0.3, 1.0), "planes": Bound(4e-4, 0.4, 2.0)})
    verdict = account.verdict(tolerance, "more would")
    assert verdict.is_met is met and verdict.by == "planes"
    assert f"{unit}, predicted" in str(verdict) and str(verdict).startswith(
        "met" if met else "NOT met: "
    )
    assert ("more would" in str(verdict)) is not met and (
        "most of it planes" in str(verdict)
    ) is not met


def test_sigmas_at_another_time_are_not_less_than_they_are():
    """Signal S and error E of the same pixel: E t / sqrt(S t + r^2), whatever the read noise r."""
    for read in (0.0, 3.0, 1e4):

        def sigma(seconds, read=read):
            return 2.0 * seconds / np.sqrt(1e3 * seconds + read**2)

        account = Account({"planes": Bound(1e-3, sigma(0.01), sigma(0.01))}, 0.01)
        for seconds in (1e-4, 0.005, 0.01, 0.02, 1.0):
            moved = account.at(seconds).bounds["planes"]
            assert moved.rms == 1e-3 and moved.p999_sigma >= sigma(seconds) * (1 - 1e-9)


@pytest.mark.parametrize("shape", [(40, 40), (41, 79), (7, 300), (500, 333)])
@pytest.mark.parametrize(("border", "margin"), [("edge", 0), ("zero", 0), ("scene", 5)])
def test_windows_stand_for_the_frame(shape, border, margin):
    """They lie in the frame, their weights add up to one, and where there are few every sample is in one."""
    random = np.random.default_rng(3)
    light = random.random([n + 2 * margin for n in shape], np.float32)
    for count in (1, 5, 12, 10**6):
        windows = Windows.of(light, margin, border, count, SIDE, RIM)
        assert windows.weight.sum() == pytest.approx(1) and windows.steepest >= 1
        assert len(windows.rows) <= count
        seen = np.zeros(light.shape, bool)
        for y, x in zip(windows.rows[:, RIM:-RIM], windows.cols[:, RIM:-RIM], strict=True):
            inner = np.ix_(np.clip(y, 0, light.shape[0] - 1), np.clip(x, 0, light.shape[1] - 1))
            seen[inner] = True
        if count == 10**6:
            assert seen[margin : margin + shape[0], margin : margin + shape[1]].all()
    assert INNER == windows.rows.shape[1] - 2 * RIM


def test_the_means_of_windows_are_those_of_the_frame():
    """Of many draws: a picture whose edges are in one corner; the mean of squares is unbiased to its own spread."""
    random = np.random.default_rng(4)
    ratios = []
    for _ in range(60):
        light = np.ones((400, 600), np.float32)
        y, x = random.integers(0, 200, 2)
        light[y : y + 150, x : x + 250] += random.random((150, 250), np.float32)
        squares = np.square(light - 1)
        windows = Windows.of(light, 0, "edge", 12, SIDE, RIM)
        found = sum(
            weight
            * squares[
                np.ix_(np.clip(rows[RIM:-RIM], 0, 399), np.clip(cols[RIM:-RIM], 0, 599))
            ].mean()
            for rows, cols, weight in zip(windows.rows, windows.cols, windows.weight, strict=True)
        )
        ratios.append(found / squares.mean())
    assert (
        abs(np.mean(ratios) - 1) < 4 * np.std(ratios) / np.sqrt(len(ratios)) + 0.05
        and np.std(ratios) < 0.3
    )


def test_fixed_patterns_far_below_a_tolerance_are_left_out():
    def sensor(**noise):
        return replace(PHONE.sensor, noise=replace(PHONE.sensor.noise, **noise))

    most = 0.5 / 10 / 3.3 / np.sqrt(PHONE.sensor.saturation)
    preview = Tolerance(p999_sigma=0.5)
    for prnu, stays in ((1.01 * most, True), (0.99 * most, False)):
        found, words = without_negligible(sensor(prnu=prnu, dsnu=1.0), preview)
        assert bool(found.noise.prnu > 0) is stays and found.noise.dsnu == 1.0
        assert any("PRNU" in line for line in words) is not stays
    own = sensor(prnu=1e-9, dsnu=1e-9)
    assert without_negligible(own, None) == (own, [])
    found, words = without_negligible(own, Tolerance(rms=1e-3))
    assert found.noise.prnu == 0 and found.noise.dsnu == 1e-9 and len(words) == 1
    report = gs.Simulator(replace(PHONE, sensor=own), device="numpy", tolerance="preview")(
        gs.chart("colorchecker", size=(24, 16))
    ).report
    assert any("PRNU" in line for line in report.left_out) and "sensor.pattern" not in {
        s.stage for s in report.stages
    }


@pytest.mark.parametrize(
    "camera",
    [PHONE, replace(PHONE, optics=replace(PHONE.optics, f_number=8.0)), gs.open_camera("mono")],
    ids=["phone", "f/8", "mono"],
)
@pytest.mark.parametrize("form", ["colorchecker", "slanted-edge", "deadleaves"])
def test_no_plan_costs_more_than_the_exact_one_and_none_more_where_less_is_asked(camera, form):
    scene = gs.chart(form, size=(96, 64))
    exact = gs.Simulator(camera, device="numpy").plan(scene)
    most = _cost(exact)
    before = np.inf
    for rms in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1):
        plan = gs.Simulator(camera, device="numpy", tolerance=rms).plan(scene)
        cost = _cost(plan)
        suffices = HEADROOM * SAFETY * exact.account.total.ratio(Tolerance(rms=rms)) <= 1
        if plan.find(FarField) is None or suffices:
            assert cost <= most
        else:  # the exact frame breaks this tolerance at its border: the same with a world without end does not
            many = replace(plan.find(Blur), mix=exact.find(Blur).mix)
            assert cost <= min(_cost(plan.exchange(many)), WIDER * most)
        if plan.verdict.is_met:  # what is not met is as accurate as it can be
            assert cost <= before
            before = cost


def _cost(plan):
    if plan.find(Blur) is None:
        return 0.0
    asked = SimpleNamespace(
        on_gpu=False,
        content=plan.content,
        weights=plan.weights,
        size=plan.content.shape,
        scene=plan.scene,
    )
    around = SimpleNamespace(period=plan.period, far=plan.find(FarField), tiling=plan.find(Tiling))
    return cost_of(asked, plan.count, around, plan.find(Blur).folded)


def test_a_flat_scene_is_not_blurred_and_an_exact_one_is():
    wavelengths = np.arange(400.0, 701.0, 10.0)
    flat = Scene(Cube(wavelengths, np.ones((31, 40, 50), np.float32)), unit_light(wavelengths))
    plan = gs.Simulator(PHONE, device="numpy", tolerance=1e-5).plan(flat)
    assert plan.find(Blur) is None and any(
        line.startswith("blur: relative rms") for line in plan.left_out
    )
    assert gs.Simulator(PHONE, device="numpy").plan(flat).find(Blur) is not None
    dark = replace(flat, border="zero")  # beside a dark world the blur is seen
    assert gs.Simulator(PHONE, device="numpy", tolerance=1e-5).plan(dark).find(Blur) is not None


def test_strict_refuses_in_one_line_what_is_not_met(tmp_path, capsys):
    scene = gs.chart("slanted-edge", size=(96, 64))
    hexagon = replace(
        PHONE, optics=replace(PHONE.optics, pupil=Pupil(blades=6))
    )  # its light from afar is no blur
    with pytest.raises(
        NotMet, match=r"^slanted-edge: tolerance NOT met: .* of 1e-05 rms.*border.*reach"
    ):
        gs.Simulator(hexagon, device="numpy", tolerance=1e-5, strict=True)(scene)
    assert gs.Simulator(PHONE, device="numpy", tolerance=1e-2, strict=True)(
        scene
    ).report.verdict.is_met
    asked = [
        "slanted-edge",
        "--size",
        "96x64",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--tolerance",
        "1e-8",
    ]
    out = tmp_path / "a.png"
    assert main(["simulate", *asked, "--strict", "-o", str(out)]) == 2 and not out.exists()
    assert capsys.readouterr().err.count("\n") == 1


def test_a_plan_is_printed_and_written(tmp_path, capsys):
    path = tmp_path / "plan.json"
    asked = [
        "plan",
        "deadleaves",
        "--size",
        "96x64",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--json",
        str(path),
    ]
    assert main([*asked, "--tolerance", "1e-2"]) == 0
    text, found = capsys.readouterr().out, json.loads(path.read_text())
    assert text.startswith("tolerance met") and "error: all together" in text and "(chosen)" in text
    assert (
        found["verdict"]["met"]
        and found["front"]
        and found["frame_ms"] == pytest.approx(sum(found["ms"].values()))
    )
    assert [row["ms"] for row in found["front"]] == sorted(row["ms"] for row in found["front"])
    assert main([*asked, "--tolerance", "1e-8"]) == 1 and "NOT met" in capsys.readouterr().out
    for wrong in ("0", "-1", "nan", "soon"):
        assert main([*asked, "--tolerance", wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("rms", [3e-2, 1e-3, 1e-4])
def test_the_first_of_the_front_that_meets_is_chosen_and_dearer_ones_are_not_judged_before(
    monkeypatch, rms
):
    judged = []

    def counted(*given):
        judged.append(given[2])
        return ring_errors(*given)

    monkeypatch.setattr("gpusim.planner.knobs.border.ring_errors", counted)
    tolerance = Tolerance(rms=rms)
    made = plan(gs.chart("colorchecker", size=(320, 200)), PHONE, tolerance=tolerance)
    before = len(judged)
    good = [one for one in made.front if HEADROOM * SAFETY * one.error.ratio(tolerance) <= 1]
    assert made.verdict.is_met and before <= 1 < len(judged)
    assert (good[0].planes, good[0].tiling, good[0].period) == (
        made.count,
        made.find(Tiling),
        made.period,
    )
    assert (good[0].far is None) == (made.find(FarField) is None)
    assert all(
        one.error.ratio(tolerance) > other.error.ratio(tolerance)
        for one, other in zip(made.front, made.front[1:], strict=False)
    )


def test_a_lens_that_varies_over_a_small_frame_is_not_vouched_for():
    """Though its predicted error is far within the tolerance."""
    lateral = gs.Spectrum(np.array([400.0, 700.0]), np.array([-1e-3, 1e-3]))
    camera = replace(PHONE, optics=replace(PHONE.optics, lateral_color=lateral))
    verdict = (
        gs.Simulator(camera, device="numpy", tolerance=0.5)
        .plan(gs.chart("colorchecker", size=(96, 64)))
        .verdict
    )
    assert not verdict.is_met and "varies over a frame of less than 400" in str(verdict)


def test_a_plan_is_made_for_the_exposure_time_that_is_asked_for():
    """In the dark a picture errs by few sigmas; exposed longer, the same planes would break the tolerance."""
    scene, simulator = (
        gs.chart("deadleaves", size=(96, 64)),
        gs.Simulator(PHONE, device="numpy", tolerance="video"),
    )
    short, long = (simulator.loop(scene, seconds).plan for seconds in (1e-4, 0.1))
    assert short.count <= long.count
    loop = simulator.loop(scene, 1e-4)
    assert loop.plan is loop.plan
    assert _cost(loop.plan) < _cost(loop.update(exposure_time=0.1).plan)


def test_what_float32_cannot_hold_float64_does():
    """As the remedy says: an even scene, of which nothing but rounding errs."""
    wavelengths = np.arange(400.0, 701.0, 10.0)
    flat = Scene(Cube(wavelengths, np.ones((31, 40, 50), np.float32)), unit_light(wavelengths))
    tolerance = Tolerance(rms=1e-7)  # 2^-24 / 3^(1/2) is what storing leaves
    verdict = plan(flat, PHONE, tolerance=tolerance).verdict
    assert (
        not verdict.is_met
        and verdict.by in ("rounding", "transforms")
        and "device numpy" in verdict.remedy
    )
    assert plan(flat, PHONE, tolerance=tolerance, single=False).verdict.is_met
    frame = gs.Simulator(PHONE, device="numpy", tolerance=tolerance)(flat, verify=True)
    assert frame.report.verdict.is_met and frame.report.meets_tolerance
