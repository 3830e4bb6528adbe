"""Random words, elementary functions and Poisson samplers: known answers, exhaustive errors, the samplers' own maps.

The maps are what each sampler makes of every number it can draw. Their distance to the Poisson distribution is computed
here by bisection and not sampled, so that it is known to far below what any sample shows.
"""

import mpmath as mp
import numpy as np
import pytest
from scipy import stats

from gpusim.judge.hard.maps import EXACT, FAST, MAPS, probabilities
from gpusim.kernels.common import exact64_ref, exact_ref
from gpusim.kernels.common.philox_ref import chance_word, philox, seed_words
from gpusim.kernels.common.poisson_ref import (
    exact_by_expansion,
    exact_by_search,
    poisson,
    poisson_by_expansion,
    poisson_by_search,
    poisson_exact,
)

f32 = np.float32


# ---------------------------------------------------------------- random words and elementary functions in float32


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        # Random123 (D. E. Shaw Research), file kat_vectors, lines "philox4x32 10"
        (
            "00000000 00000000 00000000 00000000",
            "00000000 00000000",
            "6627e8d5 e169c58d bc57ac4c 9b00dbd8",
        ),
        (
            "ffffffff ffffffff ffffffff ffffffff",
            "ffffffff ffffffff",
            "408f276d 41c83b0e a20bc7c6 6d5451fd",
        ),
        (
            "243f6a88 85a308d3 13198a2e 03707344",
            "a4093822 299f31d0",
            "d16cfe09 94fdcceb 5001e420 24126ea1",
        ),
    ],
)
def test_philox_gives_the_published_answers(counter, key, answer):
    def numbers(text):
        return [int(word, 16) for word in text.split()]

    assert [int(np.ravel(word)[0]) for word in philox(numbers(counter), numbers(key))] == numbers(
        answer
    )


def test_seed_words_are_the_halves_of_the_seed():
    assert seed_words(0x0123456789ABCDEF) == (0x89ABCDEF, 0x01234567)


@pytest.mark.parametrize(
    ("chance", "words"), [(1.0, 2**32), (0.25, 2**30), (2.0**-32, 1), (1e-12, 1)]
)
def test_a_chance_is_that_many_words(chance, words):
    assert chance_word(chance) + 1 == words  # those from 0 to the word itself


def ulps(values, truth):
    """Largest error in units of the last place of the true value."""
    truth = np.asarray(truth, np.float64)
    return float(
        np.max(np.abs(values - truth) / np.spacing(np.abs(truth).astype(f32)).astype(np.float64))
    )


def binade(exponent, step=1):
    """Every `step`-th float32 from 2^exponent to 2^(exponent + 1)."""
    return (np.arange(0, 2**23, step, dtype=np.uint32) + np.uint32((127 + exponent) << 23)).view(
        f32
    )


def log_ulps(exponent, step=1):
    x = binade(exponent, step)
    return ulps(exact_ref.log(x), np.log(x.astype(np.float64)))


def exp_ulps(exponent, step=1):
    x = binade(exponent, step)
    value, complement = exact_ref.exp_negative(x)
    exact = x.astype(np.float64)
    return ulps(value, np.exp(-exact)), ulps(complement, -np.expm1(-exact))


@pytest.mark.parametrize(
    "exponent", [-33, -2, -1]
)  # the deepest tail, and where the parts cancel most
def test_log_errs_by_less_than_one_ulp(exponent):
    # Half a unit is the last rounding; the rest, polynomial and lost bits of the parts, was made to fit into another.
    assert log_ulps(exponent, step=5) < 1


@pytest.mark.parametrize("exponent", [-10, -4, -3, -2, -1, 0, 1, 2, 3])
def test_exp_errs_by_less_than_one_ulp(exponent):
    value, complement = exp_ulps(exponent, step=5)
    assert value < 1  # as for the logarithm
    assert (
        complement < 1.5
    )  # x in [1/4, ln(2)/2]: r - r^2 P keeps the error of r^2 P, half as large as the result


