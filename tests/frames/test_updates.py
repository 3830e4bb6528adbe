"""A loop runs what is behind a change, and gives what a new Simulator gives, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import camera_with
from devices import ALL_KINDS, KINDS
from lights import as_photons

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.pipeline.cache import One, same

SIZE = (96, 64)


BASE = camera_with(
    gs.open_camera("phone"),
    processor={"demosaic": "adaptive"},
    sensor={"exposure_time": 0.01},
    noise={"prnu": 0.01, "dsnu": 1.0, "read": 2.0},
)
ENCODE = {"display.encode"}
COLOUR = {"processor.color", *ENCODE}
PROCESS = {"processor.adaptive", *COLOUR}
READ = {"sensor.noise", *PROCESS}
COLLECT = {"sensor.collect", "sensor.chip", *READ}
BLUR = {"optics.airy", "optics.mosaic", *COLLECT}
CHANGES = {  # what changes -> the stages behind it, by the order in which light goes
    "tone": ({"processor": {"tone": ((0.0, 0.0), (0.3, 0.5), (1.0, 1.0))}}, ENCODE),
    # its input has no name of its own without it
    "sharpening": ({"processor": {"sharpen": 1.0}}, {"processor.sharpen", *COLOUR}),
    "color": ({"processor": {"training": "munsell"}}, COLOUR),
    "demosaic": ({"processor": {"demosaic": "malvar"}}, {"processor.malvar", *COLOUR}),
    "read noise": ({"noise": {"read": 9.0}}, READ),
    "offsets": ({"noise": {"dsnu": 5.0}}, {"sensor.pattern", *READ}),
    "gain": ({"sensor": {"analog_gain": 4.0}}, READ),
    "chip": ({"noise": {"seed": 5}}, {"sensor.pattern", "sensor.chip", *READ}),
    "exposure": ({"sensor": {"exposure_time": 0.03}}, COLLECT),
    "f-number": ({"optics": {"f_number": 4.0}}, BLUR),
    "nothing": ({}, set()),
}


@pytest.fixture(scope="module")
def scene():
    return gs.chart("deadleaves", size=SIZE)


def numpy(device, *arrays):
    return [np.array(device.numpy(array)) for array in arrays]


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("name", CHANGES)
def test_what_is_behind_a_change_runs_and_nothing_else(device, name, scene):
    parts, behind = CHANGES[name]
    loop = gs.Simulator(BASE, device=device).loop(scene)
    loop.codes(seed=3)
    changed = camera_with(BASE, **parts)
    loop.update(camera=changed)
    with loop.simulator.device.timed() as ms:
        codes, raw = loop.codes(seed=3), loop.raw(seed=3)
    assert set(ms) == behind
    fresh = gs.Simulator(changed, device=device)(scene, seed=3)
    found = numpy(loop.simulator.device, codes, raw)
    np.testing.assert_array_equal(found[0], fresh.rgb)
    np.testing.assert_array_equal(found[1], fresh.raw)


@pytest.mark.parametrize("device", KINDS)
def test_what_is_given_to_the_loop_itself(device, scene):
    """Another seed, frame, exposure time, gain or scene; and the first one again."""
    simulator = gs.Simulator(BASE, device=device)
    loop, other = simulator.loop(scene), gs.chart("colorchecker", size=SIZE)
    first = loop.frame(seed=3)
    for seed, frame, seconds, gain, shown in (
        (4, 0, None, 1.0, scene),
        (4, 7, None, 1.0, scene),
        (4, 7, 0.02, 1.0, scene),
        (4, 7, 0.02, 2.0, scene),
        (4, 7, 0.02, 2.0, other),
        (3, 0, None, 1.0, scene),
    ):
        found = loop.update(scene=shown, exposure_time=seconds, gain=gain).frame(
            seed=seed, first=frame
        )
        exposure = gs.Simulator(BASE, device=device).expose(shown, seconds, gain)
        fresh = exposure.frame(seed=seed, first=frame)
        for key in ("mean", "raw", "linear", "rgb"):
            np.testing.assert_array_equal(getattr(found, key), getattr(fresh, key))
    np.testing.assert_array_equal(found.rgb, first.rgb)


def test_automatic_exposure_is_metered_anew_where_it_must_be(scene):
    automatic = camera_with(BASE, sensor={"exposure_time": None}, noise={"dark_current": 0.0})
    loop = gs.Simulator(automatic, device="numpy").loop(scene)
    first = loop.exposure.exposure_time
    darker = camera_with(
        automatic, sensor={"auto_exposure": gs.AutoExposure(level=0.475)}
    )  # half of .95
    assert loop.update(camera=darker).exposure.exposure_time == pytest.approx(first / 2, rel=1e-12)
    brighter = replace(
        scene, illuminant=replace(scene.illuminant, values=2 * scene.illuminant.values)
    )
    # float32 metering: the largest of values rounded to 6e-8 each
    assert loop.update(scene=brighter).exposure.exposure_time == pytest.approx(first / 4, rel=1e-6)


def test_a_refused_change_changes_nothing(scene):
    loop = gs.Simulator(BASE, device="numpy").loop(scene)
    before = loop.codes(seed=1)
    with pytest.raises(OutOfRange, match="exposure_time"):
        loop.update(camera=camera_with(BASE, processor={"demosaic": "malvar"}), exposure_time=-1.0)
    np.testing.assert_array_equal(loop.codes(seed=1), before)


def test_the_report_has_every_stage_that_ran(scene):
    """Stages in the order of their first launch; kept ones at 0 ms; in all no less than the stages' sum."""
    loop = gs.Simulator(BASE, device="opencl", tolerance=1e-3).loop(scene)
    report = loop.frame(seed=1).report
    names = [stage.stage for stage in report.stages]
    assert len(names) == len(set(names))
    blur = "optics.mosaic" if loop.simulator.device.is_gpu else "optics.tiles"
    assert {"spectral.integrate", "optics.airy", blur, "sensor.noise", "display.encode"} <= set(
        names
    )
    order = [
        names.index(name)
        for name in (
            blur,
            "sensor.collect",
            "sensor.noise",
            "processor.adaptive",
            "processor.color",
            "display.encode",
        )
    ]
    assert order == sorted(order)
    assert 0 < report.ms <= report.wall_ms
    again = loop.frame(seed=1).report
    assert [stage.stage for stage in again.stages] == names and again.ms == 0


