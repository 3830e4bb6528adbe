"""Events against closed forms of ramps and waves, and the rate of noise against a chain of Markov's."""

import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import KINDS
from scipy.stats import norm

import gpusim as gs
from gpusim.captures.events import EVENT
from gpusim.captures.photoreceptor import SHARE, Photoreceptor, noise_deviation
from gpusim.domain.errors import BadData, OutOfRange

QUIET = {"mismatch": 0.0, "leak": 0.0, "window": 0.0, "dark": 1e-12}


def of_function(sensor, logarithm, times, shape=(1, 1)):
    return sensor.events(times, (np.full(shape, np.exp(logarithm(time))) for time in times))


@pytest.mark.parametrize("slope", [2.1, -3.3])
@pytest.mark.parametrize("refractory", [0.0, 0.004, 0.05])
def test_a_ramp(slope, refractory):
    """Light that grows exponentially crosses a threshold every threshold / slope, and the refractory time later."""
    sensor = gs.EventSensor(on=0.2, off=0.13, refractory=refractory, **QUIET)
    found = of_function(sensor, lambda time: 3 + slope * time, np.linspace(0, 1, 41), (2, 3))
    threshold = 0.2 if slope > 0 else 0.13
    period = threshold / abs(slope) + refractory
    expected = np.arange(1, 100) * period - refractory
    expected = expected[expected < 1]
    assert len(found) == 6 * len(expected) and (np.sign(slope) == found["p"]).all()
    for y in range(2):
        for x in range(3):
            own = found[(found["y"] == y) & (found["x"] == x)]
            np.testing.assert_allclose(own["t"], expected, atol=1e-9)


def crossings(amplitude, threshold, cycles):
    """Times in periods, and signs, at which a sine wave is a threshold away from where it was so the last time."""
    level, times, signs = 0.0, [], []
    turns = [0.25 + 0.5 * half for half in range(2 * cycles)]
    for half, end in enumerate(turns):
        sign = 1 if half % 2 == 0 else -1
        while sign * (level + sign * threshold) < amplitude:
            level += sign * threshold
            inside = np.arcsin(level / amplitude) / (2 * np.pi)
            times.append(inside + half / 2 if sign > 0 else 0.5 - inside + (half - 1) / 2)
            signs.append(sign)
        assert not times or times[-1] <= end
    return np.array(times), np.array(signs)


def test_a_wave():
    """Between instants the light is linear: (pi f h)^2 amplitude / 2 of it is wrong, over the slope at a crossing."""
    amplitude, threshold, frequency, instants = 0.93, 0.2, 7.0, 20_001
    expected, signs = crossings(amplitude, threshold, 5)
    times = np.linspace(0, (2 * 5 - 0.5) / 2 / frequency, instants)
    found = of_function(
        gs.EventSensor(on=threshold, off=threshold, **QUIET),
        lambda time: 2 + amplitude * np.sin(2 * np.pi * frequency * time),
        times,
    )
    np.testing.assert_array_equal(found["p"], signs)
    step = times[1]
    least = np.abs(np.cos(2 * np.pi * expected)).min() * amplitude * 2 * np.pi * frequency
    np.testing.assert_allclose(
        found["t"],
        expected / frequency,
        atol=(np.pi * frequency * step) ** 2 * amplitude / 2 / least + 1e-12,
    )


def test_leak_makes_events_of_steady_light():
    sensor = gs.EventSensor(mismatch=0.0, window=0.0, leak=8.0)
    found = of_function(sensor, lambda time: 4.0, [0.0, 0.3, 1.01])
    np.testing.assert_allclose(found["t"], np.arange(1, 9) / 8, atol=1e-12)
    assert (found["p"] == 1).all()


def test_mismatch_scatters_thresholds():
    sensor = gs.EventSensor(on=0.3, **QUIET | {"mismatch": 0.05})
    found = of_function(
        sensor, lambda time: time, [0.0, 0.45], (100, 100)
    )  # one event each: 0.3 (1 +- 0.05)
    assert len(found) == 10_000
    assert found["t"].mean() == pytest.approx(0.3, abs=5 * 0.015 / 100)
    assert found["t"].std() == pytest.approx(0.015, rel=5 / np.sqrt(2 * 10_000))


