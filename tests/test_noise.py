"""Sensor noise: known answers, equality of all devices, and the distributions against probability theory.

Every statistical test has a fixed seed and fails at a p-value below ALPHA, the chance that a right sampler with new
random numbers would fail it.
"""

import numpy as np
import pytest
from devices import DEVICES
from scipy import stats
from scipy.special import ndtr

from gpusim.backends import open_device
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.common import exact_ref
from gpusim.kernels.common.philox_ref import philox, seed_words
from gpusim.kernels.sensor.noise import noise
from gpusim.kernels.sensor.noise_ref import MOST_BY_SEARCH, SEARCH_BELOW, poisson_by_expansion, poisson_by_search
from gpusim.kernels.stage import compare

ALPHA = 1e-6
SIGMAS = stats.norm.isf(ALPHA / 2)  # 4.9
f32 = np.float32
MEANS = [1e-8, 1e-3, 0.1, 0.5, 3, 5, 11.9, 12, 12.1, 30, 87, 88, 104, 300, 1e3, 1e4, 1e5, 1e7]
IDEAL = {"full_well": np.inf, "gain": 1.0, "white_level": 65535}


def electrons(mean, device="numpy", **changed):
    return noise(np.asarray(mean, f32), **{**IDEAL, **changed}, electrons=True, device=device)


# ---------------------------------------------------------------- random words and elementary functions


@pytest.mark.parametrize(("counter", "key", "answer"), [
    # Random123 (D. E. Shaw Research), file kat_vectors, lines "philox4x32 10"
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
])
def test_philox_gives_the_published_answers(counter, key, answer):
    def numbers(text):
        return [int(word, 16) for word in text.split()]

    assert [int(np.ravel(word)[0]) for word in philox(numbers(counter), numbers(key))] == numbers(answer)


def test_seed_words_are_the_halves_of_the_seed():
    assert seed_words(0x0123456789ABCDEF) == (0x89ABCDEF, 0x01234567)


def ulps(values, truth):
    """Largest error in units of the last place of the true value."""
    truth = np.asarray(truth, np.float64)
    return float(np.max(np.abs(values - truth) / np.spacing(np.abs(truth).astype(f32)).astype(np.float64)))


def binade(exponent, step=1):
    """Every `step`-th float32 from 2^exponent to 2^(exponent + 1)."""
    return (np.arange(0, 2**23, step, dtype=np.uint32) + np.uint32((127 + exponent) << 23)).view(f32)


def log_ulps(exponent):
    return ulps(exact_ref.log(binade(exponent)), np.log(binade(exponent).astype(np.float64)))


def exp_ulps(exponent, step=1):
    x = binade(exponent, step)
    value, complement = exact_ref.exp_negative(x)
    exact = x.astype(np.float64)
    return ulps(value, np.exp(-exact)), ulps(complement, -np.expm1(-exact))


@pytest.mark.parametrize("exponent", [-33, -2, -1])  # the deepest tail, and where the parts cancel most
def test_log_errs_by_less_than_one_ulp(exponent):
    # Half a unit is the last rounding; the rest, polynomial and lost bits of the parts, was made to fit into another.
    assert log_ulps(exponent) < 1


@pytest.mark.parametrize("exponent", [-10, -4, -3, -2, -1, 0, 1, 2, 3])
def test_exp_errs_by_less_than_one_ulp(exponent):
    value, complement = exp_ulps(exponent, step=5)
    assert value < 1  # as for the logarithm
    assert complement < 1.5  # x in [1/4, ln(2)/2]: r - r^2 P keeps the error of r^2 P, half as large as the result


@pytest.mark.slow
def test_log_and_exp_on_every_float_of_their_range():
    assert max(log_ulps(exponent) for exponent in range(-33, 0)) < 1
    errors = [exp_ulps(exponent) for exponent in range(-30, 6)]
    assert max(value for value, _ in errors) < 1
    assert max(complement for _, complement in errors) < 1.5


def test_sine_and_cosine_err_by_less_than_one_ulp():
    a = np.concatenate([binade(exponent, 7) for exponent in range(-12, 0)])
    a = a[a <= f32(np.pi / 4)]
    a = np.concatenate([a, -a])
    sine, cosine = exact_ref.sine_cosine(a)
    # half a unit for the last rounding, less than half for what is added to the leading term
    assert ulps(sine, np.sin(a.astype(np.float64))) < 1
    assert ulps(cosine, np.cos(a.astype(np.float64))) < 1


