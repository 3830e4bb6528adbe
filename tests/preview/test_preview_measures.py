"""What is told beside the picture, against closed forms, and the part of it that is shown."""

from dataclasses import replace
from math import log, pi
from types import SimpleNamespace

import colour
import numpy as np
import pytest
from scipy.special import erf

import gpusim as gs
from gpusim.apps.preview.crop import Crop, enlarge
from gpusim.apps.preview.measures import SPAN, Where, error_map
from gpusim.apps.preview.panels_lens import edge_response
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Moving, Still
from gpusim.backends import open_device
from gpusim.data.charts import colorchecker_patches
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.domain.motion import Motion
from gpusim.measure.checker import Checker, checker_of
from gpusim.measure.ideal import ideal
from gpusim.measure.sfr import mtf50

DISPLAY = DISPLAYS["srgb"]
STATE = State("phone", {"sensor.exposure_time_ms": 20.0}, tolerance="exact", is_live=False)


@pytest.mark.parametrize("sigma", [0.8, 1.5])
def test_the_response_of_a_gaussian_edge(sigma):
    """exp(-2 pi^2 sigma^2 f^2) is a half at sqrt(ln 2 / 2) / (pi sigma); the part alone is looked at."""
    y, x = np.indices((90, 100))
    distance = (x - 50 - (y - 45) * np.tan(np.radians(5))) * np.cos(np.radians(5))
    grey = 0.4 + 0.3 * erf(distance / (sigma * 2**0.5))
    linear = np.random.default_rng(1).random((120, 140, 3))
    linear[20:110, 30:130] = grey[..., None]
    shown = SimpleNamespace(arrays={"linear": linear})
    found = edge_response(shown, Where((120, 140), None, (20, 30, 110, 130)))
    assert mtf50(found) == pytest.approx((log(2) / 2) ** 0.5 / (pi * sigma), rel=0.02)
    assert abs(np.degrees(found.angle)) == pytest.approx(5, abs=0.1)
    with pytest.raises(BadData, match="sfr"):
        edge_response(shown, Where((120, 140), None, (0, 0, 20, 30)))