def test_every_kind_of_exposure_says_how_long_it_took(scene):
    """The wall holds all stages, also of brackets and moving scenes; each is on the clock while the stages run."""
    simulator = gs.Simulator(camera_with(BASE, sensor={"row_time": 1e-5}), device="numpy")
    moving = gs.expose_moving(simulator, [scene, scene], [0.0, 0.02], 0.01)
    frames = [
        *gs.bracket(simulator, scene, (0, 1)),
        moving.frame(),
        simulator(scene),
    ]
    for frame in frames:
        assert 0 < frame.report.ms <= frame.report.wall_ms


def digital(base):
    return camera_with(
        base, sensor={"binning": (2, 2), "binning_mode": "digital"}, processor={"denoise": 1.0}
    )


@pytest.mark.parametrize("device", ["numpy", "opencl"])
@pytest.mark.parametrize(
    "change",
    [
        digital,
        lambda base: camera_with(base, sensor={"binning": (2, 2), "binning_mode": "charge"}),
        lambda base: camera_with(base, sensor={"cfa": ("BG", "GR"), "channels": ("B", "G", "R")}),
        lambda base: camera_with(base, processor={"white_balance": "gray-world"}),
        lambda base: camera_with(base, sensor={"bits": 12}),
        lambda base: camera_with(
            base, processor={"denoise": 1.0, "defects": "detect", "shading": True}
        ),
    ],
)
def test_nothing_stale_is_used(device, change, scene):
    """There and back again, by a loop and by one Simulator: mean, raw, pictures and what the report names."""
    start = camera_with(BASE, processor={"white_balance": "max-rgb"})
    loop = gs.Simulator(start, device=device).loop(scene)
    simulator = loop.simulator
    for camera in (start, change(start), start, digital(start), change(start)):
        simulator = simulator.update(camera)
        fresh = gs.Simulator(camera, device=device)(scene, seed=2)
        for frame in (loop.update(camera=camera).frame(seed=2), simulator(scene, seed=2)):
            for key in ("mean", "raw", "linear", "rgb"):
                np.testing.assert_array_equal(getattr(frame, key), getattr(fresh, key), key)
            assert frame.report.camera == fresh.report.camera
            names = [stage.stage for stage in frame.report.stages]
            assert set(names) == {stage.stage for stage in fresh.report.stages} and len(
                names
            ) == len(set(names))
            drawn = [
                name
                for name in names
                if name
                in (
                    "sensor.noise",
                    "processor.shade",
                    "processor.adaptive",
                    "processor.multiscale",
                    "processor.color",
                    "display.encode",
                )
            ]
            assert drawn == [stage.stage for stage in fresh.report.stages if stage.stage in drawn]


