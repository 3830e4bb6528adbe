"""Statistics of light against NumPy's own, and automatic exposure by them against the frame's own pixels."""

from dataclasses import replace
from math import prod

import numpy as np
import pytest
from devices import ALL, ALL_KINDS

import gpusim as gs
from gpusim.backends.select import open_device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.exposure import METHODS, AutoExposure, LightStatistics
from gpusim.kernels.sensor.meter import MOST_CHUNKS, STRIP, meter
from gpusim.pipeline import metering

# Sums of at most 91 float32 terms, then compensated: 110 2^-24 = 6.6e-6 at worst; roundings differ in sign, so that of
# light, of one sign, far less is left. The result is float32.
MEAN = 1e-6
RANDOM = np.random.default_rng(21)


def rates_of(kind, shape):
    if kind == "light":
        return RANDOM.gamma(2.0, 300.0, shape)
    if kind == "lamps":
        return np.where(RANDOM.random(shape) < 0.01, 1e7, RANDOM.gamma(2.0, 300.0, shape))
    if kind == "equal":
        return np.full(shape, 1234.567)
    if kind == "near":  # neighbours in float32: the lowest bits decide
        return 1000 + RANDOM.integers(0, 40, shape) * 2.0**-14
    if kind == "signs":
        return RANDOM.normal(0, 3, shape)
    if kind == "bits":  # every float32 that is finite alike
        words = RANDOM.integers(0, 2**32, shape, dtype=np.uint64).astype(np.uint32)
        values = words.view(np.float32)
        return np.where(np.abs(values) < 1e30, values, np.float32(-1e-42))  # NaN too: none are left
    return np.sort(RANDOM.exponential(1.0, shape).ravel())[::-1].reshape(shape)  # "sorted", falling


def metered(rates, fractions=(), device="auto"):
    rates = np.asarray(rates, np.float32)
    return meter(
        rates,
        np.full(rates.shape[0], 1 / rates.shape[0], np.float32),
        np.full(rates.shape[1], 1 / rates.shape[1], np.float32),
        fractions,
        device=device,
    )


def pairs(values, fractions):
    """What numpy.percentile interpolates between, by its methods that do not."""
    return np.array(
        [
            [np.percentile(values, 100 * q, method=method) for method in ("lower", "higher")]
            for q in fractions
        ]
    )


@pytest.mark.parametrize("device", ALL)
@pytest.mark.parametrize(
    "shape", [(1, 1), (7, 1), (1, 9), (41, 77), (3, STRIP + 5), (300, 401)], ids=str
)
@pytest.mark.parametrize("kind", ["light", "lamps", "equal", "near", "signs", "bits", "sorted"])
def test_statistics_are_those_of_numpy(kind, shape, device):
    rates = rates_of(kind, shape).astype(np.float32)
    exact = rates.astype(np.float64)
    fractions = (0.0, 0.25, 0.9375, 1.0)  # with them q (n - 1) is exact, and so is 100 q
    found = metered(rates, fractions, device)
    assert found.shape == (14,)
    assert (found[0], found[5], found[4]) == (rates.max(), rates.min(), 0)
    size = np.abs(exact).mean()
    assert found[1] == pytest.approx(exact.mean(), abs=MEAN * size, rel=0)
    assert found[2] == pytest.approx(
        np.abs(exact).max() * np.sqrt(np.mean((exact / np.abs(exact).max()) ** 2)), rel=MEAN
    )
    assert found[3] == pytest.approx(exact.mean(), abs=2 * MEAN * size, rel=0)
    got = found[6:].reshape(-1, 2)
    lower, higher = pairs(exact, fractions).T
    np.testing.assert_array_equal(got[:, 0], lower)
    whole = np.array(fractions) * (rates.size - 1) % 1 == 0  # there NumPy needs one alone
    np.testing.assert_array_equal(got[~whole, 1], higher[~whole])
    order = np.sort(rates.ravel())
    after = np.minimum(
        np.floor(np.array(fractions) * (rates.size - 1)).astype(int) + 1, rates.size - 1
    )
    np.testing.assert_array_equal(got[:, 1], order[after])


