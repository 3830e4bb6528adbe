"""Rows exposed one after the other: the planner's weights and the stage that applies them, against closed forms."""

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.sensor.shutter import shutter, spans
from gpusim.optics.shutter import shutter_weights

FLOAT32 = 2.0**-24  # half an ulp, relative


@pytest.mark.parametrize(
    "times",
    [
        np.linspace(0, 0.05, 2),
        np.linspace(-0.01, 0.06, 23),
        np.sort(np.random.default_rng(0).uniform(0, 0.05, 40)).tolist(),
    ],
)
@pytest.mark.parametrize(
    ("exposure_time", "row_time"), [(0.01, 3e-4), (2e-5, 3e-4), (0.02, 0.0), (0.013, 1e-6)]
)
def test_weights_integrate_the_interpolated_rate(times, exposure_time, row_time):
    """Against the integral of numpy.interp, by Simpson's rule between all kinks, where it is exact."""
    rows, start, random = 30, 0.004, np.random.default_rng(1)
    times = np.unique([0.0, *times, 0.05])
    rates = random.uniform(0, 1, (len(times), rows))
    weights = shutter_weights(times, rows, exposure_time, row_time, start)
    for y in range(rows):
        low = start + y * row_time
        kinks = np.unique(
            [low, *times[(times > low) & (times < low + exposure_time)], low + exposure_time]
        )
        a, b = kinks[:-1], kinks[1:]
        value = (
            (
                np.interp(a, times, rates[:, y])
                + 4 * np.interp((a + b) / 2, times, rates[:, y])
                + np.interp(b, times, rates[:, y])
            )
            * (b - a)
            / 6
        )
        # float64: times of 0.05 round by 7e-18, which over the shortest exposure, 2e-5, is 3.5e-13
        assert weights[y] @ rates[:, y] == pytest.approx(value.sum(), rel=1e-11)
    assert (weights >= 0).all()
    np.testing.assert_allclose(
        weights.sum(axis=1), exposure_time, rtol=1e-15 * len(times)
    )  # one rounding a term