def test_arrays_that_were_written_to_are_seen_in_a_new_scene():
    values = np.full((3, 24, 32), 0.5, np.float32)
    wavelengths, light = np.array([450.0, 550.0, 650.0]), as_photons("D65")
    loop = gs.Simulator(BASE, device="opencl").loop(gs.Scene(gs.Cube(wavelengths, values), light))
    first = loop.frame().mean
    values *= np.float32(0.25)
    second = loop.update(scene=gs.Scene(gs.Cube(wavelengths, values), light)).frame().mean
    np.testing.assert_allclose(second, first / 4, rtol=1e-6)  # float32, a power of two


def test_pictures_are_the_callers_own(scene):
    loop = gs.Simulator(camera_with(BASE, processor={"shading": True}), device="numpy").loop(scene)
    first, second = loop.frame(), loop.frame(first=1)
    before = second.mean.copy(), second.shading.copy()
    first.mean[...] = 0
    first.shading[...] = 0
    for array, kept in zip((second.mean, second.shading), before, strict=True):
        np.testing.assert_array_equal(array, kept)
    np.testing.assert_array_equal(loop.frame(first=2).shading, before[1])


def test_a_negative_gain_is_refused_at_once(scene):
    loop = gs.Simulator(BASE, device="numpy").loop(scene)
    with pytest.raises(OutOfRange, match="gain"):
        loop.update(gain=-1.0)
    loop.codes()


def test_keys_are_compared_by_what_they_say():
    spectrum = as_photons("D65")
    large = np.zeros(2**19)
    for one, other, equal in (
        (1, 1, True),
        (1, 1.0, False),
        ("a", "a", True),
        ((1, [2]), (1, [2]), True),
        ((1,), (1, 2), False),
        (np.arange(3), np.arange(3), True),
        (np.arange(3), np.arange(4), False),
        (np.zeros(3), np.ones(3), False),
        (One(large), One(large), True),
        (One(large), One(large.copy()), False),
        (None, None, True),
        (large, large.copy(), True),
        (np.zeros(2), np.zeros(2, np.float32), False),
        (spectrum, replace(spectrum), True),
        (spectrum, replace(spectrum, values=2 * spectrum.values), False),
        (object(), object(), False),
    ):
        assert same(one, other) is equal


NOISES = {
    "read_e": 6.0,
    "adc_dn": 2.0,
    "reset_e": 3.0,
    "row_e": 2.0,
    "column_e": 2.0,
    "dark_current_e_per_s": 400.0,
    "dsnu_e": 2.0,
    "prnu": 0.02,
    "photon": "fast",
}


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("key", NOISES)
def test_noise_is_turned_on_and_off(device, key):
    """Kernels leave out noise that is 0: turned on later, it is there, and off again, it is gone."""
    silent = dict.fromkeys(NOISES, 0.0) | {"photon": "none", "exposure_time_ms": 5}
    quiet = gs.open_camera("phone").with_(**silent)
    noisy = quiet.with_(**{key: NOISES[key]})
    device, scene = gs.open_device(device), gs.chart("deadleaves", size=(48, 32), seed=1)
    loop = gs.Simulator(quiet, device=device).loop(scene)
    frames = []
    for camera in (quiet, noisy, quiet):
        found = np.array(device.numpy(loop.update(camera=camera).raw(seed=1)))
        fresh = gs.Simulator(camera, device=device).loop(scene).raw(seed=1)
        np.testing.assert_array_equal(found, np.array(device.numpy(fresh)))
        frames.append(found)
    assert not np.array_equal(frames[0], frames[1])


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_frame_is_made_as_far_as_it_is_asked_for(device):
    """Raw values alone need no processor; the report needs all, and frames of a loop are made at once."""
    simulator, scene = (
        gs.Simulator(gs.open_camera("phone"), device=device),
        gs.chart("ramp", size=(48, 36)),
    )
    whole = simulator(scene, seed=3).complete()
    assert {stage.stage for stage in whole.report.stages if stage.ms} >= {
        "sensor.noise",
        "display.encode",
    }

    def stages(*parts):
        frame = simulator(scene, seed=3)
        with simulator.device.timed() as ms:
            for part in parts:
                np.testing.assert_array_equal(getattr(frame, part), getattr(whole, part))
        return {*ms}

    for wrong in ({"seed": -1}, {"seed": 2**64}, {"first": 2**32}):
        with pytest.raises(OutOfRange):
            simulator(scene, **wrong)
    assert stages() == set()
    assert stages("mean") == set()
    assert stages("raw", "raw") == {"sensor.noise"}
    assert {"processor.color", "display.encode"} <= stages("rgb")
    loop = simulator.loop(scene, 0.01)
    first = loop.frame(seed=1)
    shot = loop.exposure.frame(seed=1)
    values = first.raw.copy(), first.rgb.copy()
    loop.update(scene=gs.chart("flat", size=(48, 36)), exposure_time=0.02).frame(seed=2)
    for frame in (first, shot):
        np.testing.assert_array_equal(frame.raw, values[0])
        np.testing.assert_array_equal(frame.rgb, values[1])


