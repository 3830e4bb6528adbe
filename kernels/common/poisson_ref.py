"""Poisson numbers: the order of correctly rounded operations here specifies all devices.

There are two samplers. `poisson` is float32 and within 1e-4 of the distribution in total variation
at every mean up to float32's exact integers (1.6e7). `poisson_exact` is float64 and within 1e-6.
Both search at small means and expand the quantile at large ones.
"""

import numpy as np

from gpusim.kernels.common import exact64_ref
from gpusim.kernels.common.exact_ref import exp_negative, f32, horner

# mean [e-]; above it the expansion is within 1e-4 of Poisson in total variation (5.2e-5 there)
SEARCH_BELOW = f32(9)
MOST_BY_SEARCH = 40  # P(k > 40) < 1e-14 at mean 9
EXACT_SEARCH_BELOW = f32(24)  # the same for 1e-6 (2.4e-7 there)
EXACT_MOST_BY_SEARCH = 96  # P(k > 96) < 1e-26 at mean 24

# Cornish-Fisher terms of order m^0, m^(-1/2), ...: coefficients of z^0, z^2, ... or z^1, z^3, ... in turn. The first
# contains the half for rounding down.
TERMS = (
    (1 / 3, 1 / 6),
    (-1 / 36, -1 / 72),
    (-8 / 405, 7 / 810, 1 / 270),
    (671 / 38880, -137 / 38880, -23 / 17280),
    (-16 / 25515, -5189 / 408240, 5 / 3024, 19 / 34020),
    (274867 / 146966400, 2647909 / 293932800, -165779 / 195955200, -11237 / 43545600),
)
FAST_TERMS = [[f32(c) for c in term] for term in TERMS[:4]]


def poisson(mean, z, u):
    """Return Poisson numbers of float32 `mean`; NaN gives NaN.

    Means below SEARCH_BELOW are searched, larger ones expanded. z: standard normal numbers. u:
    uniform numbers in (0, 1].
    """
    few = mean < SEARCH_BELOW
    count = np.empty_like(mean)
    count[few] = poisson_by_search(mean[few], u[few])
    count[~few] = poisson_by_expansion(mean[~few], z[~few])
    return count


def poisson_by_search(mean, u):
    """Walk up the distribution while P(k >= j) > u, the inversion of its upper tail.

    Small u give many photons: rare events keep the relative precision of u, and a mean of 1e-8 its
    one in 1e8. The tail is 1 minus the probabilities so far. If only rounding error is left of it,
    its bound by a geometric series, P(k >= j) <= p_j (j + 1) / (j + 1 - mean), ends the walk.
    Without the bound, up to 7 pixels in 1e8 reached the cap.
    """
    p, above = exp_negative(mean)
    count = np.zeros_like(mean)
    going = np.ones(mean.shape, bool)
    for j in range(1, MOST_BY_SEARCH + 1):
        p = p * (mean * (f32(1) / f32(j)))
        going &= (u < above) & (u * (f32(j + 1) - mean) < p * f32(j + 1))
        if not going.any():
            break
        count += going
        above = above - p
    return count


def poisson_by_expansion(mean, z):
    """Expand the Poisson quantile at Phi(z) to the fourth order (Cornish-Fisher), rounded down.

    Source: Cornish and Fisher, Revue de l'Institut International de Statistique 5 (1938), 307-320,
    with the cumulants of a Poisson number minus the cumulants of a uniform one, which make the
    lattice smooth; the first orders as in Giles, "Algorithm 955", ACM TOMS 42 (2016). The whole
    part of the mean is added separately, and large counts are thus rounded once. Rounded twice, odd
    counts would be rarer than even ones.
    """
    root, whole = np.sqrt(mean), np.floor(mean)
    shift = root * z + series(z, f32(1) / root, FAST_TERMS, horner)
    count = whole + np.floor((mean - whole) + shift)
    return np.where(count < 0, f32(0), count)


def series(z, inverse, terms, horner):
    """Return the sum over n of inverse^n terms[n](z), inverse = 1 / sqrt(mean)."""
    square, rest = z * z, None
    for order in reversed(range(len(terms))):
        term = horner(square, terms[order])
        term = term * z if order % 2 else term
        rest = term if rest is None else term + rest * inverse
    return rest


def poisson_exact(mean, u):
    """Return Poisson numbers of float32 `mean` from float64 uniform numbers; NaN gives NaN.

    u is in (0, 1).

    The computation is in float64, the expansion as in `poisson_by_expansion` but to the sixth
    order.
    """
    few = mean < EXACT_SEARCH_BELOW
    count = np.empty(mean.shape)
    count[few] = exact_by_search(mean[few].astype(np.float64), u[few])
    count[~few] = exact_by_expansion(mean[~few].astype(np.float64), u[~few])
    return count.astype(f32)


def exact_by_search(mean, u):
    """Walk up the distribution while P(k >= j) > u."""
    p, above = exact64_ref.exp_negative(mean)
    count = np.zeros_like(mean)
    going = np.ones(mean.shape, bool)
    for j in range(1, EXACT_MOST_BY_SEARCH + 1):
        p = p * (mean * (1.0 / j))
        going &= u < above
        if not going.any():
            break
        count += going
        above = above - p
    return count


def exact_by_expansion(mean, u):
    """Expand the quantile at u to the sixth order (Cornish-Fisher), rounded down."""
    z, root = exact64_ref.normal_quantile(u), np.sqrt(mean)
    count = np.floor(mean + (root * z + series(z, 1.0 / root, TERMS, exact64_ref.horner)))
    return np.where(count < 0, 0.0, count)
