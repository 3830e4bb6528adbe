"""Estimates after the fact: a kept plan is compared with exact values of later scenes, and what missed is remembered.

The truth is `gpusim.judge.truth`: every wavelength by itself in float64, which shares no plan and no window with them.
"""

from dataclasses import replace
from types import SimpleNamespace

import cameras
import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from scipy.ndimage import gaussian_filter

import gpusim as gs
from gpusim.domain.account import SAFETY
from gpusim.domain.content import Basis
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.pupil import Pupil
from gpusim.domain.scene import unit_light
from gpusim.judge.truth import true_error
from gpusim.optics.fusion import Surveyed, Watch
from gpusim.pipeline.planning import probe_plan
from gpusim.pipeline.probing import Probing, kind_of
from gpusim.planner.choices import Blur
from gpusim.planner.facts import Facts
from gpusim.planner.plan import Plan

CAMERA, SIZE, SECONDS = gs.open_camera("phone"), (160, 120), 0.01
TOLERANCE = gs.Tolerance(p999_sigma=0.02)
LEAVES = gs.chart("deadleaves", size=SIZE)
LIGHT = unit_light(LEAVES.wavelengths)
SPECTRA = np.ascontiguousarray(LEAVES.content.bands_at(slice(None)), np.float32)
MEAN = SPECTRA.mean((1, 2), keepdims=True)
DUE = (1, 5, 18, 58)  # each 3 n + 1 after the one before: 1, 4, 13, 40


def scene_of(values, name):
    return gs.Scene(
        gs.Cube(LEAVES.wavelengths, np.ascontiguousarray(values, np.float32)),
        LEAVES.illuminant,
        name=name,
    )


def even(name="even"):
    """Edges of a quarter of the contrast all over the frame."""
    return scene_of(MEAN + 0.25 * (SPECTRA - MEAN), name)


def local(name="local"):
    """Whole contrast in a small part of the frame alone, about as much in the mean square."""
    inside = np.zeros(SIZE[::-1], bool)
    inside[30:53, 40:68] = True
    return scene_of(np.where(inside, SPECTRA, MEAN), name)


def made(device, tolerance=TOLERANCE, camera=CAMERA):
    return gs.Simulator(camera, device=device, tolerance=tolerance)


def errs(loop):
    return true_error(loop.simulator, loop.scene, loop.exposure)


@pytest.fixture
def unprobed(monkeypatch):
    """A function after whose call the survey is all that looks at later scenes."""
    return lambda: monkeypatch.setattr(Probing, "is_due", lambda *_: False)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_an_error_at_a_few_pixels_is_silent_without_probes(device, unprobed):
    """As large in the root mean square as that of the plan's own scene, and beyond the tolerance in sigmas."""
    unprobed()
    loop = made(device).loop(even(), SECONDS)
    first, own = loop.plan, errs(loop)
    assert first.verdict.is_met
    error = errs(loop.update(scene=local()))
    loop.judge()
    assert loop.plan is first
    assert error.rms < 1.1 * own.rms
    assert error.p999_sigma > TOLERANCE.p999_sigma > 2 * own.p999_sigma
    assert loop.frame().report.verdict.is_met  # which it is not


