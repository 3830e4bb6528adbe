"""The acceptance suite of random numbers: p-values of a sample against independent Poisson numbers.

Every statistical test has a fixed seed. It fails at a p-value below ALPHA, the probability that a
correct sampler with new random numbers would fail it.
"""

from itertools import combinations

import numpy as np
from scipy.special import ndtri

ALPHA = 1e-6
SIGMAS = float(-ndtri(ALPHA / 2))  # 4.9
# across vectors of 8 and groups of 16
LAGS = ((0, 1), (1, 0), (1, 1), (0, 2), (0, 8), (0, 16), (16, 0), (0, 128))
FEW = 20  # a product of two counts of mean m has skewness 1 / (m sqrt n) over n: exp(1) at SIGMAS


def two_sided(z) -> float:
    """Return the two-sided p-value of a standard normal number."""
    from scipy import stats

    return float(2 * stats.norm.sf(abs(z)))


def p_values(k, mean) -> dict[str, float]:
    """Return p-values of a sample against independent Poisson numbers, by test.

    Args:
        k: Counts, shape (rows, cols).
        mean: Mean of the Poisson distribution.
    """
    from scipy import stats

    n, k = k.size, np.asarray(k, np.float64)
    if not (np.isfinite(k).all() and (k == np.floor(k)).all() and k.min() >= 0):
        return {"whole numbers": 0.0}
    if mean == 0:
        return {"darkness": float(not k.any())}
    total = k.sum()
    if n * mean < 1e6:
        photons = stats.poisson(n * mean)
        result = {"mean": min(1, 2 * min(photons.cdf(total), photons.sf(total - 1)))}
    else:  # skewness 1e-3
        result = {"mean": two_sided((total - n * mean) / np.sqrt(n * mean))}
    values = np.arange(k.min(), k.max() + 1)
    place = (k - values[0]).astype(np.int64)
    low, mass = _table(values, mean)
    uniform = mass[place]  # randomised probability integral
    uniform *= np.random.default_rng(7).random(k.shape)
    uniform = np.clip(uniform + low[place], 0, 1).ravel()
    result["chi2"] = stats.chisquare(np.histogram(uniform, 64, (0, 1))[0]).pvalue
    uniform.sort()
    steps = np.arange(n + 1) / n
    farthest = max((steps[1:] - uniform).max(), (uniform - steps[:-1]).max())
    result["KS"] = stats.kstwobign.sf(farthest * np.sqrt(n))
    counts = np.bincount(place.ravel())
    limits = [1, 2, *(stats.poisson.isf(tail, mean) for tail in (1e-3, 1e-5))]
    for limit in limits:
        p = stats.poisson.sf(limit, mean)
        result[f"k > {limit:.0f}"] = (
            stats.binomtest(int(counts[values > limit].sum()), n, p).pvalue if p > 0 else 1.0
        )
    x = (k - mean) / np.sqrt(mean)
    for down, right in LAGS:
        first, second = x[down:, right:], x[: x.shape[0] - down, : x.shape[1] - right]
        result[f"lag {down},{right}"] = correlation(first, second, mean)
    # the central limit theorem at SIGMAS; skewness of both below is (n mean)^-1/2
    if n * mean > 1e4:
        # central moments of Poisson: mu4 = m + 3 m^2, mu6 = m + 25 m^2 + 15 m^3
        square, cube = np.einsum("ij,ij", x, x) / n, np.einsum("ij,ij,ij", x, x, x) / n
        result["dispersion"] = two_sided((square - 1) / np.sqrt((2 + 1 / mean) / n))
        result["skewness"] = two_sided(
            (cube - mean**-0.5) / np.sqrt((15 + 24 / mean + mean**-2) / n)
        )
    return result


def _table(values, mean):
    """Return P(k < value) and P(k = value) of Poisson numbers k that are rounded to float32.

    The rounding matters above 2^24.
    """
    from scipy import stats

    low, mass = stats.poisson.cdf(values - 1, mean), stats.poisson.pmf(values, mean)
    if values[-1] <= 2**24:
        return low, mass
    place = (values.astype(np.float32) - values[0]).astype(np.int64)
    first = np.ones(len(values) + 1)
    np.minimum.at(first, place, low)
    return first, np.bincount(place, mass, len(values) + 1)


def correlation(first, second, mean) -> float:
    """Return the p-value of independence of two samples (k - mean) / sqrt(mean).

    For few photons it tests the number of pixels in which both have some.
    """
    from scipy import stats

    n = first.size
    if mean * np.sqrt(n) < FEW:
        both = np.count_nonzero((first > 0) & (second > 0))  # no photon is below 0
        expected = stats.poisson(n * np.expm1(-mean) ** 2)
        return min(1, 2 * min(expected.cdf(both), expected.sf(both - 1)))
    return two_sided(np.einsum("ij,ij", first, second) / np.sqrt(n))


def suite(draw, mean) -> dict[str, float]:
    """Return p-values of a sampler, by test.

    Frames, seeds and the colours of a mosaic must be independent, too.

    Args:
        draw: Function (seed=1, frame=0) that returns counts (rows, cols).
        mean: Mean of the counts.
    """

    def normalised(k):
        return (k.astype(np.float64) - mean) / np.sqrt(mean)

    k = draw()
    p = p_values(k, mean)
    if mean:
        x = normalised(k)
        for name, other in (
            ("next frame", draw(frame=1)),
            ("far frame", draw(frame=2**31)),
            ("seed", draw(seed=2)),
            ("high half of the seed", draw(seed=1 + 2**32)),
        ):
            p[name] = correlation(x, normalised(other), mean)
        colours = {f"{i}{j}": x[i::2, j::2] for i in (0, 1) for j in (0, 1)}
        for one, other in combinations(colours, 2):
            p[f"colours {one} {other}"] = correlation(colours[one], colours[other], mean)
    return p


def check(draw, mean):
    """Raise AssertionError unless the sampler passes.

    Args:
        draw: As for `suite`.
        mean: Mean of the counts.
    """
    failed = {name: value for name, value in suite(draw, mean).items() if not value >= ALPHA}
    assert not failed, failed
