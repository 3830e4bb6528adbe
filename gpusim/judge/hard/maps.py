"""Exact distributions of the photon samplers: P(k) by bisection over their random numbers.

The samplers run on the reference device, and all devices have the same bits. The distance to the
Poisson distribution is therefore known to far below the resolution of any sample.
"""

import numpy as np
from scipy.special import ndtr

from gpusim.kernels.common.poisson_ref import (
    EXACT_MOST_BY_SEARCH,
    EXACT_SEARCH_BELOW,
    MOST_BY_SEARCH,
    SEARCH_BELOW,
    exact_by_expansion,
    exact_by_search,
    poisson_by_expansion,
    poisson_by_search,
)

f32 = np.float32
FAST, EXACT = float(SEARCH_BELOW), float(EXACT_SEARCH_BELOW)  # means where expansions begin [e-]
STEPS = 2**52  # uniform numbers of the exact sampler: (n + 1/2) / STEPS


def crossing(predicate, low, high, shape):
    """Return the number at which the monotone `predicate` becomes true, per element of `shape`.

    Bisection over the float32 numbers in [low, high]. The result is halfway between the last number
    for which it is false and the first for which it is true: real numbers above it are rounded to
    the latter.
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


def step(predicate, shape):
    """Return how many uniform numbers of the exact sampler are below the first that fits."""
    low, high = np.full(shape, -1, np.int64), np.full(shape, STEPS, np.int64)
    while (high - low).max() > 1:
        middle = np.clip((low + high + 1) // 2, 0, STEPS - 1)
        found = predicate((middle + 0.5) / STEPS)
        low, high = np.where(found, low, middle), np.where(found, middle, high)
        low = np.where(low == STEPS - 1, STEPS, low)  # for none
    return high


def around(mean):
    """Return counts within 8 standard deviations, and a few more upwards.

    The probability beyond is 6e-16 or less.
    """
    root = np.sqrt(mean)
    return np.arange(max(np.floor(mean - 8 * root), 0), np.ceil(mean + 8 * root + 10) + 2)


def search_probabilities(mean):
    """Return k and P(k) of the search for a uniform number that is rounded to float32."""
    k = np.arange(1, MOST_BY_SEARCH + 1)
    means = np.full(k.shape, mean, f32)
    tail = crossing(lambda u: poisson_by_search(means, u) < k, 0.0, 2.0, k.shape)  # k falls with u
    return np.arange(MOST_BY_SEARCH + 1), -np.diff(
        np.concatenate([[1.0], np.minimum(tail, 1), [0.0]])
    )


def expansion_probabilities(mean):
    """Return k and P(k) of the expansion for a normal number that is rounded to float32."""
    k = around(mean)
    means = np.full(k.shape, mean, f32)
    below = ndtr(crossing(lambda z: poisson_by_expansion(means, z) >= k, -12.0, 12.0, k.shape))
    below[0] = 0.0
    return k[:-1], np.diff(below)


def exact_search_probabilities(mean):
    """Return k and P(k) of the exact search."""
    k = np.arange(1, EXACT_MOST_BY_SEARCH + 1)
    means = np.full(k.shape, mean)
    tail = step(lambda u: exact_by_search(means, u) < k, k.shape)
    return np.arange(EXACT_MOST_BY_SEARCH + 1), -np.diff(
        np.concatenate([[STEPS], tail, [0]])
    ) / STEPS


def exact_expansion_probabilities(mean):
    """Return k and P(k) of the exact expansion."""
    k = around(mean)
    means = np.full(k.shape, mean)
    below = step(lambda u: exact_by_expansion(means, u) >= k, k.shape)
    below[0] = 0
    return k[:-1], np.diff(below) / STEPS


MAPS = {  # search, expansion, and the mean at which the expansion begins
    "fast": (search_probabilities, expansion_probabilities, FAST),
    "exact": (exact_search_probabilities, exact_expansion_probabilities, EXACT),
}


def probabilities(mean, photon="fast"):
    """Return counts and their probabilities for a sampler at a mean.

    Args:
        mean: Mean of the counts, rounded to float32.
        photon: The sampler, "fast" or "exact".
    """
    search, expansion, switch = MAPS[photon]
    mean = float(f32(mean))
    return (search if mean < switch else expansion)(mean)