def test_uniform_reaches_both_ends_and_uses_all_64_bits():
    high, low = np.array([[0, 0, 2**32 - 1], [0, 2**32 - 1, 2**32 - 1]], np.uint32)
    np.testing.assert_array_equal(exact_ref.uniform(high, low), [f32(2.0**-65), f32(2.0**-32), 1])


def test_normal_pairs_are_box_muller():
    radial = np.unique(np.geomspace(1, 2**31, 300).astype(np.uint32))
    angular = np.append(np.random.default_rng(1).integers(0, 2**32, 300, np.uint32),
                        np.array([0, 2**30 - 1, 2**30, 2**31 - 1, 2**31, 2**32 - 1], np.uint32))
    radial, angular = np.meshgrid(np.append(np.uint32(0), radial), angular)
    radius = np.sqrt(-2 * np.log((radial + 0.5) / 2.0**32))
    arc, within = np.divmod(angular.astype(np.int64), 2**30)
    a = np.where(within >= 2**29, within - 2**30, within) * (np.pi / 4 / 2**29)
    along, across = radius * np.cos(a) * np.where(arc >= 2, -1, 1), radius * np.sin(a)
    first, second = exact_ref.normal_pair(radial, angular)
    # up to six roundings of numbers below 6.77, whose last place is 2^-21, beside the elementary functions' one ulp
    np.testing.assert_allclose(first, np.where(arc % 2, across, along), rtol=0, atol=8 * 2.0**-22)
    np.testing.assert_allclose(second, np.where(arc % 2, along, across), rtol=0, atol=8 * 2.0**-22)


# ---------------------------------------------------------------- the same bits everywhere


def test_there_are_devices_to_compare():
    assert "warp:cpu" in DEVICES
    assert any(name.startswith("opencl") for name in DEVICES)


@pytest.mark.parametrize("name", DEVICES)
def test_every_case_has_the_same_bits_on_every_device(name):
    different = {case.name: error for case, error in compare("sensor.noise", open_device(name)) if error != 0}
    assert not different


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("changed", [{}, {"photon_noise": False}], ids=["photons", "normal numbers"])
def test_a_large_frame_has_the_same_bits_on_every_device(name, changed):
    mean = np.geomspace(1e-4, 1e8, 300 * 701).reshape(300, 701)  # 2e5 pixels: the tails of the normal numbers too
    inputs = {"dark_electrons": 1e-3, "read_noise": 2.0, "prnu": 0.02, "dsnu": 0.7, "seed": 3, "frame": 9} | changed
    np.testing.assert_array_equal(electrons(mean, name, **inputs), electrons(mean, **inputs))


def test_one_pixel_per_work_item_has_the_same_bits_as_eight(monkeypatch):
    device = open_device("opencl")
    mean, inputs = np.geomspace(1e-4, 1e8, 7001).reshape(1, -1), {"read_noise": 2.0, "prnu": 0.02, "dsnu": 0.7}
    results = []
    for is_gpu in (False, True):  # which decides the width
        monkeypatch.setattr(device, "is_gpu", is_gpu)
        results.append(electrons(mean, device.name, **inputs))
    np.testing.assert_array_equal(*results)


def test_device_arrays_stay_on_the_device():
    device = open_device("warp:cpu")
    result = noise(device.array(np.full((3, 4), 9.0)), **IDEAL, device=device)
    assert isinstance(result, device.array_type)
    np.testing.assert_array_equal(device.numpy(result), noise(np.full((3, 4), 9.0, f32), **IDEAL, device="numpy"))


@pytest.mark.parametrize("name", ["numpy", *DEVICES])
def test_frames_do_not_depend_on_their_order(name):
    mean, inputs = np.full((16, 17), 40.0), {"read_noise": 1.0, "prnu": 0.1, "dsnu": 1.0, "seed": 5}
    forth = [electrons(mean, name, frame=frame, **inputs) for frame in (0, 1, 2)]
    back = [electrons(mean, name, frame=frame, **inputs) for frame in (2, 1, 0)]
    np.testing.assert_array_equal(forth, back[::-1])
    assert not np.array_equal(forth[0], forth[1])


