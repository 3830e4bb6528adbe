"""The sensor beyond what the hard cases ask (test_hard.py runs these); truth is probability theory."""

import numpy as np
import pytest
from test_noise import sampler

from gpusim.domain.errors import OutOfRange
from gpusim.judge.hard.acceptance import check
from gpusim.judge.hard.maps import probabilities
from gpusim.judge.hard.photons import IMPOSSIBLE, MEANS, f32, steps
from gpusim.pipeline.readout import checked_electrons


@pytest.mark.parametrize("photon", ["fast", "exact"])
def test_19_one_photon_in_1e8_pixels(photon):
    p = probabilities(1e-8, photon)[1]
    # asked for within 1 %; by the map all but exact: 1e-6 is the float32 of the mean and 2^-53 / 1e-8 of the numbers
    assert p[1:].sum() == pytest.approx(-np.expm1(-1e-8), rel=1e-6)
    assert p[2:].sum() < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("mean", MEANS)
def test_19_exact_poisson_numbers_of_4_million_pixels(mean):
    check(sampler(mean, "exact", 2**11), float(f32(mean)))


@pytest.mark.parametrize("value", IMPOSSIBLE)
def test_20_a_camera_refuses_them(value):
    mean = np.ones((3, 4))
    mean[1, 2] = value
    with pytest.raises(OutOfRange, match=r"\(1, 2\).*0 <= electrons < inf"):
        checked_electrons(mean, None)


def test_21_the_exact_sampler_has_no_step():
    """See test_no_step_at_the_switch: a total variation of 2.4e-7 within 8 standard deviations, squared."""
    assert steps("exact") < 1e-5
