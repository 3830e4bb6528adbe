"""A picture that is all white or all black says so, with an exposure that would do."""

import re

import numpy as np
import pytest

import gpusim as gs

PHONE = gs.open_camera("phone")
SCENE = gs.chart("colorchecker", size=(96, 64))


def remark(camera, scene=SCENE):
    """The note on the brightness of a frame's picture, "" if there is none."""
    notes = gs.Simulator(camera, device="numpy")(scene, seed=1).report.notes
    return next((note for note in notes if note.startswith("the picture is all")), "")


@pytest.mark.parametrize(
    ("milliseconds", "word", "changes"),
    [
        (3e4, "white", {}),
        (1e-3, "black", {}),
        (3e4, "white", {"analog_gain": 8.0}),
        (1e-3, "black", {"binning": [2, 2]}),
        (3e4, "white", {"binning": [2, 2], "binning_mode": "digital"}),
    ],
)
def test_the_exposure_that_is_named_does(milliseconds, word, changes):
    """With it the brightest hundredth of the picture is bright, and the median is neither white nor black."""
    camera = PHONE.with_(**changes)
    said = remark(camera.with_(exposure_time_ms=milliseconds))
    assert said.startswith(f"the picture is all {word}: an exposure of ")
    better = float(re.search(r"([\d.e+-]+) ms would do", said)[1])
    assert f"(--exposure {better:.3g}ms, " in said
    frame = gs.Simulator(camera.with_(exposure_time_ms=better), device="numpy")(SCENE, seed=1)
    assert np.percentile(frame.rgb, 99) > 200 and 30 < np.median(frame.rgb) < 220
    assert not any(note.startswith("the picture is all") for note in frame.report.notes)


@pytest.mark.parametrize("milliseconds", ["auto", 20.0, 200.0])
def test_pictures_with_contents_are_not_remarked(milliseconds):
    assert remark(PHONE.with_(exposure_time_ms=milliseconds)) == ""


def test_a_white_scene_may_be_white():
    """A uniform scene without noise at the automatic exposure: all pixels are display white."""
    silent = PHONE.with_(photon="none", read_e=0, dark_current_e_per_s=0, prnu=0, dsnu_e=0)
    scene = gs.chart("flat", size=(48, 32))
    silent = silent.with_(relative_illumination="none", color="none", white_balance="none")
    codes = gs.Simulator(silent, device="numpy")(scene).rgb
    assert codes.max() == 255
    assert remark(silent, scene) == ""


def test_a_scene_without_light_says_so():
    dark = gs.scene_from(np.zeros((8, 8, 3)), linear=True)
    said = remark(PHONE.with_(exposure_time_ms=10), dark)
    assert said == "the picture is all black: no light reaches the sensor"
