"""Light that flickers before a rolling shutter: rows gather what sums over many instants say."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import camera_with
from devices import KINDS

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import OutOfRange
from gpusim.optics.shutter import shutter_weights

LIGHTS = [
    gs.Flicker(100, 0.4, phase=0.3),
    gs.Flicker(120),
    gs.Flicker(250, duty=0.3, phase=0.77),
    gs.Flicker(333, duty=1.0, phase=-2.2),
]
STEPS = 200_001


def brightness(light, times):
    """By the words of `Flicker`, without an integral."""
    turn = light.frequency * times + light.phase
    return (
        (turn % 1 < light.duty) / light.duty
        if light.duty
        else 1 + light.depth * np.cos(2 * np.pi * turn)
    )


@pytest.mark.parametrize("light", LIGHTS, ids=str)
@pytest.mark.parametrize("start", [0.0, 0.103, 5000.07])
def test_rows_gather_what_a_fine_sum_does(light, start):
    """Midpoints; a switched light's edges are wrong by up to a step each: `duty` and 8 edges of an exposure."""
    seconds, row_time, rates = 0.02, 0.003, np.array([3.0, 1, 4, 1, 5, 9])
    times = start + np.linspace(-0.001, 0.05, len(rates))
    weights = shutter_weights(times, 9, seconds, row_time, start, light)
    alone = shutter_weights([0.0], 9, seconds, row_time, start, light)
    for row in range(9):
        fine = np.linspace(row * row_time, row * row_time + seconds, STEPS)
        middle, step = (fine[1:] + fine[:-1]) / 2, fine[1] - fine[0]
        light_there = brightness(light, start + middle)
        allowed = 8 * step * 9 / (light.duty or 1) + 1e-9
        expected = (np.interp(start + middle, times, rates) * light_there).sum() * step
        assert weights[row] @ rates == pytest.approx(expected, abs=allowed)
        assert alone[row, 0] == pytest.approx(light_there.sum() * step, abs=allowed)


def test_light_that_does_not_flicker_changes_nothing():
    times = np.linspace(0, 0.1, 5)
    steady = shutter_weights(times, 7, 0.03, 0.005)
    for light in (gs.Flicker(100, 0.0), gs.Flicker(1000, duty=1.0)):
        np.testing.assert_allclose(
            shutter_weights(times, 7, 0.03, 0.005, flicker=light), steady, atol=1e-15
        )


@pytest.mark.parametrize("device", KINDS)
def test_bands_of_a_still_scene(device):
    """A flat frame's rows are as bright as the light was while they were open, and the next frame's bands go on."""
    camera = camera_with(sensor={"row_time": 1e-4})
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    simulator, scene, light = (
        gs.Simulator(camera, device=device),
        gs.chart("flat", size=(24, 120)),
        gs.Flicker(100),
    )
    steady = simulator.device.numpy(gs.expose_motion(simulator, scene, gs.Motion(), 0.002).mean)
    for start in (0.0, 1 / 30):
        found = simulator.device.numpy(
            gs.expose_motion(simulator, scene, gs.Motion(), 0.002, start=start, flicker=light).mean
        )
        opens = start + 1e-4 * np.arange(120)
        turn = 2 * np.pi * 100
        expected = 1 + (np.sin(turn * (opens + 0.002)) - np.sin(turn * opens)) / (turn * 0.002)
        np.testing.assert_allclose(
            (found / steady).mean(axis=1), expected, rtol=2e-5
        )  # float32 of weights and sums


@pytest.mark.parametrize(
    "asked, words",
    [
        ({"frequency": 0}, "flicker.frequency = 0.0: allowed is above 0"),
        ({"frequency": np.nan}, "flicker.frequency"),
        ({"frequency": 100, "depth": 1.1}, "flicker.depth = 1.1: allowed is 0 .. 1"),
        ({"frequency": 100, "duty": 0}, "flicker.duty = 0: allowed is 0 < duty <= 1"),
    ],
)
def test_lights_that_are_none(asked, words):
    with pytest.raises(OutOfRange) as raised:
        gs.Flicker(**asked)
    assert words in str(raised.value)


@pytest.mark.parametrize(
    "asked",
    [
        ["--flicker", "100,2"],
        ["--flicker", "x"],
        ["--pwm", "100"],
        ["--pwm", "100,.5", "--flicker", "100"],
    ],
)
def test_bad_lights_of_a_video_are_one_line(asked, tmp_path, capsys):
    try:
        status = main(["video", "flat", "--camera", "phone", *asked, "-o", str(tmp_path / "a.png")])
    except SystemExit as stop:  # of what argparse refuses
        status = stop.code
    assert status == 2
    told = capsys.readouterr().err
    assert "--flicker" in told or "--pwm" in told
    assert not any(tmp_path.iterdir())


def test_a_video_in_light_that_flickers_resumes(tmp_path):
    arguments = [
        "video",
        "ramp",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--size",
        "24x16",
        "--exposure",
        "1/500",
        "--frames",
        "4",
        "--pwm",
        "90,.4",
    ]
    assert main([*arguments, "-o", str(tmp_path / "a.png")]) == 0
    first = {path.name: path.read_bytes() for path in tmp_path.glob("a_*.png")}
    assert len({*first.values()}) == 4
    (tmp_path / "a_0002.png").unlink()
    assert main([*arguments, "-o", str(tmp_path / "a.png")]) == 0
    assert {path.name: path.read_bytes() for path in tmp_path.glob("a_*.png")} == first