def test_mistakes_are_said_in_one_line():
    simulator, scene = (
        gs.Simulator(gs.open_camera("phone"), device="numpy"),
        gs.chart("flat", size=(24, 18)),
    )
    exposure = simulator.expose(scene, 0.01)
    codes = np.zeros((18, 24, 3), np.uint8)
    for ask in (
        lambda: next(exposure.frames("2")),
        lambda: next(exposure.frames(1.5)),
        lambda: next(simulator.stream([scene], first="a")),
        lambda: gs.average(simulator, exposure, "2"),
        lambda: gs.change_exposure_time(simulator, exposure, None),
        lambda: gs.picture(codes, luminance="a"),
        lambda: simulator.batch(True),
    ):
        with pytest.raises(OutOfRange, match="allowed is"):
            ask()
    for ask in (
        lambda: gs.expose_moving(simulator, None, [0.0]),
        lambda: gs.expose_moving(simulator, [1], [0.0]),
    ):
        with pytest.raises(BadData, match="wanted"):
            ask()
    with pytest.raises(UnknownName, match="light"):
        gs.picture(codes, light=None)


@pytest.mark.parametrize("seconds", [0.004, None])
@pytest.mark.parametrize("device", KINDS)
def test_brighter_light_is_that_of_a_brighter_scene(device, seconds, scene):
    """A power of two rounds nothing. Errors are predicted for the brighter scene, and the blur is reused."""
    camera = camera_with(BASE, sensor={"exposure_time": seconds})
    simulator = gs.Simulator(camera, device=device, tolerance="video")
    loop = simulator.loop(scene)
    first = np.array(simulator.device.numpy(loop.raw(seed=3)))
    loop.update(brightness=4.0)
    with simulator.device.timed() as ms:
        raw = loop.raw(seed=3)
    if seconds is not None:
        assert "optics.mosaic" not in ms and "optics.tiles" not in ms
    raw = np.array(simulator.device.numpy(raw))
    expected = gs.Simulator(camera, device=device, tolerance="video").loop(scene.brighten(4.0))
    frame = expected.frame(seed=3)
    np.testing.assert_array_equal(raw, frame.raw)
    assert loop.frame(seed=3).exposure_time == frame.exposure_time
    errors, own = (one.account.total for one in (loop, expected))
    assert errors.rms == pytest.approx(own.rms, rel=1e-9)
    # of a plan that was made for darker light, an upper bound
    assert errors.p999_sigma >= own.p999_sigma * (1 - 1e-9)
    if seconds is None:  # it is planned for the brighter light
        assert errors.p999_sigma == pytest.approx(own.p999_sigma, rel=1e-9)
    again = loop.update(brightness=1.0).raw(seed=3)
    np.testing.assert_array_equal(np.array(simulator.device.numpy(again)), first)
    with pytest.raises(OutOfRange):
        loop.update(brightness=0.0)