@pytest.mark.parametrize("device", ALL_KINDS)
def test_an_error_at_a_few_pixels_is_found_before_the_frame(device):
    loop = made(device).loop(even(), SECONDS)
    planes = loop.plan.count
    loop.raw()
    assert errs(loop.update(scene=local())).p999_sigma < TOLERANCE.p999_sigma
    assert loop.plan.count > planes
    report = loop.frame().report
    assert any(f"probes: {planes} planes would miss: 0.0" in note for note in report.notes)
    wanted = made(device).loop(
        loop.scene, SECONDS
    )  # at once the plan that the scene would have had
    np.testing.assert_array_equal(np.array(wanted.frame().mean), np.array(loop.frame().mean))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_between_probes_the_survey_tells_when(device):
    """A scene that is not due: errors of its rows rise. A report's frame is made anew, a stream's next one is right."""
    for with_report in (True, False):
        loop = made(device).loop(even(), SECONDS)
        loop.raw()
        for number in range(2):
            loop.update(scene=even(f"even {number}")).raw()
        first = loop.plan
        assert loop.before.probing.count == 1
        loop.update(scene=local())
        if with_report:
            assert loop.frame().report.verdict.is_met
            assert loop.plan.scene is loop.scene
        else:
            loop.raw()
            assert loop.plan is first
            loop.update(scene=local("again")).raw()
        assert loop.plan is not first
        assert errs(loop).p999_sigma < TOLERANCE.p999_sigma


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_miss_is_remembered(device):
    """By scenes that would do with less, after scenes of another kind too; not by a camera that has other plans."""
    loop = made(device).loop(even(), SECONDS)
    few = loop.plan.count
    loop.raw()
    loop.update(scene=local()).raw()
    raised = loop.plan
    assert raised.count > few
    for number in range(3):
        for scene in (even(f"even {number}"), local(f"local {number}")):
            loop.update(scene=scene).raw()
            assert loop.plan is raised
    loop.update(scene=gs.chart("colorchecker", size=(64, 48))).raw()
    loop.update(scene=even()).raw()
    assert loop.plan.scene is loop.scene
    assert loop.plan.count == raised.count
    loop.update(camera=replace(CAMERA, optics=replace(CAMERA.optics, f_number=2.0))).raw()
    loop.update(camera=CAMERA).raw()
    assert loop.plan.count == few


@pytest.mark.parametrize("device", ALL_KINDS)
def test_probes_become_rare_and_change_no_bits(device, monkeypatch):
    """Of 60 scenes that do not change four are probed."""
    simulator = made(device, 1e-3)
    scenes, probed = cameras.cubes(1, (32, 24)) * 61, []
    scenes = [cameras.again(scene, str(number)) for number, scene in enumerate(scenes)]
    found = Probing.found
    monkeypatch.setattr(
        Probing,
        "found",
        lambda self, scene, *more: probed.append(int(scene.name)) or found(self, scene, *more),
    )
    frames = [
        np.array(simulator.device.numpy(frame))
        for frame in simulator.stream(scenes, "raw", seed=1, exposure_time=SECONDS)
    ]
    assert probed == [*DUE]
    monkeypatch.setattr(Probing, "is_due", lambda *_: False)
    for frame, wanted in zip(
        frames, simulator.stream(scenes, "raw", seed=1, exposure_time=SECONDS), strict=True
    ):
        np.testing.assert_array_equal(frame, simulator.device.numpy(wanted))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_plan_without_blur_is_not_kept_for_edges(device):
    """A film that begins with an even frame: whether a scene is probed or surveyed, it is blurred; and ever since."""
    flat = scene_of(np.broadcast_to(MEAN, SPECTRA.shape), "flat")
    for more in (0, 2):
        loop = made(device).loop(flat, SECONDS)
        loop.raw()
        for number in range(more):
            loop.update(scene=cameras.again(flat, f"flat {number}")).raw()
        assert loop.plan.find(Blur) is None
        loop.update(scene=local()).raw()
        if more:  # not due
            assert loop.plan.find(Blur) is None
            loop.judge()
        assert errs(loop).p999_sigma < TOLERANCE.p999_sigma
        loop.update(scene=gs.chart("colorchecker", size=(64, 48))).raw()
        assert loop.update(scene=flat).plan.find(Blur) is not None


def forms():
    """A picture in every form that has more entries than planes."""
    yield LEAVES
    vectors = np.linalg.svd(SPECTRA.reshape(31, -1).astype(np.float64), full_matrices=False)[0][
        :, :20
    ]
    yield replace(
        LEAVES,
        content=Basis(
            LEAVES.wavelengths, np.tensordot(vectors.T, SPECTRA, 1).astype(np.float32), vectors.T
        ),
    )
    yield scene_of(SPECTRA, "cube")


