"""Streams give the frames that loops give one by one; what is wrong with a scene is found one frame late at most."""

from dataclasses import replace
from itertools import pairwise

import cameras
import devices
import numpy as np
import pytest
from devices import ALL_KINDS

import gpusim as gs
from gpusim.backends.buffers import Command
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.optics.highlights import Highlights

SIZE = (96, 64)
CAMERA = gs.open_camera("phone")
CAMERA = replace(
    CAMERA, sensor=replace(CAMERA.sensor, noise=replace(CAMERA.sensor.noise, prnu=0.01))
)


def cubes(count, size=SIZE):
    return cameras.cubes(count, size)


def taken(frames, device):
    return [np.array(device.numpy(frame)) for frame in frames]


@pytest.fixture(scope="module")
def apart():
    return devices.apart()


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("output", ["raw", "codes"])
def test_frames_of_a_stream_are_those_of_single_loops(device, output):
    """Cubes in a known light have one operator, so that every scene's own plan is the stream's."""
    simulator, scenes = gs.Simulator(CAMERA, device=device, tolerance=4e-4), cubes(5)
    found = taken(
        simulator.stream(scenes, output, seed=3, first=7, exposure_time=0.01), simulator.device
    )
    for number, (frame, scene) in enumerate(zip(found, scenes, strict=True), 7):
        own = simulator.loop(scene, 0.01)
        again = taken([getattr(own, output)(seed=3, first=number)], simulator.device)[0]
        np.testing.assert_array_equal(frame, again)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_metered_in_the_frame_before(device):
    """The first frame by its own light, every other by the light of the one before."""
    simulator, scenes = gs.Simulator(CAMERA, device=device), cubes(4)
    assert CAMERA.sensor.exposure_time is None
    own = [simulator.expose(scene).exposure_time for scene in scenes]
    assert own[0] > 1.05 * own[1] > 1.1 * own[2]
    late = taken(simulator.stream(scenes, "raw", seed=1), simulator.device)
    at_once = taken(simulator.stream(scenes, "raw", seed=1, meters_late=False), simulator.device)
    for number, scene in enumerate(scenes):
        for frame, seconds in (
            (late[number], own[max(number - 1, 0)]),
            (at_once[number], own[number]),
        ):
            exposure = simulator.expose(scene, seconds)
            fresh = exposure.frame(seed=1, first=number).raw.astype(float)
            # metered from electrons in place of electrons a second: three roundings of 2^-24 in the time, so 2e-4 of
            # a number at most at 1023, and below 1e-3 photons at 5000: both cross a step in less than 1 % of the pixels
            assert np.count_nonzero(np.abs(frame - fresh) > 1) == 0
            assert np.count_nonzero(frame != fresh) < 0.01 * fresh.size


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_frame_after_one_with_a_given_time_is_metered_itself(device):
    simulator, scenes = gs.Simulator(CAMERA, device=device), cubes(4)
    loop = simulator.loop(scenes[0], meters_late=True)
    own = [simulator.expose(scene).exposure_time for scene in scenes]
    assert loop.exposure.exposure_time == own[0]
    assert loop.update(scene=scenes[1], exposure_time=0.01).exposure.exposure_time == 0.01
    metered = loop.update(scene=scenes[2], exposure_time=None).exposure.exposure_time
    # metered from electrons in place of electrons a second: three roundings of 2^-24
    assert metered == pytest.approx(own[2], rel=4 * 2.0**-24)
    following = loop.update(scene=scenes[3]).exposure.exposure_time
    assert following == pytest.approx(own[2], rel=4 * 2.0**-24)


@pytest.mark.parametrize("seconds", [0.01, None])
def test_only_automatic_exposure_looks_for_quantiles_of_the_light(seconds, monkeypatch):
    names, start = set(), Command.start

    def started(self):
        names.add(self.name)
        start(self)

    monkeypatch.setattr(Command, "start", started)
    simulator = gs.Simulator(CAMERA, device="opencl")
    list(simulator.stream(cubes(3), "raw", exposure_time=seconds))
    assert ("tally" in names) == (seconds is None)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_other_kinds_and_sizes_on_the_way(device):
    """What no plan serves is planned anew; the frames are right all the same."""
    simulator = gs.Simulator(CAMERA, device=device, tolerance=1e-3)
    scenes = [*cubes(2), gs.chart("colorchecker", size=(64, 48)), *cubes(1, (60, 40)), cubes(1)[0]]
    found = taken(simulator.stream(scenes, "raw", seed=2, exposure_time=0.01), simulator.device)
    for number, (frame, scene) in enumerate(zip(found, scenes, strict=True)):
        fresh = taken([simulator.loop(scene, 0.01).raw(seed=2, first=number)], simulator.device)[0]
        np.testing.assert_array_equal(frame, fresh)