@pytest.mark.slow
def test_functions_on_every_float_of_their_range():
    assert max(log_ulps(exponent) for exponent in range(-33, 0)) < 1
    errors = [exp_ulps(exponent) for exponent in range(-30, 6)]
    assert max(value for value, _ in errors) < 1
    assert max(complement for _, complement in errors) < 1.5
    assert (
        max(max(sine_cosine_ulps(exponent)) for exponent in range(-12, 0)) < 1
    )  # below, sin a is a


def sine_cosine_ulps(exponent, step=1):
    a = binade(exponent, step)
    a = a[a <= f32(np.pi / 4)]
    sine, cosine = exact_ref.sine_cosine(a)
    np.testing.assert_array_equal(exact_ref.sine_cosine(-a), (-sine, cosine))
    return ulps(sine, np.sin(a.astype(np.float64))), ulps(cosine, np.cos(a.astype(np.float64)))


@pytest.mark.parametrize("exponent", [-6, -3, -2, -1])
def test_sine_and_cosine_err_by_less_than_one_ulp(exponent):
    # half a unit for the last rounding, less than half for what is added to the leading term
    assert max(sine_cosine_ulps(exponent, step=21)) < 1


def test_uniform_reaches_both_ends_and_uses_all_64_bits():
    high, low = np.array([[0, 0, 2**32 - 1], [0, 2**32 - 1, 2**32 - 1]], np.uint32)
    np.testing.assert_array_equal(exact_ref.uniform(high, low), [f32(2.0**-65), f32(2.0**-32), 1])


def test_normal_pairs_are_box_muller():
    radial = np.unique(np.geomspace(1, 2**31, 300).astype(np.uint32))
    angular = np.append(
        np.random.default_rng(1).integers(0, 2**32, 300, np.uint32),
        np.array([0, 2**30 - 1, 2**30, 2**31 - 1, 2**31, 2**32 - 1], np.uint32),
    )
    radial, angular = np.meshgrid(np.append(np.uint32(0), radial), angular)
    radius = np.sqrt(-2 * np.log((radial + 0.5) / 2.0**32))
    arc, within = np.divmod(angular.astype(np.int64), 2**30)
    a = np.where(within >= 2**29, within - 2**30, within) * (np.pi / 4 / 2**29)
    along, across = radius * np.cos(a) * np.where(arc >= 2, -1, 1), radius * np.sin(a)
    first, second = exact_ref.normal_pair(radial, angular)
    # up to six roundings of numbers below 6.77, whose last place is 2^-21, beside the elementary functions' one ulp
    np.testing.assert_allclose(first, np.where(arc % 2, across, along), rtol=0, atol=8 * 2.0**-22)
    np.testing.assert_allclose(second, np.where(arc % 2, along, across), rtol=0, atol=8 * 2.0**-22)


# ---------------------------------------------------------------- elementary functions in float64

RANDOM = np.random.default_rng(1)
TAIL = np.exp2(-RANDOM.uniform(1, 53, 400))
UNIFORM = np.concatenate(
    [RANDOM.random(800), TAIL, 1 - TAIL, [2.0**-53, 0.075, 0.925, 1 - 2.0**-53]]
)


def ulps64(values, function, arguments):
    """Largest error in units of the last place; the truth has 120 bits."""
    with mp.workprec(120):
        truth = [function(mp.mpf(float(x))) for x in arguments]
        return max(
            abs(float((mp.mpf(float(value)) - true) / float(np.spacing(abs(float(true))))))
            for value, true in zip(values, truth, strict=True)
        )


def test_float64_log_errs_by_less_than_one_ulp():
    x = np.concatenate([UNIFORM, RANDOM.uniform(0.5, 1.5, 1000)])  # and where the parts cancel most
    assert ulps64(exact64_ref.log(x), mp.log, x) < 1  # as in float32; 0.8 found