def test_the_difference_of_a_checkers_patches():
    """The ideal picture has none; of another the mean is as colour-science has it, patch by patch."""
    scene = gs.chart("colorchecker", size=(192, 128))
    checker, true = Checker(scene), ideal(scene)
    linear = true @ np.linalg.inv(DISPLAY.xyz_from_rgb).T
    inside = np.clip(linear, 0, 1)  # cyan is outside of sRGB
    other = 0.8 * inside
    white = colour.XYZ_to_xy(DISPLAY.xyz_from_rgb.sum(1))
    expected = []
    for y, x in colorchecker_patches((192, 128)):
        at = slice((y.start + y.stop) // 2, (y.start + y.stop) // 2 + 1), (x.start + x.stop) // 2
        pair = [
            colour.XYZ_to_Lab(xyz[at][0], white) for xyz in (other @ DISPLAY.xyz_from_rgb.T, true)
        ]
        expected.append(colour.delta_E(*pair, method="CIE 2000"))
    assert checker.differences(other, 1.0, DISPLAY).mean() == pytest.approx(
        np.mean(expected), rel=1e-6
    )
    assert checker.differences(2 * other, 2.0, DISPLAY).mean() == pytest.approx(
        np.mean(expected), rel=1e-6
    )
    assert checker.differences(inside, 1.0, DISPLAY).mean() < 0.3 * np.mean(expected)
    assert checker_of(gs.chart("ramp", size=(192, 128))) is None and checker_of(scene) is not None


def test_a_map_of_errors():
    truth = np.full((4, 6), 100.0)
    mean = truth.copy()
    assert (error_map(mean, truth) == 128).all()
    mean[0, 0], mean[1, 1] = 110, 90
    codes = error_map(mean, truth)
    rms = (200 / 24) ** 0.5
    part = min(10 / (SPAN * rms), 1)
    assert codes[0, 0].tolist() == [
        int(128 * (1 - part) + 255 * part + 0.5),
        *[int(128 * (1 - part) + 0.5)] * 2,
    ]
    assert codes[1, 1].tolist() == codes[0, 0].tolist()[::-1]


def test_the_error_of_a_producer_is_that_of_verify():
    scene = gs.chart("deadleaves", size=(64, 48))
    state = replace(STATE, tolerance="1e-2")
    codes, error = Producer(Still(scene, 1), open_device("opencl")).error(state, 0)()
    report = gs.Simulator(state.build(), device="opencl", tolerance=1e-2)(scene, verify=True).report
    assert codes.shape == (48, 64, 3) and error == report.error


def test_parts_of_a_frame():
    shape = 200, 320
    one = enlarge(None, 1, (100, 160), shape, 1000)
    assert (one.times, one.cols, one.rows) == (
        4,
        250,
        156,
    )  # 3.1 pixels of the screen along one of the frame: all
    two = enlarge(one, 1, (100, 160), shape, 1000)
    assert two.times == 8 and abs(two.top + two.rows / 2 - 100) <= 1
    assert enlarge(two, -1, (100, 160), shape, 1000).times == 4
    assert enlarge(one, -1, (100, 160), shape, 1000) is None
    assert enlarge(None, -1, (0, 0), shape, 1000) is None
    corner = enlarge(None, 1, (199, 319), shape, 1000)
    assert corner.top + corner.rows == 200 and corner.left + corner.cols == 320
    assert corner.move(10**6, -(10**6), shape) == Crop(
        200 - corner.rows, 0, corner.rows, corner.cols, 4
    )
    most = two
    for _ in range(9):
        most = enlarge(most, 1, (3, 3), shape, 1000)
    assert most.times == 16
    small = enlarge(None, 1, (1, 1), (2, 3), 4000)  # enlarged farther than ENLARGED goes
    assert small is None
    low = enlarge(None, 1, (1000, 2000), (2160, 3840), 1000)
    assert (low.times, low.cols) == (1, 1000)


def test_two_cameras_side_by_side():
    scene = gs.chart("colorchecker", size=(96, 64))
    producer = Producer(Still(scene, 1), open_device("opencl"))
    other = {"camera": "figure8", "changes": {}}
    left, right = (
        producer.picture(STATE, 3).codes,
        producer.picture(replace(STATE, **other), 3).codes,
    )
    kept = replace(STATE, snapshots={"B": other}, against="B", split=0.25)
    both = producer.picture(kept, 3).codes
    assert np.array_equal(both[:, :23], left[:, :23]) and np.array_equal(
        both[:, 25:], right[:, 25:]
    )
    assert np.array_equal(producer.picture(STATE, 3).codes, left)
    assert State.of_link(kept.link(), "phone").others == (replace(kept.snapshot("B")),)
    stranger = replace(kept, snapshots={"B": {"camera": "/etc/passwd.toml", "changes": {}}}).link()
    assert State.of_link(stranger, "phone").others[0].camera == "phone"
    for wrong in (
        '{"against": 3}',
        '{"against": "B"}',
        '{"snapshots": {"B": {"camera": "phone", "changes": {"no": 1}}}}',
        '{"split": 7}',
        '{"snapshots": {"B": {"camera": "phone", "view": "raw", "changes": 4}}}',
        '{"snapshots": {"B": {"camera": "phone", "changes": 4}}}',
        '{"snapshots": {"B": {"camera": 4, "changes": {}}}}',
    ):
        with pytest.raises(BadData, match="link"):
            State.of_link(wrong, "phone")


def test_scenes_that_move_are_those_of_a_video():
    """Whichever frame is asked for after which other."""
    scenes = Moving(
        Still(gs.chart("deadleaves", size=(96, 64)), 6),
        Motion((0.0, 40.0), 0.0, 1.4, 1.0, 1.0, 0),
        1 / 30,
    )
    producer = Producer(scenes, open_device("opencl"), 1 / 30)
    assert producer.frames == 6
    for number in (0, 1, 2, 5, 1, 0):
        scene = next(scenes.between(number, number + 1))
        assert np.array_equal(
            producer.picture(STATE, number).codes,
            gs.Simulator(STATE.build(), device="opencl")(scene, first=number).rgb,
        )
        assert np.array_equal(
            producer.frame(STATE, number).rgb, producer.picture(STATE, number).codes
        )
