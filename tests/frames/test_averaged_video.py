"""Frames of a video averaged with those before them: less noise at rest, no ghosts, equal in parts of the video."""

import numpy as np
import pytest

import gpusim as gs
from gpusim.apps.video.averaged import average_recent, averaged_frames
from gpusim.apps.video.scenes import Still
from gpusim.apps.video.video import frames


def phone(exposure_time_ms=4.0):
    return gs.open_camera("phone").with_(exposure_time_ms=exposure_time_ms, demosaic="bilinear")


def picture(square):
    """A grey picture with a bright square of 24 x 24 pixels whose left column is given."""
    codes = np.full((96, 128, 3), 90, np.uint8)
    codes[36:60, square : square + 24] = 220
    return gs.picture(codes, luminance=100)


@pytest.mark.parametrize("count", [2, 4])
def test_noise_at_rest_falls_as_of_that_many_frames(count):
    """The variance of temporal noise is 1 / n: of differences of two videos, so that fixed patterns do not count.

    `merge_burst` is within 2 % of it. The difference has 96 x 128 raw values, whose variance errs by
    1.3 % (1 sigma), so its ratio by 1.8 %: three of these and the 2 %.
    """
    simulator = gs.Simulator(phone(), device="opencl")
    scenes = Still(gs.chart("flat", size=(128, 96), luminance=100), 5)
    electrons = {}
    for seed in (1, 2):
        for label, make in (
            ("one", frames(simulator, scenes, [[4, 4]], seed=seed)),
            ("mean", averaged_frames(simulator, scenes, [[4, 4]], count=count, seed=seed)),
        ):
            (made,) = make
            assert made.number == 4
            electrons[label, seed] = made.values.mean if label == "mean" else made.values
    one = [
        (frame.raw - frame.camera.sensor.dark_level) / frame.camera.sensor.gain_dn_per_electron
        for frame in (electrons["one", 1], electrons["one", 2])
    ]
    of_one = np.var(one[0] - one[1])
    of_mean = np.var((electrons["mean", 1] - electrons["mean", 2]) / count)
    assert of_mean / of_one == pytest.approx(1 / count, rel=0.02 + 3 * 0.018)


def test_what_moves_has_no_ghost():
    """A square that has jumped: where it was, and where it is, the mean is the newest frame's within 3 of its sigma.

    Without the mask the older frame would be off by half the contrast, a hundred sigma of this mean.
    Around the square noise falls.
    """
    simulator = gs.Simulator(phone(), device="opencl")
    older, newest = (simulator(picture(left), seed=left) for left in (20, 70))
    merged = average_recent(simulator, [older, newest])
    truth = simulator(picture(70), seed=5)
    noise = (truth.linear - newest.linear)[8:28].std() / np.sqrt(2)  # of one frame, in the grey
    for left in (24, 74):
        inner = (slice(40, 56), slice(left, left + 16))
        difference = merged.linear[inner].mean() - truth.linear[inner].mean()
        bright = np.sqrt(max(truth.linear[inner].mean() / truth.linear[8:28].mean(), 1.0))
        # two means of 16 x 16 pixels, in each of which a sample counts for up to four
        assert abs(difference) < 3 * noise * bright * np.sqrt(2 * 4 / 256)
    quiet = (merged.linear - truth.linear)[8:28].std()
    assert quiet < 0.95 * noise * np.sqrt(2)


def test_frames_of_another_exposure_are_left_out():
    simulator = gs.Simulator(phone(), device="opencl")
    scene = picture(20)
    first = simulator(scene, seed=1)
    other = gs.Simulator(phone(2.0), device="opencl")(scene, seed=2)
    alone = average_recent(simulator, [other, first])
    assert alone is first
    both = average_recent(simulator, [first, other, simulator(scene, seed=3)])
    assert both.exposure_time == pytest.approx(2 * first.exposure_time)


def test_a_later_part_of_a_video_is_that_of_the_whole():
    """Frames 3 and 4 alone, with those before them computed again, and in a run from the first on."""
    simulator = gs.Simulator(phone(), device="opencl")
    scenes = Still(picture(20), 5)
    settings = {"count": 3, "seed": 7, "output": "codes"}
    whole = list(averaged_frames(simulator, scenes, [[0, *range(5)]], **settings))
    part = list(averaged_frames(simulator, scenes, [[3, 3, 4]], late=True, **settings))
    assert [made.number for made in part] == [3, 4]
    for made in part:
        np.testing.assert_array_equal(made.values(), whole[made.number].values)