@pytest.mark.parametrize("tolerance", [2e-3, "video"])
@pytest.mark.parametrize("scene", list(forms()), ids=lambda scene: scene.content.form)
def test_probes_tell_the_true_error_of_a_plans_own_planes(scene, tolerance):
    """Of another scene by the plan of this one, upside down: within the safety, and above half of it."""
    simulator = made("opencl", tolerance)
    loop = simulator.loop(scene, SECONDS)
    loop.raw()
    assert loop.plan.find(Watch) is not None
    turned = scene.content.with_samples(lambda array: np.ascontiguousarray(array[..., ::-1, ::-1]))
    report = loop.update(scene=replace(scene, content=turned, name="turned")).frame().report
    assert any("from this scene" in note for note in report.notes)
    error, predicted = errs(loop), report.account.total
    assert 0.5 < SAFETY * predicted.rms / error.rms < SAFETY**2 * 2
    assert error.p999_sigma < SAFETY * predicted.p999_sigma


def test_reports_between_probes_say_when_it_was():
    """And scale what was found by what the survey saw since: another contrast."""
    loop = made("opencl").loop(even(), SECONDS)
    loop.raw()
    found = loop.update(scene=even("probed")).frame().report
    assert any(note == "probes: from this scene" for note in found.notes)
    half = scene_of(MEAN + 0.125 * (SPECTRA - MEAN), "half")
    later = loop.update(scene=half).frame().report
    assert any(
        "probes: from probed, 1 scene ago, scaled by the survey of this scene" in note
        for note in later.notes
    )
    # half the differences, over a mean that is the same but for its variance, which is below 0.25^2 of it
    assert later.account.bounds["planes"].p999_sigma == pytest.approx(
        found.account.bounds["planes"].p999_sigma / 2, rel=0.5 * 0.25**2
    )
    assert later.verdict.is_met


def test_what_rises_now_and_then_is_probed_a_few_times():
    """Two kinds of frames in turn, of which one errs more: a probe for the rise, and no more than for one kind."""
    plan, probing, count = made("numpy").plan(even(), None, SECONDS), Probing(), 0
    probing.set_plan(plan)
    for number in range(1, 1000):
        scene = even(str(number)) if number < 3 else cameras.again(plan.scene, str(number))
        if probing.is_due(plan, scene):
            count += 1
            probing.found(scene, plan.account, True)
        drifts = ((1e-4, 1e-3), (1.3e-4, 1e-3), (1e-4, 1.4e-3))[number % 3]
        probing.add_survey(plan, scene, Surveyed(*drifts, level=1.0))
    assert count < 3 * np.log(1000) / np.log(3)  # the first ones, and after each of two rises


def test_kinds_are_those_that_a_plan_serves():
    plan = made("numpy").plan(even(), None, SECONDS)
    others = [
        even("another"),
        local(),
        gs.chart("colorchecker", size=SIZE),
        replace(even(), border="zero"),
        replace(even(), illuminant=gs.chart("flat", light="A").illuminant),
        scene_of(SPECTRA[:, :40], "smaller"),
        replace(even(), samples_per_pixel=2.0),
    ]
    for other in others:
        assert (kind_of(other) == kind_of(plan.scene)) == plan.serves(other)
    assert sum(map(plan.serves, others)) == 2