def test_float64_exp_errs_by_less_than_one_ulp():
    x = np.concatenate(
        [
            RANDOM.uniform(0, 24, 1000),
            np.exp2(RANDOM.uniform(-40, 0, 500)),
            RANDOM.uniform(0, 0.7, 1000),
            RANDOM.uniform(0, 700, 500),
        ]
    )
    value, complement = exact64_ref.exp_negative(x)
    assert ulps64(value, lambda t: mp.exp(-t), x) < 1  # as in float32; 0.92 found
    # exp(-x) in [1/2, sqrt(1/2)]: 1 - exp(-x) is exact and has units half as large
    assert ulps64(complement, lambda t: -mp.expm1(-t), x) < 2


def test_float64_normal_quantile():
    z = exact64_ref.normal_quantile(UNIFORM)
    with mp.workprec(120):
        wrong = [
            float((mp.ncdf(mp.mpf(float(a))) - mp.mpf(float(u))) / mp.npdf(mp.mpf(float(a))))
            for a, u in zip(z, UNIFORM, strict=True)
        ]
    # AS 241 promises 1e-16; two sums of eight terms, whose last two roundings count most, and a quotient: 5 * 2^-53
    # and the coefficients' own. 7e-16 found, 4e-15 absolute.
    np.testing.assert_array_less(np.abs(wrong), 1e-15 * np.abs(z) + 1e-300)


def test_float64_uniform_is_inside_0_and_1():
    high, low = np.array([[0, 0, 2**31, 2**32 - 1], [2**12 - 1, 2**12, 0, 2**32 - 1]], np.uint32)
    np.testing.assert_array_equal(
        exact64_ref.uniform(high, low), [2.0**-53, 3 * 2.0**-53, 0.5 + 2.0**-53, 1 - 2.0**-53]
    )


# ---------------------------------------------------------------- the samplers' own maps, without sampling


def total_variation(mean, photon):
    k, p = probabilities(mean, photon)
    return 0.5 * np.abs(p - stats.poisson.pmf(k, float(f32(mean)))).sum()


# from below to above the switch densely (the distance is greatest there), then to where float32 holds every count
@pytest.mark.parametrize(
    "mean",
    [
        1e-8,
        1e-3,
        0.1,
        1.0,
        5.0,
        FAST - 1,
        FAST - 1e-3,
        *(FAST + np.arange(0, 4, 0.25)),
        20.0,
        29.9,
        30.0,
        87.0,
        104.0,
        300.5,
        1e3,
        1e4,
        1e5,
        1e6,
        1e7,
        1.6e7,
    ],
)
def test_total_variation_to_poisson(mean):
    # 1e-4 is what the sampler promises; the search has float32 sums of at most 40 terms: 40 * 2^-25
    assert total_variation(mean, "fast") <= (40 * 2.0**-25 if mean < FAST else 1e-4)


@pytest.mark.parametrize(
    "mean",
    [
        1e-8,
        1e-3,
        0.1,
        1.0,
        5.0,
        11.0,
        EXACT - 1,
        EXACT - 1e-3,
        *(EXACT + np.arange(0, 4, 0.25)),
        30.0,
        87.0,
        104.0,
        300.5,
        1e3,
        1e4,
        1e5,
        *(pytest.param(mean, marks=pytest.mark.slow) for mean in (1e6, 1e7)),
        1.6e7,
    ],
)
def test_total_variation_of_the_exact_sampler(mean):
    # 1e-6 is what it promises; the search has float64 sums of at most 96 terms, each of up to three roundings
    assert total_variation(mean, "exact") <= (3 * 96 * 2.0**-54 if mean < EXACT else 1e-6)


@pytest.mark.parametrize(("photon", "order", "mean"), [("fast", 4, 30.0), ("exact", 6, 300.5)])
def test_every_order_of_the_expansions_is_there(photon, order, mean):
    """The distance falls with the first order left out: m^(-order/2) of a count, in a spread of m^(1/2)."""
    switch = MAPS[photon][2]
    assert total_variation(mean, photon) < total_variation(switch, photon) * (switch / mean) ** (
        (order + 1) / 2
    )


