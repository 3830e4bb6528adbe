"""Exposure value and automatic exposure, against ISETCam's results and by hand."""

from pathlib import Path

import numpy as np
import pytest

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.exposure import auto_exposure, exposure_value

# ISETCam 3b10ec1 (MIT licence), run in GNU Octave in float64: exposureValue over 7 f-numbers x 6 times; autoExposure
# "full" and "cfa" of one scene at 95 % of a 1 V swing, with the highest noise-free volts after 1 s.
ISET = np.load(Path(__file__).parent / "data" / "iset_exposure.npz")
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
    assert (rate * auto_exposure(rate, 6000, 0.3, "mean")).mean() == pytest.approx(0.3 * 6000, rel=1e-13)


def test_mean_of_many_float32_pixels_is_summed_in_double():
    rate = np.full((1000, 1000), 0.1, np.float32)
    # In float32, 1e6 terms of 0.1 may err by 1e6 * 6e-8 = 6 %; in double the sum is good to 1e6 * 1.1e-16.
    assert auto_exposure(rate, 1.0, 1.0, "mean") == pytest.approx(1 / float(np.float32(0.1)), rel=2e-10)


def test_a_dark_scene_has_no_exposure():
    with pytest.raises(BadData, match="exposure_time"):
        auto_exposure(np.zeros((4, 4)), 6000)
    with pytest.raises(BadData):
        auto_exposure(np.array([1.0, np.nan]), 6000)


@pytest.mark.parametrize(("arguments", "error", "key"), [
    ((1.0, 6000, 0.0), OutOfRange, "level"),
    ((1.0, 6000, 1.01), OutOfRange, "level"),
    ((1.0, 0.0), OutOfRange, "saturation"),
    ((1.0, 6000, 0.95, "ful"), UnknownName, "did you mean 'full'"),
])
def test_refuses(arguments, error, key):
    with pytest.raises(error, match=key):
        auto_exposure(*arguments)