@pytest.mark.parametrize(
    "device",
    [
        pytest.param(device, marks=pytest.mark.slow) if device == "numpy" else device
        for device in ALL_KINDS
    ],
)  # half a minute of the reference
def test_what_the_border_breaks_raises_no_planes(device):
    """A survey that finds planes a little worse than probes did says nothing where the border errs ten times that."""
    scenes = [scene_of(SPECTRA * gain, f"times {gain}") for gain in np.float32((1, 1.01))]
    hexagon = replace(CAMERA, optics=replace(CAMERA.optics, pupil=Pupil(blades=6)))
    loop = made(device, 1e-6, hexagon).loop(scenes[0], SECONDS)
    first = loop.plan
    assert not first.verdict.is_met and first.verdict.by == "border"
    for number in range(6):
        loop.update(scene=scenes[number % 2]).raw()
    loop.judge()
    assert loop.plan is first


@pytest.mark.parametrize("device", KINDS)
def test_a_loop_judges_the_sun_as_it_does_a_lamp(device, unprobed, monkeypatch):
    """Light times a power of two, for as much less time, has the same estimates, bit for bit, and the same plans.

    Squares of 1e23 are beyond float32: a signal of infinity made every estimate 0, or no number.
    """
    unprobed()
    told, fits = [], Plan.fits
    monkeypatch.setattr(
        Plan, "fits", lambda plan, light, drift: told[-1].append(drift) or fits(plan, light, drift)
    )
    for factor in (1.0, 2.0**50, 2.0**76):  # the largest is 0.8, 9e14 and 6e22
        told.append([])
        scenes = [
            gs.Scene(
                gs.Cube(LEAVES.wavelengths, np.float32(factor) * np.ascontiguousarray(values)),
                LIGHT,
            )
            for values in (even().content.values, SPECTRA, SPECTRA[:, ::-1], SPECTRA[:, :, ::-1])
        ]
        loop = made(device).loop(scenes[0], 1e12 / factor)
        for scene in scenes:
            loop.update(scene=scene).raw()
    assert max(one for one in told[0] if one is not None) > 0 and told[0] == told[1] == told[2]


def smooth(name="smooth"):
    return scene_of(gaussian_filter(SPECTRA, (0, 4, 4)), name)


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("what", ["distortion", "brightness"])
def test_no_error_of_a_plan_is_taken_from_a_softer_or_darker_scene(device, what):
    """Edges between which a displaced lens interpolates, and light whose shot noise is less, come after others.

    SAFETY is the margin of every verdict.
    """
    tolerance, last = gs.Tolerance(p999_sigma=0.1), scene_of(SPECTRA, "sharp")
    camera = replace(
        CAMERA, optics=replace(CAMERA.optics, distortion=RadialPolynomial(-0.0005, 0.0, 2e-4))
    )
    scenes = [smooth(f"smooth {number}") for number in range(4)]
    if what == "brightness":
        camera, tolerance = CAMERA, gs.Tolerance(p999_sigma=0.01)
        scenes = [scene_of(0.01 * SPECTRA, f"dark {number}") for number in range(4)]
    loop = made(device, tolerance, camera).loop(scenes[0], SECONDS)
    for scene in scenes[1:]:
        assert loop.update(scene=scene).frame().report.verdict.is_met
    report = loop.update(scene=last).frame().report
    true = errs(loop).p999_sigma
    assert SAFETY * report.account.total.p999_sigma > true
    assert report.verdict.is_met <= (true < tolerance.p999_sigma)
    # not by the errors of the scene before
    assert loop.update(scene=scenes[1]).frame().report.verdict.is_met