def of_one_band(scene, band):
    """The scene with light of one wavelength alone, as strong in all as before."""
    values = np.zeros_like(scene.content.values)
    values[band] = scene.content.values.sum(axis=0)
    return replace(scene, content=gs.Cube(scene.wavelengths, values), name="one band")


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_plan_that_does_not_fit_is_made_anew(device):
    """Light of one wavelength: the operator of likely spectra errs more than asked, and is replaced a frame later.

    That is where no probe is due, as for the second scene that the plan was not made for.
    """
    tolerance = 1e-3
    simulator, exact = (
        gs.Simulator(CAMERA, device=device, tolerance=limit) for limit in (tolerance, None)
    )
    likely = cubes(1)[0]
    odd = of_one_band(likely, 24)

    def error(exposure):
        mean, true = taken([exposure.mean, exact.expose(odd, 0.01).mean], simulator.device)
        return np.sqrt(np.mean((mean.astype(float) - true) ** 2) / np.mean(true.astype(float) ** 2))

    loop = simulator.loop(likely, 0.01)
    loop.raw()
    loop.update(scene=cameras.again(likely, "probed")).raw()
    first = loop.plan
    assert error(loop.update(scene=odd).exposure) > tolerance
    assert loop.plan is first
    loop.judge()
    assert loop.plan is not first
    assert loop.plan.scene is odd
    assert error(loop.exposure) < tolerance
    loop.update(scene=likely).raw()
    loop.judge()
    assert loop.plan.scene is odd  # it does for likely spectra as well


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_comes_back_finds_a_plan_that_fits(device, monkeypatch):
    """Odd light in every tenth scene, whose probes are elsewhere: the survey's one miss is remembered by all that come.

    It says how many planes the odd scene takes when that is gone and the plan is made for another.
    """
    simulator, likely, made = gs.Simulator(CAMERA, device=device, tolerance=1e-3), cubes(1)[0], []
    odd, plan = of_one_band(likely, 24), gs.Simulator.plan

    def planned(*args, **kwargs):
        made.append(plan(*args, **kwargs))
        return made[-1]

    monkeypatch.setattr(gs.Simulator, "plan", planned)
    scenes = [
        cameras.again(odd if number % 10 == 7 else likely, str(number)) for number in range(40)
    ]
    for _ in simulator.stream(scenes, "raw", exposure_time=0.01):
        pass
    assert [one.scene.name for one in made] == ["0", "8"]
    monkeypatch.undo()
    assert made[1].count > made[0].count == plan(simulator, likely, None, 0.01).count
    assert made[1].count <= plan(simulator, odd, None, 0.01).count + 1


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_frame_with_a_report_is_by_a_plan_that_fits_it(device):
    """At once, not a frame later; and the report names the scene, and the one that was planned for."""
    simulator, (first, second) = gs.Simulator(CAMERA, device=device, tolerance=1e-3), cubes(2)
    loop = simulator.loop(first, 0.01)
    own = loop.frame().report
    report = loop.update(scene=second).frame().report
    metered = gs.Simulator(CAMERA, device=device)(first).report
    assert {stage.model for stage in metered.stages if stage.stage == "sensor.meter"} == {
        "automatic exposure, highlights"
    }
    assert (own.scene["name"], report.scene["name"]) == ("leaves 0", "leaves 1")
    assert not any("leaves 0" in note for note in own.notes)
    assert any("planned for leaves 0" in note for note in report.notes)
    assert report.account.bounds["planes"].rms == pytest.approx(
        own.account.bounds["planes"].rms, rel=0.05
    )  # 1.1 as
    # bright
    odd = of_one_band(first, 24)
    frame = loop.update(scene=odd).frame()
    fresh = simulator.loop(odd, 0.01).frame()
    np.testing.assert_array_equal(frame.mean, fresh.mean)
    assert frame.report.account == fresh.report.account


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_highlight_is_found(device):
    """A pixel beyond what transforms can take beside the dark is split off, one frame late at most."""
    simulator, (first, second) = gs.Simulator(CAMERA, device=device, tolerance=1e-3), cubes(2)
    second.content.values[:, 30, 40] *= 1e6
    loop = simulator.loop(first, 0.01)
    loop.raw()
    loop.update(scene=second).raw()
    assert loop.plan.find(Highlights) is None
    loop.judge()
    assert len(loop.plan.find(Highlights).places) == 1


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_light_that_is_not_finite_is_named_one_frame_late_at_most(device, value):
    simulator, scenes = gs.Simulator(CAMERA, device=device), cubes(4)
    values = scenes[1].content.values.view(gs.domain.memory.Pinned)
    values[3, 20, 30] = value
    scenes[1] = replace(
        scenes[1], content=gs.Cube(scenes[1].wavelengths, values), name="the second"
    )
    frames = []
    with pytest.raises(BadData, match=r"the second: .* NaN or infinite light"):
        for frame in simulator.stream(scenes, "raw", exposure_time=0.01):
            frames.append(taken([frame], simulator.device)[0])
    assert len(frames) == 2
    again = taken(simulator.stream([scenes[0]], "raw", exposure_time=0.01), simulator.device)[0]
    np.testing.assert_array_equal(again, frames[0])
    with pytest.raises(BadData, match="the second"):  # and where it is the last
        list(simulator.stream(scenes[:2], "raw", exposure_time=0.01))


