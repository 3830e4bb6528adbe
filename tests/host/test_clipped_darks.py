"""Dark frames that are clipped at 0: level and noise before clipping, against formulas and drawn frames."""

import math

import numpy as np
import pytest

import gpusim as gs
from gpusim.fit import clipped
from gpusim.fit.stack import FrameStack

SHAPE, COUNT = (60, 64), 8
READ, ROW, DSNU = 3.0, 1.0, 1.5


def draw(level, count, seed=0, electrons=0.0, gain=0.5):
    """Frames of one chip, an array (count, rows, cols) [DN]."""
    rng = np.random.default_rng([seed, 1])
    offset = DSNU * rng.standard_normal(SHAPE)
    rng = np.random.default_rng([seed, int(electrons)])
    values = level + offset + gain * rng.poisson(electrons, (count, *SHAPE))
    values = values + READ * rng.standard_normal((count, *SHAPE))
    values = values + ROW * rng.standard_normal((count, SHAPE[0], 1))
    return np.maximum(np.rint(values), 0).astype(np.uint16)


def test_moments_of_clipped_normal_numbers():
    """Of a normal number x: E max(x, 0) = s / sqrt(2 pi), E max(x, 0)^2 = s^2 / 2; rounding adds 1 / 24."""
    s = 50.0
    mean, variance = clipped._staircase(0.0, s)
    assert mean == pytest.approx(s / math.sqrt(2 * math.pi), rel=1e-4)
    # rounding of the upper half: 1/12 of half of the numbers
    assert variance == pytest.approx(s**2 * (1 / 2 - 1 / (2 * math.pi)) + 1 / 24, rel=1e-4)
    assert clipped._normal_of(mean, variance) == pytest.approx((0.0, s), abs=1e-3)


@pytest.mark.parametrize("r", [0.05, 0.5, 0.9])
def test_correlation_of_clipped_normal_numbers(r):
    """E max(x, 0) max(y, 0) = s^2 / (2 pi) (sqrt(1 - r^2) + r (pi - arccos r)) (Cho and Saul 2009)."""
    s = 50.0
    product = s**2 / (2 * math.pi) * (math.sqrt(1 - r**2) + r * (math.pi - math.acos(r)))
    covariance = product - s**2 / (2 * math.pi)
    found = clipped._correlation(covariance, clipped._series(0.0, s))
    assert found == pytest.approx(r, rel=1e-3)


def stacked(frames):
    found = FrameStack((1, 1), is_dark=True)
    for one in frames:
        found.add(one)
    return found


@pytest.mark.parametrize("level", [-1.0, 2.0])
def test_noise_before_clipping(level):
    stack, good = stacked(draw(level, COUNT)), np.ones(SHAPE, bool)
    assert clipped.is_clipped(stack, good)
    found = clipped.unclip(stack, good)
    for name, truth in (
        ("level", level),
        ("pixel", READ**2),
        ("row", ROW**2),
        ("column", 0.0),
        ("fixed_pixel", DSNU**2),
    ):
        value, low, high = getattr(found, name)
        assert abs(value - truth) <= 4 * (high - low) / 3.92, name  # 4 standard errors
        assert high - low < 2.5, name  # [DN], [DN^2]


def test_frames_above_zero_are_not_clipped():
    assert not clipped.is_clipped(stacked(draw(30, COUNT)), np.ones(SHAPE, bool))


def save(folder, level):
    for kind, electrons, count in (
        ("darks", 0, COUNT),
        *(("flats", n, 2) for n in (200, 500, 999)),
    ):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for k, one in enumerate(draw(level, count, electrons=electrons)):
            np.savez(
                folder / kind / f"{electrons}_{k}.npz", dn=one, exposure_time_s=1e-3 + electrons
            )


def test_dark_frames_of_zeros_give_bounds(tmp_path):
    save(tmp_path, -12.0)
    found = gs.fit(tmp_path)
    read, black = (found.estimates[key] for key in ("noise.read_e", "sensor.black_level_dn"))
    assert "bounds" in read.note and read.low == 0 and read.high > READ / 0.5
    assert black.low < -12 < black.high
    assert any("nearly all values of dark frames are 0" in line for line in found.unexplained)
    found.write(tmp_path / "mine.toml")
    assert gs.open_camera(tmp_path / "mine.toml").sensor.black_level == 0