@pytest.mark.slow
@pytest.mark.parametrize("device", KINDS)
def test_calls_share_a_plan_while_it_fits(device, monkeypatch):
    """As a loop does. A scene whose arrays were written to counts as another one."""
    count, make = [0], gs.pipeline.planning.plan
    monkeypatch.setattr(
        "gpusim.pipeline.planning.plan",
        lambda *args, **asked: count.__setitem__(0, count[0] + 1) or make(*args, **asked),
    )
    camera = CAMERA.with_(exposure_time_ms=1e3 * SECONDS)
    simulate = made(device, gs.Tolerance(p999_sigma=0.05), camera)

    def met(scene, verify=False):
        frame = simulate(scene, verify=verify)
        report = frame.report
        assert report.verdict.is_met
        if verify:
            assert report.meets_tolerance
            assert SAFETY * report.account.total.p999_sigma > report.error.p999_sigma
        return frame

    first = met(smooth())
    for number in range(3):
        frame = met(smooth(f"smooth {number}"), number == 2)
        assert count[0] == 1 and frame.report.plan == first.report.plan
        assert any("smooth" in note for note in frame.report.notes)
    sharp = scene_of(SPECTRA, "sharp")
    met(sharp, True)
    assert count[0] == 2
    turned = met(scene_of(SPECTRA[:, ::-1], "turned"), True)
    sharp.content.values[:] = SPECTRA[:, ::-1]  # the scene of the plan itself
    np.testing.assert_array_equal(np.array(met(sharp).mean), np.array(turned.mean))


def test_views_of_a_content_that_was_probed_are_not_probed(monkeypatch):
    """Displaced and turned ones: a probe of each finds the same bits. One that magnifies the content is probed."""
    simulator, probed = made("numpy", gs.Tolerance(p999_sigma=50)), []
    found = Probing.found
    monkeypatch.setattr(
        Probing,
        "found",
        lambda self, scene, *more: probed.append(scene.name) or found(self, scene, *more),
    )
    views = [gs.View((0.3 + k, 0.2 - 2 * k), 0.1 * k) for k in range(4)]
    own, other = even("own"), even("other")
    loop = simulator.loop(own.viewed(views[0]), SECONDS)
    loop.raw()
    assert loop.plan.find(Watch).wrong.size  # its planes have an error
    for scene, wanted in ((own, []), (other, ["other"])):
        accounts = []
        for view in views[1:]:
            loop.update(scene=scene.viewed(view)).raw()
            asked = simulator, loop.plan, loop.scene, SECONDS, Facts.of(loop.scene)
            accounts.append(probe_plan(*asked))
        assert probed == wanted
        assert all(one.bounds == accounts[0].bounds for one in accounts)
    loop.update(scene=other.viewed(gs.View((0.3, 0.2), zoom=1.5))).raw()
    assert probed == ["other", "other"]


def test_views_are_probed_after_a_call_in_which_their_arrays_may_be_written_to():
    plan, probing = made("numpy").plan(even(), None, SECONDS), Probing()
    probing.set_plan(plan)
    assert plan.find(Watch).wrong.size
    assert not probing.is_due(plan, replace(plan.scene, name="a view"))
    probing.end_scene()
    assert probing.is_due(plan, replace(plan.scene, name="in another call"))


def test_scenes_that_are_not_met_are_probed_ever_less_often():
    """Intervals of 1, 4 and 13 scenes while their own probes confirm it; a view of the plan's content never."""
    probing, plan, other = Probing(), SimpleNamespace(scene=even()), even("other")
    probed = []
    for number in range(24):
        if probing.is_doubted(plan, other):
            probed.append(number)
            probing.confirm(False)
    assert probed == [0, 4, 17]
    probing.confirm(True)  # from then on each is looked at again
    assert probing.is_doubted(plan, other)
    assert not probing.is_doubted(plan, replace(plan.scene, name="view"))


@pytest.mark.parametrize("device", KINDS)
def test_a_batch_comes_back_to_the_scene_that_it_is_planned_for(device):
    """A scene whose probe misses has a plan for its call only."""
    first, camera = even(), CAMERA.with_(exposure_time_ms=1e3 * SECONDS)
    batch = made(device, camera=camera).batch(1, "mean", planned_for=first)
    for scene in (even("one"), local(), even("two")):
        found = np.array(batch(scene))[0]
        own = scene.name == "local"
        assert batch.plans[0].scene is (scene if own else first)
        if own:  # the frame is the plan's
            fresh = np.array(made(device, camera=camera).expose(scene).mean)
            np.testing.assert_array_equal(found, fresh)
