"""Loops of a video's camera: exposure, white balance and focus that follow the scene with a lag."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS
from PIL import Image

import gpusim as gs
from gpusim.apps.video.loops import Lags, follow, meter_scenes
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.video import captured_frames, frames
from gpusim.cli.main import main

PERIOD, COUNT = 1 / 30, 12
SCENE = gs.chart("ramp", size=(24, 16))
GRAY = replace(PHONE, processor=replace(PHONE.processor, white_balance="gray-world"))


class Sequence:
    """Scenes of a list."""

    is_still, names, flicker, motion, period, actors = (
        False,
        ["a list"],
        None,
        gs.Motion(),
        PERIOD,
        (),
    )

    def __init__(self, scenes):
        self.scenes, self.count, self.still = scenes, len(scenes), self

    def between(self, first, end):
        return iter(self.scenes[first:end])


def step(before, after, lag, jump=4):
    """What a loop of first order sets where its target jumps in frame `jump`: it sees that one before the next."""
    behind = np.maximum(np.arange(COUNT) - jump, 0) * PERIOD
    part = 1 - np.exp(-behind / lag) if lag else 1.0 * (behind > 0)
    return before + (after - before) * part


@pytest.mark.parametrize("lag", [0.0, 0.05, 1.0])
def test_a_step_is_followed_as_its_time_constant_says(lag):
    targets = np.where(np.arange(COUNT) < 4, -1.0, 3.0)
    np.testing.assert_allclose(follow(targets, lag, PERIOD), step(-1, 3, lag), rtol=1e-12)


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("made_by", [frames, captured_frames])
def test_exposure_follows_in_stops(device, made_by):
    """Light that grows tenfold: the exposure falls by as much along an exponential curve, part of it by the gain."""
    bright = SCENE.brighten(10)
    scenes = Sequence([SCENE] * 4 + [bright] * (COUNT - 4))
    longest = gs.Simulator(PHONE, device=device).expose(SCENE).exposure_time / 4
    automatic = replace(PHONE.sensor.auto_exposure, longest=longest, most_gain=16.0)
    simulator = gs.Simulator(
        replace(PHONE, sensor=replace(PHONE.sensor, auto_exposure=automatic)), device=device
    )
    loops = meter_scenes(simulator, scenes, Lags(exposure=0.1), Ramps(), PERIOD)
    made = list(made_by(simulator, scenes, [[0, *range(COUNT)]], loops=loops))
    alone = [np.log(4 * longest), np.log(4 * longest / 10)]
    expected = np.exp(step(*alone, 0.1))
    gains = [one.values.camera.sensor.analog_gain / PHONE.sensor.analog_gain for one in made]
    np.testing.assert_allclose(
        [one.values.exposure_time for one in made] * np.array(gains), expected, rtol=1e-4
    )
    np.testing.assert_allclose(
        [one.values.exposure_time for one in made], np.minimum(expected, longest), rtol=1e-4
    )


def test_white_balance_follows_the_light():
    """A step of the whites' logarithms from one light to the other; a grey wall is grey in both, and not between."""
    lit = [gs.chart("flat", size=(24, 16), light=name) for name in ("D65", "A")]
    scenes = Sequence([lit[0]] * 4 + [lit[1]] * (COUNT - 4))
    noiseless = replace(GRAY, sensor=replace(GRAY.sensor, noise=gs.Noise(photon="none")))
    simulator = gs.Simulator(noiseless, device="numpy")
    loops = meter_scenes(simulator, scenes, Lags(white=0.02), Ramps(), PERIOD)
    alone = [np.log(next(simulator.frames(one, 1)).rendering.neutral) for one in lit]
    expected = np.exp([step(before, after, 0.02) for before, after in zip(*alone, strict=True)]).T
    np.testing.assert_allclose(loops.white, expected, rtol=2e-3)  # digital numbers round
    made = [
        one.values.rgb.astype(int)
        for one in frames(simulator, scenes, [[0, *range(COUNT)]], loops=loops)
    ]
    spread = [np.ptp(one.reshape(-1, 3).mean(axis=0)) for one in made]
    assert max(spread[:4]) < 2 and spread[4] > 100 and 10 < spread[5] < spread[4] and spread[-1] < 2