def test_patterns_belong_to_the_sensor_and_temporal_noise_to_the_frame():
    mean = np.full((8, 9), 50.0)
    pattern = {"photon_noise": False, "prnu": 0.1, "dsnu": 1.0}
    np.testing.assert_array_equal(electrons(mean, **pattern, frame=1, seed=2), electrons(mean, **pattern, frame=7))
    assert not np.any(electrons(mean, **pattern) == electrons(mean, **pattern, sensor_seed=2**32))
    np.testing.assert_array_equal(electrons(mean, read_noise=1.0, sensor_seed=8), electrons(mean, read_noise=1.0))
    assert not np.any(electrons(mean, read_noise=1.0) == electrons(mean, read_noise=1.0, seed=2**32))  # high half


# ---------------------------------------------------------------- the sampler's own map, without sampling


def crossing(predicate, low, high, shape):
    """Where in [low, high] float32 numbers the monotone `predicate` becomes true, for each element of `shape`.

    Bisection over the floats themselves; the result is halfway between the last false and the first true one, which is
    where a real number is rounded to the latter.
    """
    def floats(order):
        return np.where(order >= 0, order, 2**31 - order).astype(np.uint32).view(f32)

    def order(value):
        bits = int(np.abs(f32(value)).view(np.int32))
        return np.full(shape, bits if value >= 0 else -bits, np.int64)

    low, high = order(low), order(high)
    while (high - low).max() > 1:
        middle = (low + high) // 2
        found = predicate(floats(middle))
        low, high = np.where(found, low, middle), np.where(found, middle, high)
    return (floats(low).astype(np.float64) + floats(high)) / 2


def search_probabilities(mean):
    """P(k) of the search for a uniform number that is rounded to float32, k = 0 to its largest."""
    k = np.arange(1, MOST_BY_SEARCH + 1)
    means = np.full(k.shape, mean, f32)
    tail = crossing(lambda u: poisson_by_search(means, u) < k, 0.0, 2.0, k.shape)  # k falls with u
    return np.arange(MOST_BY_SEARCH + 1), -np.diff(np.concatenate([[1.0], np.minimum(tail, 1), [0.0]]))


def expansion_probabilities(mean):
    """P(k) of the expansion for a normal number that is rounded to float32, within 9 standard deviations."""
    k = np.arange(max(np.floor(mean - 9 * np.sqrt(mean)), 0), np.ceil(mean + 10 * np.sqrt(mean)) + 2)
    means = np.full(k.shape, mean, f32)
    below = ndtr(crossing(lambda z: poisson_by_expansion(means, z) >= k, -12.0, 12.0, k.shape))
    below[0] = 0.0
    return k[:-1], np.diff(below)


def probabilities(mean):
    return search_probabilities(mean) if f32(mean) < SEARCH_BELOW else expansion_probabilities(mean)


# from below to above the switch densely (the distance is greatest there), then to where float32 holds every count
@pytest.mark.parametrize("mean", [1e-8, 1e-3, 0.1, 1.0, 5.0, 11.0, 11.999, *np.arange(12, 16, 0.25), 20.0, 29.9, 30.0,
                                  87.0, 104.0, 300.5, 1e3, 1e4, 1e5, 1e6, 1e7, 1.6e7])
def test_total_variation_to_poisson(mean):
    k, p = probabilities(mean)
    distance = 0.5 * np.abs(p - stats.poisson.pmf(k, float(f32(mean)))).sum()
    # 1e-4 is what the sampler promises; the search has float32 sums of at most 40 terms: 40 * 2^-25
    assert distance <= (40 * 2.0**-25 if mean < SEARCH_BELOW else 1e-4)


def test_the_expansion_rises_with_the_normal_number():
    # what bisection takes for granted; |z| <= 6.76
    z = np.linspace(-6.77, 6.77, 200_001).astype(f32)
    for mean in (12, 12.5, 13, 20, 100, 1e4, 1e7):
        assert np.all(np.diff(poisson_by_expansion(np.full(z.shape, mean, f32), z)) >= 0)


