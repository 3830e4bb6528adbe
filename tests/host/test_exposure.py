"""Exposure value and automatic exposure, against ISETCam's results and by hand."""

from pathlib import Path

import numpy as np
import pytest

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.exposure import (
    AutoExposure,
    auto_exposure,
    bracket_times,
    checked_time,
    exposure_time,
    exposure_value,
    without_highlights,
)

# ISETCam 3b10ec1 (MIT licence), run in GNU Octave in float64: exposureValue over 7 f-numbers x 6 times; autoExposure
# "full" and "cfa" of one scene at 95 % of a 1 V swing, with the highest noise-free volts after 1 s.
ISET = np.load(Path(__file__).parents[1] / "data" / "iset_exposure.npz")
# Both sides are a division and at most one logarithm in float64: a few units of 2.2e-16, relative to values up to 17.
RTOL = 1e-12


def test_exposure_value_agrees_with_isetcam():
    ev = exposure_value(ISET["fnumbers"][:, None], ISET["times"][None, :])
    np.testing.assert_allclose(ev, ISET["EV"], rtol=RTOL)


def test_one_stop_is_one():
    assert exposure_value(1.0, 1.0) == 0
    assert exposure_value(4.0, 1 / 64) == 10  # log2(16 * 64), exact in binary


def test_full_exposure_agrees_with_isetcam():
    # One pixel is the brightest, whatever the others are; 1 V is the saturation.
    rate = np.array([[0.1, float(ISET["volts_per_second"])], [2.0, 0.0]])
    assert auto_exposure(rate, 1.0) == pytest.approx(float(ISET["ae_full"]), rel=RTOL)


def test_exposure_of_each_mosaic_position_agrees_with_isetcam():
    for rate, time in zip(ISET["cfa_volts_per_second"].flat, ISET["ae_cfa"].flat, strict=True):
        assert auto_exposure(rate, 1.0) == pytest.approx(time, rel=RTOL)


def test_full_brings_the_brightest_pixel_and_mean_the_average_to_the_level():
    rate = np.random.default_rng(1).uniform(10, 5000, (40, 60))
    # Two roundings (product and quotient) of 1.1e-16 each, and those of the sum over 2400 pixels.
    assert (rate * auto_exposure(rate, 6000, 0.8)).max() == pytest.approx(0.8 * 6000, rel=1e-13)
    assert (rate * auto_exposure(rate, 6000, 0.3, "mean")).mean() == pytest.approx(
        0.3 * 6000, rel=1e-13
    )


def test_mean_of_many_float32_pixels_is_summed_in_double():
    rate = np.full((1000, 1000), 0.1, np.float32)
    # In float32, 1e6 terms of 0.1 may err by 1e6 * 6e-8 = 6 %; in double the sum is good to 1e6 * 1.1e-16.
    assert auto_exposure(rate, 1.0, 1.0, "mean") == pytest.approx(
        1 / float(np.float32(0.1)), rel=2e-10
    )


def test_a_dark_scene_has_no_exposure():
    with pytest.raises(BadData, match="exposure_time"):
        auto_exposure(np.zeros((4, 4)), 6000)
    with pytest.raises(BadData):
        auto_exposure(np.array([1.0, np.nan]), 6000)


def test_exposure_value_by_hand_and_back():
    assert exposure_value(8.0, 1 / 125) == pytest.approx(
        12.965784284662087, rel=RTOL
    )  # log2(64 x 125) = log2(8000)
    assert exposure_time(10, 4.0) == 1 / 64
    assert exposure_time(-2, 1.0) == 4
    numbers, times = np.array([0.95, 1.8, 22.0])[:, None], np.array([1e-6, 1 / 60, 30.0])
    np.testing.assert_allclose(
        exposure_time(exposure_value(numbers, times), numbers),
        np.broadcast_to(times, (3, 3)),
        rtol=RTOL,
    )


def test_bracket_is_in_stops():
    np.testing.assert_array_equal(bracket_times(0.01, (-2, 0, 3)), [0.0025, 0.01, 0.08])
    np.testing.assert_array_equal(bracket_times(0.01, 1), [0.02])
    # one stop more of time is one less of exposure value
    assert exposure_value(2.0, bracket_times(0.01, 1)) == pytest.approx(
        exposure_value(2.0, 0.01) - 1, rel=RTOL
    )


def test_percentile_leaves_lamps_out():
    rate = np.full((10, 100), 200.0)
    rate[0, :5] = 1e6  # 0.5 % of the pixels
    time, gain = AutoExposure("percentile", 0.5, 99.0).choose(rate, 6000)
    assert (time, gain) == (pytest.approx(0.5 * 6000 / 200, rel=RTOL), 1.0)