@pytest.mark.parametrize("device", ALL)
@pytest.mark.parametrize("q", [0.99, 0.1, 1 / 3, 2 / 3, 1 - 2.0**-53, 1e-3, 2.0**-60])
def test_ranks_are_those_of_the_float64_product(q, device):
    """0.99 100 rounds to 99, 0.1 30 to 3 and so on: below a whole number by less than half a unit."""
    for size in (2, 11, 31, 51, 101, 201, 301, 1001, 3001, 10001):
        found = metered(np.arange(size, dtype=np.float32).reshape(1, size), (q,), device)
        index = int(np.floor(q * (size - 1)))
        assert found[6:].tolist() == [index, min(index + 1, size - 1)]


@pytest.mark.parametrize("device", ALL)
def test_a_frame_of_more_pixels_than_the_smallest_chunks_hold(device):
    """Every chunk is longer then; 4.3 million pixels whose ranks are known."""
    shape = (2**16 * MOST_CHUNKS // 2048 + 3, 2048)
    rates = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)  # exact below 2^24
    RANDOM.shuffle(rates)
    found = metered(rates, (0.5, 0.999), device)
    for number, q in enumerate((0.5, 0.999)):
        index = int(np.floor(q * (rates.size - 1)))
        assert found[6 + 2 * number : 8 + 2 * number].tolist() == [index, index + 1]
    assert found[1] == pytest.approx((rates.size - 1) / 2, rel=MEAN)


@pytest.mark.parametrize("device", ALL)
@pytest.mark.parametrize("kind", ["light", "equal", "bits"])
def test_two_calls_give_equal_bits(kind, device):
    rates = rates_of(kind, (211, 515)).astype(np.float32)
    first = metered(rates, (0.1, 0.5, 0.99), device).view(
        np.uint32 if device != "numpy" else np.uint64
    )
    for _ in range(3):
        again = metered(rates, (0.1, 0.5, 0.99), device).view(first.dtype)
        np.testing.assert_array_equal(again, first)


@pytest.mark.parametrize("device", ALL)
def test_what_is_not_finite_is_left_out(device):
    rates = np.arange(1000, dtype=np.float32).reshape(10, 100)
    rates[3, :50], rates[4, 7], rates[9, 99] = np.nan, np.inf, -np.inf
    rates[5, 5] = -np.float32(np.nan)
    left = rates[np.isfinite(rates)]
    found = metered(rates, (0.5,), device)
    index = int(np.floor(0.5 * (left.size - 1)))
    assert found[[0, 4, 5, 6, 7]].tolist() == [
        left.max(),
        53,
        0,
        *np.sort(left)[[index, index + 1]],
    ]
    assert found[1] == pytest.approx(left.mean(dtype=np.float64), rel=MEAN)
    assert found[3] == pytest.approx(left.sum(dtype=np.float64) / rates.size, rel=2 * MEAN)
    assert metered(np.full((3, 5), np.inf), (0.3,), device).tolist() == [0, 0, 0, 0, 15, 0, 0, 0]


def test_refuses():
    ones = np.ones(4, np.float32)
    plane = np.ones((4, 4), np.float32)
    for arguments, error in (
        ((plane[0], ones, ones), BadData),
        ((plane[:0], ones, ones), BadData),
        ((plane, ones[:3], ones), BadData),
        ((plane, ones, plane), BadData),
        ((plane, ones, ones, (0.1,) * 5), BadData),
        ((plane, ones, ones, (1.01,)), OutOfRange),
        ((plane, ones, ones, (np.nan,)), OutOfRange),
    ):
        with pytest.raises(error):
            meter(*arguments, device="opencl")