def noise_rates(sigma, threshold):
    """Events an instant of light that scatters normally, for 200 places where a level began: at such light."""
    begun = norm.ppf((np.arange(200) + 0.5) / 200) * sigma / threshold
    return np.array([chain_rate(sigma, threshold, offset) for offset in begun])


def chain_rate(sigma, threshold, offset, count=12):
    """The same of levels that are whole thresholds and an offset from the light: these are a Markov chain."""
    levels = np.arange(-count, count + 1) + offset
    number = np.arange(-2 * count, 2 * count + 1)
    ends = levels[:, None] + number
    low, high = ends - (number <= 0), ends + (number >= 0)
    chance = norm.cdf(high * threshold / sigma) - norm.cdf(low * threshold / sigma)
    moves = np.zeros((len(levels), len(levels)))
    for at, own in enumerate(chance):
        np.add.at(moves[at], np.clip(at + number, 0, len(levels) - 1), own)
    values, vectors = np.linalg.eig(moves.T)
    stationary = np.real(vectors[:, np.argmax(np.real(values))])
    return float(stationary / stationary.sum() @ (chance @ np.abs(number)))


@pytest.mark.parametrize(
    "electrons, threshold", [(400.0, 0.1), (2500.0, 0.05), (10_000.0, 0.025), (10_000.0, 0.05)]
)
def test_the_rate_of_noise_is_that_of_theory(electrons, threshold):
    """Poisson's scatter of the logarithm is 1 / sqrt(N), normal but for terms of 1 / N; its skewness falls out of both
    signs together. Counts scatter from pixel to pixel as their levels' beginnings do, and in time by about four times
    their number, since events come in pairs, up and down, and some pairs in a row: 3.5 of these sigmas.
    """
    sensor = gs.EventSensor(on=threshold, off=threshold, **QUIET | {"window": 0.001})
    shape, instants = (60, 60), 120
    found = sensor.events(
        np.arange(instants) * 0.01, (np.full(shape, electrons / 0.001) for _ in range(instants))
    )
    settled = found[found["t"] > 0.19]  # the level begins at a scattered light
    rates, seen = noise_rates(1 / np.sqrt(electrons), threshold), instants - 20
    count = rates.mean() * 3600 * seen
    assert len(settled) == pytest.approx(
        count, abs=3.5 * np.sqrt(3600 * seen**2 * rates.var() + 4 * count)
    )
    assert abs((settled["p"] == 1).mean() - 0.5) < 0.05


@pytest.mark.parametrize("device", KINDS)
def test_a_still_camera_sees_noise(device):
    """As much as at instants a window apart: what is seen does not depend on how fast the camera moves."""
    simulator, scene = gs.Simulator(PHONE, device=device), gs.chart("flat", size=(24, 16))
    sensor = gs.EventSensor(on=0.02, off=0.02, mismatch=0.0, leak=0.0, window=0.002)
    own, asked = (
        gs.events_of(simulator, scene, gs.Motion(), 0.1, sensor, instants=count)
        for count in (None, 51)
    )
    np.testing.assert_array_equal(own, asked)
    assert len(own) > 100


@pytest.mark.parametrize("device", KINDS)
def test_an_edge_that_passes(device):
    """Every pixel that a bright edge passes sees its logarithm rise once: as many events as thresholds fit in it."""
    camera = camera_with(optics={"relative_illumination": "none"})
    simulator, scene = gs.Simulator(camera, device=device), gs.chart("slanted-edge", size=(48, 32))
    sensor = gs.EventSensor(on=0.3, off=0.3, mismatch=0.0, leak=0.0, window=0.0)
    assert len(gs.events_of(simulator, scene, gs.Motion(), 0.1, sensor)) == 0
    motion = gs.Motion(pan=(0, 100.0))
    found = gs.events_of(simulator, scene, motion, 0.08, sensor)
    assert found.dtype == EVENT and (np.diff(found["t"]) >= 0).all() and len(found)
    first, last = (
        np.log(
            np.array(
                simulator.device.numpy(
                    simulator.loop(scene.viewed(motion.at(time)), 1.0).output("mean")
                )
            ).astype(float)
            + sensor.dark
        )
        for time in (0.0, 0.08)
    )
    signed = np.zeros((32, 48))
    np.add.at(signed, (found["y"], found["x"]), found["p"])
    change = last - first
    assert (
        np.abs(signed * 0.3 - change).max() < 0.3 + 1e-3
    )  # the level ends within a threshold of the light
    assert np.abs(signed).max() >= 2