def test_a_stream_that_is_left_leaves_the_device_usable(apart):
    simulator, scenes = gs.Simulator(CAMERA, device=apart), cubes(4)
    asked = []

    def coming():
        for scene in scenes:
            asked.append(scene.name)
            yield scene

    frames = simulator.stream(coming(), "raw", exposure_time=0.01)
    first = taken([next(frames)], apart)[0]
    frames.close()
    assert asked == ["leaves 0", "leaves 1"]  # one ahead
    np.testing.assert_array_equal(
        taken(simulator.stream(scenes, "raw", exposure_time=0.01), apart)[0], first
    )

    class Fails(Exception):
        pass

    with pytest.raises(Fails):
        for _ in simulator.stream(scenes, "raw", exposure_time=0.01):
            raise Fails
    np.testing.assert_array_equal(
        taken(simulator.stream(scenes, "raw", exposure_time=0.01), apart)[0], first
    )


def test_two_buffers_are_enough_for_a_video(apart):
    """Arrays are written to again when the scene after the next is asked for, as the docstring allows."""
    simulator, scenes = gs.Simulator(CAMERA, device=apart, tolerance=1e-3), cubes(6)
    buffers = [apart.pinned(scenes[0].content.values.shape) for _ in range(2)]

    def coming():
        for number, scene in enumerate(scenes):
            values = buffers[number % 2]
            values[...] = scene.content.values
            yield replace(scene, content=gs.Cube(scene.wavelengths, values))

    found = taken(simulator.stream(coming(), "raw", seed=5, exposure_time=0.01), apart)
    for frame, fresh in zip(
        found,
        taken(simulator.stream(scenes, "raw", seed=5, exposure_time=0.01), apart),
        strict=True,
    ):
        np.testing.assert_array_equal(frame, fresh)
    assert any((a != b).any() for a, b in pairwise(found))


@pytest.mark.parametrize("turned", [False, True])
def test_scenes_that_threads_copy_to_pinned_memory(turned, apart, monkeypatch):
    """Large ones; here all. Arrays that are not contiguous, and other types, too; an array is rewritten meanwhile."""
    scenes = cubes(7)
    values = [
        np.array(scene.content.values, np.float64 if turned else np.float32) for scene in scenes
    ]
    if turned:
        values = [np.asfortranarray(one) for one in values]
    simulator = gs.Simulator(CAMERA, device=apart, tolerance=1e-3)
    wanted = taken(simulator.stream(scenes, "raw", seed=5, exposure_time=0.01), apart)
    room = [np.empty_like(values[0]) for _ in range(2)]

    def coming():
        for number, (scene, own) in enumerate(zip(scenes, values, strict=True)):
            room[number % 2][...] = own  # free again when the scene after the next is asked for
            yield replace(scene, content=gs.Cube(scene.wavelengths, room[number % 2]))

    monkeypatch.setattr("gpusim.pipeline.stream.STAGED", 0)
    found = taken(simulator.stream(coming(), "raw", seed=5, exposure_time=0.01), apart)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other)


def test_refuses():
    simulator = gs.Simulator(CAMERA, device="numpy")
    with pytest.raises(UnknownName, match="output"):
        next(simulator.stream(cubes(1), "film"))
    with pytest.raises(OutOfRange, match="first"):
        next(simulator.stream(cubes(1), first=-1))
    with pytest.raises(BadData, match=r"wanted several, e.g. \[scene\]"):
        next(simulator.stream(cubes(1)[0]))
    for asked in (
        lambda: next(simulator.stream([3])),
        lambda: simulator.loop(3),
        lambda: simulator.loop(cubes(1)[0]).update(scene="a chart"),
    ):
        with pytest.raises(BadData, match="wanted a Scene"):
            asked()
    assert list(simulator.stream([])) == []