@pytest.mark.parametrize("percentile", [3.125, 50.0, 75.0, 93.75, 100.0, 99.0, 33.3])
def test_the_percentile_is_that_of_numpy(percentile):
    """Bit for bit, where the place is a float32 too: NumPy releases differ in the precision they take it in."""
    automatic = AutoExposure("percentile", 0.9, percentile)
    for size in (1, 2, 3, 33, 1000, 4321):
        rates = RANDOM.gamma(2.0, 300.0, (1, size)).astype(np.float32)
        light = LightStatistics(
            metered(rates, automatic.fractions, "numpy").astype(np.float32), size
        )
        wanted = float(np.percentile(rates, percentile))
        # a place that errs by 4321 2^-24 moves the result by as much of the pair's difference
        assert automatic.signal_of(light) == pytest.approx(
            wanted, rel=0 if percentile * 32 % 1 == 0 else 1e-4
        )


LIGHT: dict = {}  # that falls on a device's pixels, stacked or not, however they are metered


def exposed(automatic, stacked, device):
    """A simulator that meters by `automatic`, and the electrons a second of its pixels."""
    camera = gs.open_camera("phone")
    sensor = replace(
        camera.sensor,
        exposure_time=None,
        auto_exposure=automatic,
        stacked=stacked,
        noise=replace(camera.sensor.noise, dark_current=7.7),
    )
    processor = replace(camera.processor, demosaic="bilinear")
    simulator = gs.Simulator(replace(camera, sensor=sensor, processor=processor), device=device)
    if (stacked, device) not in LIGHT:
        plan = simulator.plan(gs.chart("deadleaves", size=(83, 59)))
        LIGHT[stacked, device] = simulator.imaging.values(plan)["per second"]
    return simulator, LIGHT[stacked, device]


def choose(simulator, rates):
    """Exposure time and gain for electrons a second, an array of the device."""
    sensor, device = simulator.camera.sensor, simulator.device
    light = metering.meter_light(rates, automatic=sensor.auto_exposure, device=device)
    numbers = metering.metering_numbers(sensor, simulator.readout)
    return metering.choose_exposure(device.numpy(light), prod(rates.shape), **numbers)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize(
    "automatic",
    [
        AutoExposure(),
        AutoExposure("full"),
        AutoExposure("percentile", 0.7, 99.0),
        AutoExposure("percentile", 0.7, 37.0),
        AutoExposure("mean", 0.2),
        AutoExposure("centre", 0.3),
    ],
    ids=lambda made: f"{made.method}-{made.percentile:g}",
)
def test_the_exposure_is_that_of_the_downloaded_frame(automatic, stacked, device):
    """The order statistics' bit for bit; means within what float32 sums lose."""
    simulator, rates = exposed(automatic, stacked, device)
    frame = np.array(simulator.device.numpy(rates)) + np.float32(
        7.7 * simulator.camera.sensor.noise.warmth
    )
    wanted = automatic.choose(frame, simulator.readout.output.saturation)
    found = choose(simulator, rates)
    exact = not automatic.averages
    assert found == (wanted if exact else pytest.approx(wanted, rel=MEAN))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_light_that_is_not_finite_is_refused(method, device):
    camera = gs.open_camera("phone")
    sensor = replace(camera.sensor, exposure_time=None, auto_exposure=AutoExposure(method))
    simulator = gs.Simulator(replace(camera, sensor=sensor), device=device)
    rates = np.ones((20, 30), np.float32)
    rates[3, 4], rates[5, :2] = np.nan, np.inf
    with pytest.raises(BadData, match="3 of 600 pixels have NaN or infinite light"):
        choose(simulator, simulator.device.array(rates))


def test_statistics_of_more_light_are_those_of_the_sum():
    rates = RANDOM.gamma(2.0, 300.0, (37, 53))
    wide = AutoExposure("percentile", 0.5, 80.0)
    of = [
        LightStatistics(
            meter(light, *wide.weights(light.shape), wide.fractions, device="numpy"), light.size
        )
        for light in (rates, rates + 12.5)
    ]
    # float64: a few roundings of 1.1e-16 on either side
    np.testing.assert_allclose(of[0].plus(12.5).values, of[1].values, rtol=1e-12)


def test_stages_on_a_device_stay_there():
    device = open_device("opencl")
    ones = device.array(np.ones(4, np.float32))
    assert isinstance(
        meter(device.array(np.ones((4, 4), np.float32)), ones, ones, device=device),
        device.array_type,
    )