# Events per pixel and second of v2e itself (github.com/SensorsINI/v2e at cac6384, v2ecore/emulator.py), noisy preset, a
# still frame of 48 x 48 pixels for 3 s in steps of 0.5 ms; 8-bit grey values with white at 100 cd/m2.
V2E = {0.1: 5.12, 1.0: 5.08, 10.0: 4.75, 100.0: 1.37}


def test_a_still_scene_makes_as_many_events_as_published():
    """Within a factor of two of v2e's rate, falling from 1 cd/m2 on: a grey of 18 % on 18.5 um at f/2.8.

    The phone's filters let 1.06e4 electrons a second pass for 1 cd/m2. In 1.5 s of 600 pixels, whose thresholds make
    their rates differ by as much as the mean itself, the rate scatters by 5 %.
    """
    sensor = gs.EventSensor(cutoff=30, noise=5, leak=0.1, on=0.2, off=0.2, mismatch=0.25)
    found = {}
    for luminance, published in V2E.items():
        light = [np.full((20, 30), 1.06e4 * luminance)] * 2
        found[luminance] = len(sensor.events([0.0, 1.5], light)) / 600 / 1.5
        assert published / 2 < found[luminance] < 2 * published
    assert found[1.0] > found[10.0] > found[100.0]


def transfers(sensor, electrons, frequencies):
    """Gains of light's and the amplifier's noise, over frequencies [Hz]: the circuit's equations."""
    s = 2j * np.pi * frequencies
    first, follower = electrons / sensor.charge, 2 * np.pi * sensor.cutoff / np.sqrt(np.sqrt(2) - 1)
    behind = (follower / (s + follower)) ** 2
    return first / (s + first) * behind, (s + SHARE * first) / (s + first) * behind


@pytest.mark.parametrize("electrons", [2e3, 1e5, 3e6])
@pytest.mark.parametrize("noise", [0.0, 20.0])
def test_the_noise_has_the_variance_of_its_spectrum(electrons, noise):
    """Shot noise of photodiode and feedback transistor, 2 / I, and the amplifier's, through the poles.

    20,000 pixels tell a variance to 1 %; steps lose .5 % of it, and the first stage 1 % where it is faster than they.
    """
    sensor = gs.EventSensor(noise=noise, mismatch=0.0)
    pixels = Photoreceptor(sensor, np.random.default_rng(2)).begin(
        np.full(20_000, np.log(electrons))
    )
    frequencies = np.linspace(-3000, 3000, 600_001)
    shot, own = (
        np.trapezoid(np.abs(gain) ** 2, frequencies)
        for gain in transfers(sensor, electrons, frequencies)
    )
    density = (
        4 * noise_deviation(noise, 30.0, 0.2, 0.0) ** 2 / (2 * np.pi * 30 / np.sqrt(np.sqrt(2) - 1))
    )
    assert np.mean(pixels) == pytest.approx(
        np.log(electrons), abs=5 * pixels.std() / np.sqrt(20_000)
    )
    assert pixels.var() == pytest.approx(2 / electrons * shot + density * own, rel=0.055)


def test_dim_light_is_followed_slowly():
    """A small step of light: the response of one pole at I / charge and two at the cutoff, by partial fractions.

    Steps of a quarter of the follower's time constant err by 1 % of the step of light.
    """
    for first in (8.0, 60.0, 3000.0):
        sensor = gs.EventSensor(noise=0.0, charge=1e12)
        follower = 2 * np.pi * 30 / np.sqrt(np.sqrt(2) - 1)
        front = Photoreceptor(sensor, np.random.default_rng(0))
        light = np.full(1, np.log(first * 1e12))
        front.begin(light)
        for _ in front.advance(light + 0.01, 1e-9):
            pass
        seen = [
            (part * 0.3, float(output[0] - light[0]) / 0.01)
            for part, output in front.advance(light + 0.01, 0.3)
        ]
        time, response = np.array(seen).T
        slow, fast = np.exp(-first * time), np.exp(-follower * time)
        share = (follower / (follower - first)) ** 2
        known = (
            1
            - share * slow
            + (share - 1) * fast
            - first * follower / (first - follower) * time * fast
        )
        np.testing.assert_allclose(response, known, atol=0.012)