def test_the_expansions_rise_with_the_random_number():
    # what bisection takes for granted; |z| <= 6.76
    z = np.linspace(-6.77, 6.77, 200_001).astype(f32)
    for mean in (FAST, FAST + 0.5, FAST + 1, 20, 100, 1e4, 1e7):
        assert np.all(np.diff(poisson_by_expansion(np.full(z.shape, mean, f32), z)) >= 0)
    tail = 2.0 ** -np.linspace(53, 2, 10_000)
    u = np.concatenate([tail, np.linspace(0.25, 0.75, 50_001)[1:-1], 1 - tail[::-1]])
    for mean in (EXACT, EXACT + 0.5, 30.0, 100.0, 1e4, 1e7):
        assert np.all(np.diff(exact_by_expansion(np.full(u.shape, mean), u)) >= 0)


@pytest.mark.parametrize("photon", MAPS)
def test_rare_photons_are_as_rare_as_they_should(photon):
    means = f32([1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-4])
    # to the nearest of the 2^52 numbers; float32: u and the tail have full relative precision, of 1 - P(0) here 1e-16
    found = [probabilities(mean, photon)[1][1:].sum() for mean in means]
    np.testing.assert_allclose(
        found, -np.expm1(-means.astype(np.float64)), rtol=2.0**-22, atol=2.0**-53
    )
    assert np.all(np.diff(found) > 0)


def test_the_search_ends_where_the_distribution_ends():
    # A sum of probabilities that saturates beside 1 would give one pixel in ten million the largest count there is, at
    # those means where the last rounding goes that way.
    mean, u = np.meshgrid(
        np.geomspace(1e-3, 0.999 * FAST, 200, dtype=f32), f32(2.0) ** -np.arange(66, dtype=f32)
    )
    k = poisson_by_search(mean, u)
    # The bound by a geometric series promises u (k + 1 - mean) < p_k (k + 1), and the true tail is at least p_k. The
    # computed p_k is a product of at most 40 factors, each with two roundings: 80 * 2^-24 < 2^-17.
    tail = stats.poisson.sf(k - 1, mean.astype(np.float64))
    assert np.all(u * (k + 1 - mean) <= tail * (k + 1) * (1 + 2.0**-17))


@pytest.mark.parametrize(("photon", "most"), [("fast", 3e-4), ("exact", 1e-5)])
def test_no_step_at_the_switch(photon, most):
    *halves, switch = MAPS[photon]
    moments = []
    for half in halves:
        k, p = half(switch)
        mean = (k * p).sum()
        moments.append((mean / np.sqrt(switch), ((k - mean) ** 2 * p).sum() / switch))
    # 3e-4 standard deviations: invisible below 1e7 pixels; exact: a total variation of 2.4e-7 within 8 of them, squared
    np.testing.assert_allclose(*moments, rtol=0, atol=most)


def test_samplers_choose_by_the_mean():
    mean = f32([[1e-3, 5, FAST - 0.1, FAST, EXACT - 0.1, EXACT, 1e4, np.nan]])
    u, z = np.full(mean.shape, 0.3), np.full(mean.shape, -0.5, f32)
    few = mean[:, :3]
    np.testing.assert_array_equal(
        poisson(mean, z, u.astype(f32))[:, :3], poisson_by_search(few, f32(u[:, :3]))
    )
    np.testing.assert_array_equal(
        poisson(mean, z, u.astype(f32))[:, 3:-1], poisson_by_expansion(mean, z)[:, 3:-1]
    )
    wide = mean.astype(np.float64)
    np.testing.assert_array_equal(
        poisson_exact(mean, u)[:, :5], exact_by_search(wide[:, :5], u[:, :5])
    )
    np.testing.assert_array_equal(
        poisson_exact(mean, u)[:, 5:-1], exact_by_expansion(wide[:, 5:-1], u[:, 5:-1])
    )
    assert np.isnan(poisson(mean, z, u.astype(f32))[0, -1])
    assert np.isnan(poisson_exact(mean, u)[0, -1])