def test_focus_follows_the_distance_in_dioptres():
    far, near = (
        replace(SCENE, depth=np.full(SCENE.content.shape, distance)) for distance in (5.0, 0.5)
    )
    scenes = Sequence([far] * 4 + [near] * (COUNT - 4))
    loops = meter_scenes(
        gs.Simulator(PHONE, device="numpy"), scenes, Lags(focus=0.1), Ramps(), PERIOD
    )
    np.testing.assert_allclose(1 / np.array(loops.focus), step(0.2, 2.0, 0.1), rtol=1e-12)
    assert loops.camera(PHONE, 6).optics.object_distance == loops.focus[6]
    with pytest.raises(gs.GpusimError, match=r"ramp: a loop of focus needs scene\.depth"):
        meter_scenes(
            gs.Simulator(PHONE, device="numpy"), Sequence([SCENE]), Lags(focus=0.1), Ramps(), PERIOD
        )


@pytest.fixture
def folder(tmp_path):
    """Photographs that become brighter and redder."""
    random, made = np.random.default_rng(4), tmp_path / "in"
    made.mkdir()
    for number in range(8):
        picture = random.random((24, 36, 3)) ** (3 - number / 4) * (
            1,
            1 - number / 20,
            1 - number / 10,
        )
        Image.fromarray(np.uint8(255 * picture)).save(made / f"in_{number:03d}.png")
    return made


def camera_file(tmp_path):
    path = tmp_path / "gray.toml"
    text = (Path(gs.__file__).parent / "data" / "cameras" / "phone.toml").read_text()
    head, _, tail = text.partition("[processor]\n")
    kept = "\n".join(line for line in tail.splitlines() if not line.startswith("white_balance"))
    path.write_text(f'{head}[processor]\nwhite_balance = "gray-world"\n{kept}\n')
    return path


def test_parts_and_runs_that_go_on_are_those_of_one_run(folder, tmp_path, capsys):
    asked = [
        "video",
        str(folder),
        "--camera",
        str(camera_file(tmp_path)),
        "--segment",
        "3",
        "--lag",
        "exposure=0.1,white=0.2",
        "--luminance",
        "9000",
        "--device",
        "numpy",
        "-o",
    ]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for name in (whole, parts):
        name.mkdir()
    assert main([*asked, str(whole / "a.npz")]) == 0
    for shard in ("2/3", "0/3"):
        assert main([*asked, str(parts / "a.npz"), "--shard", shard]) == 0
    (parts / "a_0001.npz").unlink()
    assert main([*asked, str(parts / "a.npz")]) == 0, capsys.readouterr().err
    for name in sorted(whole.glob("*.npz")):
        with np.load(name) as one, np.load(parts / name.name) as other:
            assert {*one} == {*other} and all(
                np.array_equal(one[part], other[part]) for part in one
            ), name
    found = json.loads((whole / "a_video.json").read_text())["loops"]
    assert len(found["seconds"]) == len(found["white"]) == 8 and found["focus"] is None
    assert found == json.loads((parts / "a_video.json").read_text())["loops"]
    assert np.ptp(found["seconds"]) > 0 and np.ptp(np.array(found["white"])[:, 2]) > 0


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["--lag", "iso=1"], "'iso=1': wanted NAME=SECONDS"),
        (["--lag", "exposure=-1"], "wanted NAME=SECONDS"),
        (["--lag", "exposure=nan"], "wanted NAME=SECONDS"),
        (["--lag", "white=1,white=2"], "each NAME once"),
        (
            ["--lag", "exposure=1", "--exposure", "1/100"],
            "--lag exposure: the exposure time is set",
        ),
        (
            ["--lag", "exposure=1", "--ramp", "exposure=1/100..1/50"],
            "--lag exposure: the exposure time is set",
        ),
        (["--lag", "focus=1", "--ramp", "focus=1..2"], "--lag focus: --ramp focus sets the focus"),
        (["--lag", "white=1"], "one of bayesian, gray-world, max-rgb, shades-of-gray, red-blue"),
        (["--lag", "focus=1"], "a loop of focus needs scene.depth"),
    ],
)
def test_loops_that_cannot_be_are_refused_in_a_line(asked, words, folder, tmp_path, capsys):
    try:
        status = main(
            [
                "video",
                str(folder),
                "--camera",
                "phone",
                "--device",
                "numpy",
                "-o",
                str(tmp_path / "a.png"),
                *asked,
            ]
        )
    except SystemExit as stopped:
        status = stopped.code
    said = capsys.readouterr().err
    assert status == 2 and words in said and "Traceback" not in said
    assert not list(tmp_path.glob("a*"))