@pytest.mark.parametrize(
    ("times", "counted"),
    [
        (1.0, 1.0),
        (1.4, 1.4),
        (2.0, 1.125),
        (2.25, 1.0),
        (20.0, 1.0),
        (100.0, 1.0),
        (1000.0, 100.0),
        (1e4, 1e4),
        (1e9, 1e9),
    ],
)
def test_glints_do_not_darken_the_picture(times, counted):
    """Of 10,000 pixels of light 1 one is `times` as bright: a part of the picture, a glint or a star.

    1.5^2 / 2 = 1.125; (1000 / 100)^2 = 100.
    """
    rate = np.ones((100, 100))
    rate[3, 4] = times
    assert AutoExposure().choose(rate, 6000)[0] == pytest.approx(0.95 * 6000 / counted, rel=RTOL)
    ratios = np.geomspace(0.1, 1e6, 10_000)  # no jump: steps of .16 %, of the square .32 %
    assert abs(np.diff(np.log([without_highlights(1.0, ratio) for ratio in ratios]))).max() < 0.0033


@pytest.mark.parametrize("method", ["mean", "centre"])
def test_averages_put_white_where_bright_pixels_are(method):
    """A grey of 18 % is the average; white has 1 / .18 of it, 95 % of saturation as by the brightest pixel."""
    rate = np.full((8, 8), 18.0)
    assert 100 * AutoExposure(method).choose(rate, 6000)[0] == pytest.approx(0.95 * 6000, rel=RTOL)
    assert AutoExposure(method).white == pytest.approx(0.95, rel=RTOL)
    assert AutoExposure(method, 0.3).choose(rate, 6000)[0] == pytest.approx(
        0.3 * 6000 / 18, rel=RTOL
    )


def test_a_scene_without_light_but_for_a_star_is_exposed_for_it():
    rate = np.zeros((100, 100))
    rate[3, 4] = 5.0
    assert AutoExposure().choose(rate, 6000)[0] == pytest.approx(0.95 * 6000 / 5, rel=RTOL)


def test_centre_counts_more_than_the_corners():
    """Four columns have their middles 3/8 and 1/8 of the frame from its middle; the Gaussian's sigma is 1/5."""
    side, middle = np.exp(-0.5 * (0.375 / 0.2) ** 2), np.exp(-0.5 * (0.125 / 0.2) ** 2)
    for column, weight in enumerate((side, middle, middle, side)):
        rate = np.zeros((1, 4))
        rate[0, column] = 1000.0
        signal = AutoExposure("centre").signal(rate)
        assert signal == pytest.approx(1000 * weight / (2 * side + 2 * middle), rel=RTOL)
    assert AutoExposure("centre").signal(np.full((3, 7, 9), 5.0)) == pytest.approx(5, rel=RTOL)


def test_gain_is_raised_where_the_time_is_cut_short():
    rate = np.array([[100.0]])  # 0.5 of 6000 e- take 30 s
    for longest, most, expected in (
        (40.0, 8.0, (30.0, 1.0)),
        (30.0, 8.0, (30.0, 1.0)),
        (10.0, 8.0, (10.0, 3.0)),
        (10.0, 2.0, (10.0, 2.0)),
        (10.0, 1.0, (10.0, 1.0)),
    ):
        assert AutoExposure(level=0.5, longest=longest, most_gain=most).choose(
            rate, 6000
        ) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"level": np.nan}, OutOfRange, "level = nan"),
        ({"percentile": 0.0}, OutOfRange, "percentile = 0 %"),
        ({"percentile": 101.0}, OutOfRange, "percentile"),
        ({"longest": 0.0}, OutOfRange, "longest = 0 s"),
        ({"longest": np.inf}, OutOfRange, "longest"),
        ({"most_gain": 0.5}, OutOfRange, "most_gain = 0.5"),
        ({"method": "center"}, UnknownName, "did you mean 'centre'"),
    ],
)
def test_automatic_exposure_refuses(changes, error, words):
    with pytest.raises(error, match=words):
        AutoExposure(**changes)


@pytest.mark.parametrize("time", [0, -1.0, np.nan, np.inf, 2e12])
def test_times_that_are_none(time):
    with pytest.raises(OutOfRange, match="exposure_time = "):
        checked_time(time)
    assert checked_time(None) is None and checked_time(0.5) == 0.5


@pytest.mark.parametrize(
    ("arguments", "error", "key"),
    [
        ((1.0, 6000, 0.0), OutOfRange, "level"),
        ((1.0, 6000, 1.01), OutOfRange, "level"),
        ((1.0, 0.0), OutOfRange, "saturation"),
        ((1.0, 6000, 0.95, "ful"), UnknownName, "did you mean 'full'"),
    ],
)
def test_refuses(arguments, error, key):
    with pytest.raises(error, match=key):
        auto_exposure(*arguments)