@pytest.mark.parametrize("mean", [1e-12, 1e-8, 1e-7, 1e-4])
def test_rare_photons_are_as_rare_as_they_should(mean):
    tail = 1 - search_probabilities(mean)[1][0] if mean > 1e-5 else search_probabilities(mean)[1][1]
    # 1e-5: u and the tail are float32 with full relative precision; 1 - P(0) loses 1e-16 / 1e-4 in this test
    assert tail == pytest.approx(-np.expm1(-float(f32(mean))), rel=1e-5)


def test_the_search_ends_where_the_distribution_ends():
    # A sum of probabilities that saturates beside 1 would give one pixel in ten million the largest count there is, at
    # those means where the last rounding goes that way.
    mean, u = np.meshgrid(np.geomspace(1e-3, 11.99, 200, dtype=f32), f32(2.0) ** -np.arange(66, dtype=f32))
    k = poisson_by_search(mean, u)
    # The bound by a geometric series promises u (k + 1 - mean) < p_k (k + 1), and the true tail is at least p_k. The
    # computed p_k is a product of at most 40 factors, each with two roundings: 80 * 2^-24 < 2^-17.
    tail = stats.poisson.sf(k - 1, mean.astype(np.float64))
    assert np.all(u * (k + 1 - mean) <= tail * (k + 1) * (1 + 2.0**-17))


def test_no_step_at_the_switch():
    moments = []
    for probability in (search_probabilities, expansion_probabilities):
        k, p = probability(float(SEARCH_BELOW))
        mean = (k * p).sum()
        moments.append((mean / np.sqrt(12), ((k - mean) ** 2 * p).sum() / 12))
    # 3e-4 standard deviations: invisible below 1e7 pixels
    np.testing.assert_allclose(*moments, rtol=0, atol=3e-4)


@pytest.mark.parametrize("mean", [8.0, 100.0, 1e4])
def test_mean_of_the_clipped_counts(mean):
    k, p = probabilities(mean)
    truth = mean - stats.poisson.expect(lambda n: np.maximum(n - mean, 0), (mean,), maxcount=10**6, tolerance=1e-14,
                                        lb=0, ub=mean + 12 * np.sqrt(mean) + 30)
    # 1e-3 e- is invisible below 1e8 pixels; total variation x standard deviation is less than that at all means
    assert (np.minimum(k, mean) * p).sum() == pytest.approx(truth, abs=1e-3)


# ---------------------------------------------------------------- statistics of samples


def p_values(k, mean):
    """P-values of a (rows, cols) sample against independent Poisson numbers of this mean, by test."""
    n, k = k.size, np.asarray(k, np.float64)
    total = stats.poisson(n * mean)

    def two_sided(z):
        return 2 * stats.norm.sf(abs(z))

    result = {"mean": min(1, 2 * min(total.cdf(k.sum()), total.sf(k.sum() - 1)))}
    low, mass = stats.poisson.cdf(k - 1, mean), stats.poisson.pmf(k, mean)
    uniform = np.clip(low + mass * np.random.default_rng(7).random(k.shape), 0, 1)  # randomised probability integral
    result["KS"] = stats.kstest(uniform.ravel(), "uniform").pvalue
    result["chi2"] = stats.chisquare(np.histogram(uniform, 64, (0, 1))[0]).pvalue
    for at_least in (2, 3):
        p = stats.poisson.sf(at_least - 1, mean)
        result[f"k >= {at_least}"] = stats.binomtest(int((k >= at_least).sum()), n, p).pvalue if p > 0 else 1.0
    for tail in (1e-3, 1e-5):
        limit = stats.poisson.isf(tail, mean)
        result[f"tail {tail}"] = stats.binomtest(int((k > limit).sum()), n, stats.poisson.sf(limit, mean)).pvalue
    if n * mean < 1e4:  # too few photons for the central limit theorem at SIGMAS
        return result
    x = (k - mean) / np.sqrt(mean)
    # central moments of Poisson: mu4 = m + 3 m^2, mu6 = m + 25 m^2 + 15 m^3
    result["dispersion"] = two_sided(((x**2).mean() - 1) / np.sqrt((2 + 1 / mean) / n))
    result["skewness"] = two_sided(((x**3).mean() - mean**-0.5) / np.sqrt((15 + 24 / mean + mean**-2) / n))
    for down, right in ((0, 1), (1, 0), (1, 1), (0, 2), (0, 16), (16, 0)):
        products = x[down:, right:] * x[: x.shape[0] - down, : x.shape[1] - right]
        result[f"lag {down},{right}"] = two_sided(products.mean() * np.sqrt(products.size))
    return result