def test_times_far_from_zero_do_not_lose_the_exposure():
    """Time stamps of a day: they round by 7e-12 s, which moves the exposure but does not change its length."""
    times = 86400 + np.linspace(0, 0.04, 21)
    weights = shutter_weights(times, 100, 1e-3, 3.9e-4, 86400)
    np.testing.assert_allclose(weights.sum(axis=1), 1e-3, rtol=1e-14)
    # a shift of 2 x 7e-12 s in a step of 2e-3 s changes the share of an instant by 7e-9 of the exposure
    np.testing.assert_allclose(
        weights, shutter_weights(times - 86400, 100, 1e-3, 3.9e-4), atol=1e-3 * 2e-8
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_rates_linear_in_time_are_exact(device):
    rows, cols, exposure_time, row_time, start = 40, 9, 0.008, 5e-4, 0.003
    times = np.sort(np.random.default_rng(2).uniform(0, 0.04, 13))
    times[0], times[-1] = 0, 0.04
    level = np.random.default_rng(3).uniform(100, 1000, (rows, cols))
    slope = np.random.default_rng(4).uniform(-1e4, 1e5, (rows, cols))
    rates = (level + times[:, None, None] * slope).astype(np.float32)
    middle = start + row_time * np.arange(rows)[:, None] + exposure_time / 2
    mean = shutter(
        rates, shutter_weights(times, rows, exposure_time, row_time, start), device=device
    )
    # rates below 5000 e-/s round, then the weights, then at most 13 products and sums: 15 half ulps of the largest
    np.testing.assert_allclose(
        mean, exposure_time * (level + slope * middle), atol=15 * FLOAT32 * 5e3 * exposure_time
    )


def edge(position, cols):
    """Share of each pixel that lies left of the edge, shape (..., cols)."""
    return np.clip(np.asarray(position)[..., None] - np.arange(cols), 0, 1)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("row_time", [0.0, 2e-4])
def test_a_moving_edge_is_skewed_by_speed_times_row_time(device, row_time):
    rows, cols, speed, exposure_time = (
        60,
        120,
        4000.0,
        4e-3,
    )  # [pixel/s]; the edge runs 16 pixels in an exposure
    times = np.linspace(0, 0.02, 27)
    rates = np.broadcast_to(
        edge(20 + speed * times, cols)[:, None], (len(times), rows, cols)
    ).astype(np.float32)
    mean = shutter(rates, shutter_weights(times, rows, exposure_time, row_time), device=device)
    # the light of a row is the edge's mean position: linear in time, so exact but for float32 on 120 pixels of at most
    # 14 roundings each: 1e-4 pixel
    position = np.float64(mean).sum(axis=1) / exposure_time
    assert np.abs(np.diff(position) - speed * row_time).max() < 1e-3
    np.testing.assert_allclose(
        position, 20 + speed * (row_time * np.arange(rows) + exposure_time / 2), atol=1e-3
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("exposure_time", [1e-3, 1 / 300, 1 / 100, 1 / 60, 0.03])
def test_a_lamp_of_100_hz_makes_bands(device, exposure_time):
    """The mean of cos(2 pi f t) over an exposure T is sinc(f T) times that of the exposure's middle."""
    frequency, depth, rows, row_time = 100.0, 0.8, 400, 1e-4  # four whole periods
    end = (rows - 1) * row_time + exposure_time
    times = np.linspace(0, end, int(np.ceil(end / 1e-4)) + 1)
    rates = (1 + depth * np.cos(2 * np.pi * frequency * times)).astype(np.float32)
    rates = np.ascontiguousarray(np.broadcast_to(rates[:, None, None], (len(times), rows, 1)))
    mean = (
        shutter(rates, shutter_weights(times, rows, exposure_time, row_time), device=device)[:, 0]
        / exposure_time
    )
    middle = row_time * np.arange(rows) + exposure_time / 2
    wave = np.exp(-2j * np.pi * frequency * middle)
    amplitude = 2 * (np.float64(mean) @ wave).real / rows / depth
    # straight lines between instants h apart err by at most (2 pi f h)^2 / 8 = 4.9e-4 of the wave, float32 by less than
    # 302 half ulps, 1.8e-5 (the exposure of 0.03 s)
    assert amplitude == pytest.approx(np.sinc(frequency * exposure_time), abs=5.2e-4)
    assert np.mean(mean) == pytest.approx(1, abs=5.2e-4)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_no_row_time_is_a_global_shutter(device):
    random = np.random.default_rng(5)
    pictures = random.uniform(0, 100, (6, 1, 7)).astype(np.float32)
    rates = np.ascontiguousarray(np.broadcast_to(pictures, (6, 33, 7)))
    mean = shutter(rates, shutter_weights(np.linspace(0, 1, 6), 33, 0.5, 0.0, 0.3), device=device)
    assert (mean == mean[0]).all()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_still_scene_needs_one_instant(device):
    rates = np.random.default_rng(6).uniform(1, 1000, (1, 20, 31)).astype(np.float32)
    weights = shutter_weights([123.0], 20, 0.01, 1e-3)
    # the weight and the product round
    np.testing.assert_allclose(
        shutter(rates, weights, device=device), 0.01 * rates[0].astype(float), rtol=2 * FLOAT32
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_instants_that_do_not_matter_to_a_row_are_not_read(device):
    """NaN wherever a row is closed: it would spread if it were multiplied by zero."""
    rows = 50
    weights = shutter_weights(np.linspace(0, 0.06, 61), rows, 2.5e-3, 1e-3)
    used = spans(weights)
    # 2.5 steps of 1 ms touch at most 4 instants, less the last where a row closes on the one before
    assert (used[:, 1] - used[:, 0]).max() <= 4
    assert (
        used[:, 0] == np.arange(rows)
    ).mean() > 0.8  # but where rounding makes a row open just before its instant
    rates = np.full((61, rows, 5), np.nan, np.float32)
    for y, (first, end) in enumerate(used):
        rates[first:end, y] = 3
    # four weights, products and sums round
    np.testing.assert_allclose(shutter(rates, weights, device=device), 3 * 2.5e-3, rtol=6 * FLOAT32)


@pytest.mark.parametrize(
    ("times", "start"),
    [
        ([0, 0.01], 0.0),
        ([0.001, 0.05], 0.0),
        ([0, 0.05], -1e-6),
        ([0, 0.0199], 0.0),
        ([0.0, 0.02], 1e-6),
    ],
)
def test_an_exposure_that_is_not_covered_is_refused(times, start):
    with pytest.raises(OutOfRange) as error:
        shutter_weights(times, 11, 0.01, 1e-3, start)
    assert f"{times[0]:.9g} .. {times[-1]:.9g} s" in str(error.value)
    assert f"{start:.9g} .. {start + 0.02:.9g} s" in str(error.value)


@pytest.mark.parametrize("rows", [3, 7, 1080, 4321])
def test_instants_that_end_with_the_last_row_are_enough(rows):
    """Whatever the last bits of a time stamp, here of 86400 s: they may cut 7e-12 s off an exposure of 1 / 30 s."""
    for start in (0.0, 0.1, 86400.1):
        times = start + np.linspace(0, (rows - 1) * 1.1e-5 + 1 / 30, 5)
        weights = shutter_weights(times, rows, 1 / 30, 1.1e-5, start)
        np.testing.assert_allclose(weights.sum(axis=1), 1 / 30, rtol=1e-14)


@pytest.mark.parametrize("times", [[], [0, 0], [1, 0], [0, np.nan], [np.inf], [[0, 1]]])
def test_instants_that_do_not_rise_are_refused(times):
    with pytest.raises(BadData, match="rising"):
        shutter_weights(times, 1, 0.1, 0)


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"rows": 0}, "rows"),
        ({"exposure_time": 0.0}, "exposure_time"),
        ({"exposure_time": np.inf}, "exposure_time"),
        ({"row_time": -1e-9}, "row_time"),
        ({"row_time": np.nan}, "row_time"),
        ({"start": np.nan}, "start"),
    ],
)
def test_numbers_out_of_range_are_refused(changed, key):
    with pytest.raises(OutOfRange, match=key):
        shutter_weights(
            **{"times": [0, 1], "rows": 3, "exposure_time": 0.1, "row_time": 0.0, **changed}
        )