def test_rates_are_those_asked_for_and_do_not_depend_on_the_instants():
    """The amplifier's noise in darkness, so slow that it is not suppressed, with and without mismatch."""
    for noise, mismatch in ((5.0, 0.25), (20.0, 0.02)):
        sensor = gs.EventSensor(noise=noise, mismatch=mismatch, leak=0.0, charge=1e6)
        for instants in (2, 300):
            times = np.linspace(0, 1.5, instants)
            found = sensor.events(times, (np.full((20, 30), 1e5) for _ in times))
            assert len(found) / 600 / 1.5 == pytest.approx(
                noise, rel=0.25
            )  # thresholds of 600 pixels, begun anywhere


def test_moving_light_does_not_depend_on_the_instants():
    """Bright light that swings at 3 Hz by 1, behind the two poles by .996: four thresholds of .2 up and four down.

    4 at first, then 8 each half of a period, five times, and half of that at the end, in 9 pixels.
    """
    sensor = gs.EventSensor(noise=0.0, leak=0.0, mismatch=0.0, charge=1e6)
    counts = []
    for instants in (101, 401):
        times = np.linspace(0, 1, instants)
        counts.append(
            len(
                of_function(
                    sensor, lambda time: np.log(1e10) + np.sin(6 * np.pi * time), times, (3, 3)
                )
            )
        )
    assert counts == [9 * (4 + 5 * 8 + 4 - 1)] * 2  # the last is 7 ms late


def test_events_are_written_and_depend_on_the_seed_alone(tmp_path):
    times = np.linspace(0, 0.1, 21)
    rates = [np.full((8, 9), 3000.0 * (1 + time)) for time in times]
    one, again, other = (
        gs.EventSensor(window=0.01, on=0.05, off=0.05, seed=seed).events(times, rates)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert len(one) and not np.array_equal(one, other)
    gs.write_events(tmp_path / "a.npz", one, (8, 9))
    with np.load(tmp_path / "a.npz") as file:
        assert tuple(file["shape"]) == (8, 9)
        for name in EVENT.names:
            np.testing.assert_array_equal(file[name], one[name])


@pytest.mark.parametrize(
    "asked, words",
    [
        ({"on": 0}, "events.on = 0"),
        ({"dark": 0}, "events.dark"),
        ({"refractory": -1}, "events.refractory"),
        ({"leak": np.nan}, "events.leak"),
        ({"seed": -1}, "events.seed"),
        ({"cutoff": 0}, "events.cutoff"),
        ({"charge": 0}, "events.charge"),
        ({"noise": 300}, "events.noise"),
        ({"seed": 1.5}, "events.seed"),
    ],
)
def test_sensors_that_are_none(asked, words):
    with pytest.raises(OutOfRange, match=words):
        gs.EventSensor(**asked)


def test_bad_times_and_rates():
    sensor, flat = gs.EventSensor(), np.ones((3, 4))
    for times, rates, words in (
        ([0.0], [flat], "two or more"),
        ([0.0, 0.0], [flat] * 2, "rising"),
        ([0.0, 1.0, 2.0], [flat, flat], "2 for 3 instants"),
        ([0.0, 1.0], [flat, -flat], "finite light"),
        ([0.0, 1.0], [flat, flat.T], "as before"),
    ):
        with pytest.raises(BadData, match=words):
            sensor.events(times, rates)
    simulator, scene = gs.Simulator(PHONE, device="numpy"), gs.chart("flat", size=(8, 8))
    with pytest.raises(OutOfRange, match="duration"):
        gs.events_of(simulator, scene, gs.Motion(), 0)
    with pytest.raises(OutOfRange, match="instants"):
        gs.events_of(simulator, scene, gs.Motion(), 0.1, instants=10.5)
    with pytest.raises(OutOfRange, match="slower camera"):
        gs.events_of(simulator, scene, gs.Motion(pan=(0, 9e4)), 1.0)