def check(k, mean):
    failed = {name: p for name, p in p_values(k, mean).items() if not p >= ALPHA}
    assert not failed


@pytest.mark.parametrize("mean", MEANS)
def test_photons_are_poisson(mean):
    check(electrons(np.full((512, 512), mean), seed=1), float(f32(mean)))


def test_mean_0_has_no_photons():
    assert not electrons(np.zeros((512, 512))).any()


@pytest.mark.slow
@pytest.mark.parametrize("mean", MEANS)
def test_photons_are_poisson_in_large_samples(mean):
    check(electrons(np.full((2048, 2048), mean), "opencl", seed=2), float(f32(mean)))


@pytest.mark.parametrize("wrong", ["normal", "rounded down", "repeated rows", "8 bits", "one pixel too bright"])
def test_the_suite_sees_wrong_samplers(wrong):
    random = np.random.default_rng(1)
    mean = 0.1 if wrong == "one pixel too bright" else 30.0
    k = {
        "normal": lambda: np.rint(random.normal(mean, np.sqrt(mean), (512, 512))),
        "rounded down": lambda: random.poisson(mean, (512, 512)) - (random.random((512, 512)) < 0.5),
        "repeated rows": lambda: np.repeat(random.poisson(mean, (256, 512)), 2, axis=0),
        "8 bits": lambda: stats.poisson.ppf((random.integers(0, 256, (512, 512)) + 0.5) / 256, mean),
        "one pixel too bright": lambda: np.where(np.arange(2**18).reshape(512, 512) == 99, 100,
                                                 random.poisson(mean, (512, 512))),
    }[wrong]()
    assert min(p_values(k, mean).values()) < ALPHA


def test_frames_streams_and_seeds_are_independent():
    mean = np.full((512, 512), 100.0)
    samples = np.array([
        electrons(mean), electrons(mean, frame=1), electrons(mean, frame=2**31), electrons(mean, seed=1),
        electrons(mean, seed=2**32), *(electrons(np.zeros_like(mean), read_noise=1.0, frame=frame) for frame in (0, 1)),
        electrons(mean, photon_noise=False, prnu=0.1), electrons(mean, photon_noise=False, dsnu=1.0)]).reshape(9, -1)
    correlation = np.corrcoef(samples)[np.triu_indices(9, 1)]
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(mean.size)
    # photons below the switch come from other words than the read noise of the same pixel; above it, from the other
    # number of the same Box-Muller pair
    few = electrons(np.full((512, 512), 2.0), read_noise=1e-3)
    photons, read = np.rint(few).ravel(), (few - np.rint(few)).ravel()
    assert abs(np.corrcoef(photons, read)[0, 1]) < SIGMAS / np.sqrt(mean.size)
    np.testing.assert_array_less(np.abs(np.corrcoef(photons**2, read**2)[0, 1]), SIGMAS / np.sqrt(mean.size))


@pytest.mark.parametrize("inputs", [{"read_noise": 3.0}, {"dsnu": 3.0}, {"prnu": 0.003}],
                         ids=["read noise", "DSNU", "PRNU"])
def test_normal_noise_has_its_standard_deviation_and_shape(inputs):
    level = 1000.0 if "prnu" in inputs else 0.0
    z = (electrons(np.full((512, 512), level), photon_noise=False, **inputs).ravel() - level) / 3
    assert abs(z.mean()) < SIGMAS / np.sqrt(z.size)
    assert 2 * min(stats.chi2(z.size).cdf((z**2).sum()), stats.chi2(z.size).sf((z**2).sum())) > ALPHA
    assert stats.kstest(z, "norm").pvalue > ALPHA
    assert abs((z**3).mean()) < SIGMAS * np.sqrt(15 / z.size)  # E z^6 = 15
    assert abs((z**4).mean() - 3) < SIGMAS * np.sqrt(96 / z.size)  # E z^8 - 9 = 105 - 9


