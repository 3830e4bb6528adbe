"""What real frames showed: telegraph pixels among hot ones, a photon transfer that is no line, false corners."""

import math

import numpy as np
import pytest

from gpusim.fit.board import Board
from gpusim.fit.bundle import Geometry, drop_strays
from gpusim.fit.darks import find_hot
from gpusim.fit.intervals import fit_line, widened_by_misfit


def far(excess):
    return np.abs(excess) > 5


def test_pixels_that_fall_as_often_as_they_rise_are_not_hot():
    rng = np.random.default_rng(1)
    excess = rng.normal(size=(200, 200))
    jumping = rng.random(excess.shape) < 0.01
    excess += jumping * rng.choice((-8, 8), excess.shape)
    assert find_hot(excess, far(excess), 1.0) is None


def test_hot_pixels_are_counted_among_telegraph_pixels():
    rng = np.random.default_rng(2)
    excess = rng.normal(size=(400, 400))
    excess += (rng.random(excess.shape) < 0.003) * rng.choice((-8, 8), excess.shape)
    hot = rng.random(excess.shape) < 0.02
    excess += hot * rng.exponential(20, excess.shape)
    found = find_hot(excess, far(excess), 1.0)
    assert found.share.low < 0.02 < found.share.high
    assert found.scale.low < 20 < found.scale.high


def test_errors_of_a_line_hold_its_misfit():
    x = np.linspace(0, 10, 11)
    bent, variance = x + 0.1 * x**2, np.full(11, 1e-6)
    line = fit_line(x, bent, variance)
    wide = widened_by_misfit(line)
    assert wide.slope == line.slope
    # the residuals' own scatter in place of the stated errors
    scatter = np.sum((bent - line.at(x)) ** 2) / 9 / 1e-6
    assert wide.covariance[1, 1] == pytest.approx(line.covariance[1, 1] * scatter)
    straight = fit_line(x, x, variance)
    assert widened_by_misfit(straight) is straight


def geometry(residuals):
    eye = np.eye(3)
    return Geometry(eye, np.zeros(5), np.zeros(9), (), (), np.zeros(9), [residuals], True)


@pytest.mark.parametrize("strays, kept", [(1, 53), (0, 54), (20, 54)])
def test_a_few_corners_far_from_the_model_are_dropped(strays, kept):
    rng = np.random.default_rng(3)
    residuals = rng.normal(0, 0.1, (54, 2))
    residuals[:strays] += 40
    places = np.stack(np.divmod(np.arange(54), 9), 1).astype(float)
    board = Board("one", places, places * 30, {"R": np.zeros((54, 2))})
    (found,) = drop_strays([board], geometry(residuals))
    assert len(found.places) == len(found.corners) == len(found.offsets["R"]) == kept


def test_the_best_known_dark_current_is_in_the_file():
    from types import SimpleNamespace

    from gpusim.fit.noise_part import _temperatures

    rates = {4.7: (14.0, 34.0), 5.4: (0.1, 0.4), None: (9.0, 0.1)}
    fit = SimpleNamespace(dark_line=SimpleNamespace(rates=rates), gain=0.5)
    found = _temperatures(fit, {})
    assert found["temperature_c"] == 5.4
    assert math.isclose(found["dark_current_e_per_s"], 0.2)
