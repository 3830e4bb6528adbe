"""What changes evenly over a video: each frame is that of its own camera and light."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS

import gpusim as gs
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.scenes import Still
from gpusim.apps.video.video import frames
from gpusim.cli.main import main


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize(
    "asked",
    [
        "exposure=1/500..1/40",
        "focus=0.1..2,exposure=0.01..0.01",
        "light=1..0.2,exposure=1/100..1/100",
        "f-number=2..8,iso=100..800,exposure=0.01..0.02",
    ],
)
def test_frames_are_those_of_their_own_settings(device, asked):
    """Without a tolerance, where a plan depends on nothing but the camera: evenly in the logarithm."""
    simulator, scene = gs.Simulator(PHONE, device=device), gs.chart("deadleaves", size=(48, 32))
    ramps = Ramps.parse(asked)
    found = list(
        frames(simulator, Still(scene, 4), [[0, 0, 1, 2, 3]], seed=3, output="raw", ramps=ramps)
    )
    assert [one.number for one in found] == [0, 1, 2, 3]
    for number, one in enumerate(found):
        values = {
            name: first ** (1 - number / 3) * last ** (number / 3)
            for name, (first, last) in ramps.ranges
        }
        camera, lit = PHONE, scene
        if "exposure" in values:
            camera = replace(
                camera, sensor=replace(camera.sensor, exposure_time=values["exposure"])
            )
        if "iso" in values:
            from gpusim.color.speed import gain_for_speed

            camera = replace(
                camera,
                sensor=replace(
                    camera.sensor,
                    analog_gain=gain_for_speed(camera.sensor, values["iso"]),
                    auto_exposure=replace(camera.sensor.auto_exposure, most_gain=1.0),
                ),
            )
        lens = {"f-number": "f_number", "focus": "object_distance"}
        camera = replace(
            camera,
            optics=replace(
                camera.optics, **{key: values[name] for name, key in lens.items() if name in values}
            ),
        )
        if "light" in values:
            light = scene.illuminant
            lit = replace(
                scene, illuminant=gs.Spectrum(light.wavelengths, values["light"] * light.values)
            )
        own = gs.Simulator(camera, device=device)
        expected = own.loop(lit).raw(seed=3, first=number)
        # powers round, so that settings differ in their last bits, and a few values by one
        assert (
            np.abs(one.values.astype(int) - np.array(own.device.numpy(expected)).astype(int)).max()
            <= 1
        )
        assert (one.values != np.array(own.device.numpy(expected))).mean() < 1e-3


@pytest.mark.parametrize("more", [[], ["--blur", "--pan", "0,60"]])
def test_shards_and_what_is_missing_are_the_same(more, tmp_path):
    arguments = [
        "video",
        "ramp",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--size",
        "24x16",
        "--frames",
        "6",
        "--segment",
        "2",
        "--ramp",
        "light=1..6,focus=0.2..3",
        *more,
    ]
    assert main([*arguments, "-o", str(tmp_path / "a.png")]) == 0
    expected = {path.name: path.read_bytes() for path in tmp_path.glob("a_*.png")}
    assert len(expected) == 6 and len({*expected.values()}) == 6
    other = tmp_path / "other"
    other.mkdir()
    for part in ("1/2", "0/2"):
        assert main([*arguments, "--shard", part, "-o", str(other / "a.png")]) == 0
    (other / "a_0003.png").unlink()
    assert main([*arguments, "-o", str(other / "a.png")]) == 0
    assert {path.name: path.read_bytes() for path in other.glob("a_*.png")} == expected


@pytest.mark.parametrize(
    "text",
    [
        "zoom=1..2",
        "focus=1",
        "focus=0..2",
        "focus=1..nan",
        "iso=1..2,iso=1..2",
        "",
        "light=1..2..3",
    ],
)
def test_ramps_that_are_none(text):
    with pytest.raises(argparse.ArgumentTypeError, match=r"wanted NAME=FIRST\.\.LAST"):
        Ramps.parse(text)


def test_ends_are_what_was_given():
    """1/30 by way of a power of its ratio to 1/500 is one ulp more, and longer than a frame."""
    ramps = Ramps.parse("exposure=1/500..1/30,iso=800..100")
    assert (
        ramps.at(0.0) == {"exposure": 1 / 500, "iso": 800.0} and ramps.at(1.0)["exposure"] <= 1 / 30
    )
    assert all(100 <= ramps.at(part)["iso"] <= 800 for part in np.linspace(0, 1, 101))


@pytest.mark.parametrize("output", [None, "raw"])
def test_automatic_exposure_follows_the_light_of_the_frame_before(output):
    """Light that jumps tenfold finds the exposure of the frame before; the next one is set for it."""
    simulator, scene = gs.Simulator(PHONE, device="numpy"), gs.chart("ramp", size=(24, 16))
    bright = scene.brighten(10)

    class Jump(Still):
        is_still = False

        def between(self, first, end):
            return iter([scene, scene, bright, bright, bright][first:end])

    made = list(frames(simulator, Jump(scene, 5), [[0, 0, 1, 2, 3, 4]], output=output))
    alone = [simulator.expose(one).exposure_time for one in (scene, bright)]
    expected = [alone[0]] * 3 + [alone[1]] * 2
    if output is None:
        np.testing.assert_allclose([one.account.seconds for one in made], expected, rtol=1e-5)
    else:
        for one, seconds in zip(made, expected, strict=True):
            lit = scene if one.number < 2 else bright
            raw = simulator.loop(lit, seconds).raw(seed=0, first=one.number)
            assert (
                np.abs(one.values.astype(int) - np.array(raw).astype(int)).max() <= 1
            )  # of times' last bits


def test_a_ramp_to_an_exposure_longer_than_the_frame_is_refused_before_the_work(tmp_path, capsys):
    assert (
        main(
            [
                "video",
                "flat",
                "--camera",
                "phone",
                "--frames",
                "3",
                "--ramp",
                "exposure=1/100..1/2",
                "-o",
                str(tmp_path / "a.png"),
            ]
        )
        == 2
    )
    assert "exposure time of a video = 0.5 s" in capsys.readouterr().err and not any(
        tmp_path.iterdir()
    )