def test_all_parameters_are_recovered_from_two_frames():
    level, dark, read, prnu, dsnu, gain, black = 2000.0, 30.0, 12.0, 0.02, 25.0, 2.0, 512.0
    first, second = (noise(np.full((512, 512), level, f32), dark_electrons=dark, read_noise=read, prnu=prnu, dsnu=dsnu,
                           full_well=1e5, gain=gain, black_level=black, white_level=65535, frame=frame, device="numpy")
                     .astype(np.float64).ravel() for frame in (0, 1))
    n, fixed = first.size, (prnu * level) ** 2 + dsnu**2
    # EMVA 1288: differences of frames hold the temporal variance, their covariance the fixed one; 1/12 is the rounding
    temporal = level + dark + read**2 + 1 / (12 * gain**2)
    error = SIGMAS * np.sqrt(2 / n)  # relative error of a variance
    assert ((first - second) ** 2).mean() / 2 / gain**2 == pytest.approx(temporal, rel=error)
    assert np.cov(first, second)[0, 1] / gain**2 == pytest.approx(fixed, abs=error * (fixed + temporal))
    assert (first.mean() - black) / gain == pytest.approx(level + dark, abs=SIGMAS * np.sqrt((fixed + temporal) / n))


def test_dark_electrons_are_poisson_and_untouched_by_prnu():
    check(electrons(np.zeros((512, 512)), dark_electrons=4.0, prnu=0.5), 4.0)
    total = electrons(np.zeros((1024, 1024)), dark_electrons=1e-4).sum()
    expected = stats.poisson(1e-4 * 2**20)
    assert min(expected.cdf(total), expected.sf(total - 1)) > ALPHA


# ---------------------------------------------------------------- order, converter, hard cases


def test_the_well_saturates_before_read_noise_is_added():
    e = electrons(np.full((256, 256), 1e4), full_well=100.0, read_noise=5.0)
    assert e.mean() == pytest.approx(100, abs=SIGMAS * 5 / 256)
    assert e.std() == pytest.approx(5, rel=SIGMAS * np.sqrt(0.5) / 256)
    assert (e > 100).mean() == pytest.approx(0.5, abs=SIGMAS * 0.5 / 256)  # a clip after it would give none


@pytest.mark.parametrize("gain", [10.0, 0.1])  # 0.1 and 10 e-/DN
def test_the_converter_rounds_without_bias(gain):
    steps = 100
    ramp = (np.arange(2**18) + 0.5).reshape(512, 512) * steps / 2**18 / gain  # exactly 100 DN long
    dn = noise(ramp.astype(f32), **IDEAL | {"gain": gain}, black_level=64, photon_noise=False, device="numpy")
    error = dn - (gain * ramp + 64)
    assert abs(error.mean()) < 1e-3  # a float32 level near 164 is within 2^-17 of the exact one
    assert np.abs(error).max() < 0.5 + 2.0**-16


def test_halves_go_to_the_even_number_and_levels_are_clipped():
    mean = np.array([[0.5, 1.5, 2.5, 300.0, 1e9]])
    dn = noise(mean, **IDEAL | {"white_level": 255}, photon_noise=False, device="numpy")
    np.testing.assert_array_equal(dn, [[0, 2, 2, 255, 255]])
    assert dn.dtype == np.uint16


@pytest.mark.parametrize("name", ["numpy", *DEVICES])
def test_impossible_means(name):
    mean = np.full((4, 5), 20.0)
    usual = electrons(mean, name, full_well=1e4)
    bad = mean.copy()
    bad[1, :4] = np.nan, np.inf, -np.inf, -1.0
    e = electrons(bad, name, full_well=1e4)
    np.testing.assert_array_equal(e[1, :4], [np.nan, 1e4, 0, 0])
    np.testing.assert_array_equal(np.delete(e, 1, axis=0), np.delete(usual, 1, axis=0))
    dn = noise(bad.astype(f32), **IDEAL | {"full_well": 1e4}, black_level=64, device=name)
    np.testing.assert_array_equal(dn[1, :4], [0, 1e4 + 64, 64, 64])


@pytest.mark.parametrize(("key", "value"), [("read_noise", -1.0), ("prnu", np.nan), ("full_well", 0.0), ("gain", 0.0),
                                            ("white_level", 65536), ("seed", 2**64), ("frame", -1)])
def test_numbers_out_of_range_are_named(key, value):
    with pytest.raises(OutOfRange, match=key):
        electrons(np.zeros((2, 2)), DEVICES[0], **{key: value})
