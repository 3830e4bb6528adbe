"""Motion blur and rolling shutter of a camera on its path: against sums of many instants, and a wave's closed form."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS

import gpusim as gs
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.video import captured_frames
from gpusim.domain.errors import OutOfRange
from gpusim.domain.scene import Scene
from gpusim.pipeline.planning import probes_for

SECONDS, ROW_TIME, START = 0.01, 4e-5, 0.3
PATHS = (
    gs.Motion(pan=(80, 250)),
    gs.Motion(pan=(0, 300), roll=1.5, zoom=1.1, zooming=1.5),
    gs.Motion(shake=6, seed=3),
)


def camera(row_time=ROW_TIME):
    return replace(PHONE, sensor=replace(PHONE.sensor, row_time=row_time))


def brute(simulator, scene, motion, row_time, instants):
    """Rows that gather what every instant shows while they are open: a plain mean of evenly spaced ones."""
    rows = np.arange(scene.shape[0])
    whole = SECONDS + row_time * rows[-1]
    times = START + (np.arange(instants) + 0.5) * (whole / instants)
    loop, total, opened = None, 0.0, np.zeros(len(rows))
    for time in times:
        view = scene.viewed(motion.at(time))
        loop = loop.update(scene=view) if loop else simulator.loop(view, exposure_time=SECONDS)
        mean = np.array(simulator.device.numpy(loop.exposure.mean), np.float64)
        is_open = (time >= START + rows * row_time) & (time < START + rows * row_time + SECONDS)
        total = total + is_open[:, None] * mean
        opened += is_open
    return total / opened[:, None]


@pytest.mark.parametrize("motion", PATHS, ids=["pan", "turn", "shake"])
@pytest.mark.parametrize("row_time", [0.0, ROW_TIME])
def test_a_frame_errs_no_more_than_it_says(motion, row_time):
    """Against 320 instants, at two tolerances and without one."""
    scene = gs.chart("deadleaves", size=(100, 80))
    truth = brute(
        gs.Simulator(camera(row_time), device="opencl:0", tolerance=0.02),
        scene,
        motion,
        row_time,
        320,
    )
    for tolerance in (None, 0.1, 0.02):
        simulator = gs.Simulator(camera(row_time), device="opencl:0", tolerance=tolerance)
        exposure = gs.expose_motion(simulator, scene, motion, SECONDS, START)
        error = np.array(simulator.device.numpy(exposure.mean)) - truth
        bounds = exposure.plan.account.bounds
        # every view of the truth is interpolated: a smear, which is not, differs by the error of views
        between = gs.View(shift=(0.3, 0.3))
        views = probes_for(simulator, scene, between, SECONDS).resampling_error(between, 1.0)
        stated = bounds["shutter"].rms + (views.rms if "path" in words(exposure) else 0)
        # the truth's own: rows open half of an instant, of 320 in 10 to 13 ms, too early or late: 0.4 %, and a
        # plan errs by a third of its tolerance
        rms = np.sqrt(np.mean(error**2) / np.mean(truth**2))
        assert rms < stated + 2e-3 + (tolerance or 0) / 3
        if tolerance is not None:
            assert 1.5 * bounds["shutter"].rms <= 0.5 * tolerance


def words(exposure):
    """How the exposure in motion was made."""
    return exposure.plan.models["sensor.shutter"]


@pytest.mark.parametrize("device", KINDS)
def test_a_wave_is_blurred_as_its_closed_form_says(device):
    """cos(2 pi f x) of f = 1/25 a sample, over 20 samples: sinc(f D) of it, and the phase of the middle."""
    f, speed = 0.04, 2000.0
    x = np.arange(400) - 199.5
    planes = np.broadcast_to(1 + 0.5 * np.cos(2 * pi * f * x), (4, 40, 400)).astype(np.float32)
    light = gs.chart("flat").illuminant
    wavelengths = np.linspace(420.0, 680.0, 4)
    scene = Scene(gs.Cube(wavelengths, planes), light)
    simulator = gs.Simulator(camera(0.0), device=device)
    exposure = gs.expose_motion(
        simulator, scene, gs.Motion(pan=(0, speed)), SECONDS, -SECONDS / 2, instants=17
    )
    wave = 1 + 0.5 * np.sinc(f * speed * SECONDS) * np.cos(2 * pi * f * x)
    own = Scene(gs.Cube(wavelengths, np.broadcast_to(wave, (4, 40, 400)).astype(np.float32)), light)
    expected = np.array(simulator.device.numpy(simulator.expose(own, SECONDS).mean), np.float64)
    found = np.array(simulator.device.numpy(exposure.mean), np.float64)
    inside = np.s_[:, 130:-130]  # far from where the wave ends, in one place or another
    wrong = np.sqrt(np.mean((found - expected)[inside] ** 2) / np.mean(expected[inside] ** 2))
    bounds = exposure.plan.account.bounds
    assert wrong < bounds["shutter"].rms + bounds["view"].rms + 1e-4 and bounds["view"].rms > 0


def test_rows_see_the_camera_where_it_is_then():
    """An edge leans by the speed times the row time."""
    speed, row_time = 1500.0, 2e-4
    picture = gs.chart("flat", size=(120, 60))
    shading = np.where(np.arange(120) < 60, 0.1, 1.0) * np.ones((60, 1))
    scene = replace(picture, content=replace(picture.content, shading=shading.astype(np.float32)))
    simulator = gs.Simulator(camera(row_time), device="opencl:0")
    exposure = gs.expose_motion(simulator, scene, gs.Motion(pan=(0, speed)), 1e-4, instants=61)
    mean = np.array(simulator.device.numpy(exposure.mean), np.float64)[1::2, ::2]  # one colour
    bright = mean.max(axis=1, keepdims=True)
    edge = 120 - 2 * (mean / bright).sum(axis=1)  # where the bright part begins, up to a constant
    lean = np.polyfit(np.arange(60)[1::2][3:-3], edge[3:-3], 1)[0]
    # the dark part counts a tenth; 1 % is a sixth of a sample over the frame's 16 of lean
    assert lean == pytest.approx(-speed * row_time * 0.9, rel=0.01)


def test_a_resting_camera_is_one_picture_and_odd_numbers_are_refused():
    scene, simulator = (
        gs.chart("flat", size=(40, 30)),
        gs.Simulator(camera(), device="numpy", tolerance=0.1),
    )
    still = gs.expose_motion(simulator, scene, gs.Motion(zoom=1.5), SECONDS)
    assert still.plan.models["sensor.shutter"].startswith("1 pictures")
    with pytest.raises(OutOfRange, match="instants"):
        gs.expose_motion(simulator, scene, PATHS[0], SECONDS, instants=1)


def test_no_path_is_too_long():
    """300 pixels in 10 ms, which no number of pictures shows to 1e-4."""
    simulator = gs.Simulator(camera(), device="opencl:0", tolerance=1e-4)
    scene, motion = gs.chart("deadleaves", size=(60, 40)), gs.Motion(pan=(0, 3e4))
    exposure = gs.expose_motion(simulator, scene, motion, SECONDS)
    assert words(exposure).startswith("a path of 300 samples")
    assert exposure.plan.account.bounds["shutter"].rms > 0  # and it says by how much rows err


def test_captured_frames_are_those_of_their_times():
    """Each by itself, whatever was made before."""
    scene = gs.chart("deadleaves", size=(64, 48))
    simulator = gs.Simulator(camera(), device="opencl:0", tolerance=0.2)
    scenes = Moving(Still(scene, 6), PATHS[0], 25)
    every = {
        one.number: one.values
        for one in captured_frames(simulator, scenes, [[0, 0, 1, 2], [3, 3, 5]], output="raw")
    }
    assert list(every) == [0, 1, 2, 3, 5]
    for one in captured_frames(simulator, scenes, [[3, 5], [0, 1]], output="raw"):
        assert np.array_equal(one.values, every[one.number])
    exposure = gs.expose_motion(simulator, scene, PATHS[0], start=5 / 25)
    assert np.array_equal(every[5], simulator.device.numpy(exposure.raw(first=5)))
