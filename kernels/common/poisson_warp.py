"""Poisson numbers with the same bits on every device; `poisson_ref` has the formulas."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  imported only by modules that a Warp device launches

from gpusim.kernels.common.exact64_warp import (
    exact_exp_negative64,
    exact_normal_quantile,
    exact_uniform64,
)
from gpusim.kernels.common.exact_warp import exact_exp_negative, exact_uniform

f64 = wp.float64
SEARCH_BELOW = wp.constant(9.0)  # mean [e-]
MOST_BY_SEARCH = wp.constant(40)
EXACT_SEARCH_BELOW = wp.constant(24.0)
EXACT_MOST_BY_SEARCH = wp.constant(96)

# of z^0, z^2, ..., divided in float64 as in the reference
C0 = wp.constant(wp.types.vector(2, f64)(1 / 3, 1 / 6))
C1 = wp.constant(wp.types.vector(2, f64)(-1 / 36, -1 / 72))
C2 = wp.constant(wp.types.vector(3, f64)(-8 / 405, 7 / 810, 1 / 270))
C3 = wp.constant(wp.types.vector(3, f64)(671 / 38880, -137 / 38880, -23 / 17280))
C4 = wp.constant(wp.types.vector(4, f64)(-16 / 25515, -5189 / 408240, 5 / 3024, 19 / 34020))
C5 = wp.constant(
    wp.types.vector(4, f64)(
        274867 / 146966400, 2647909 / 293932800, -165779 / 195955200, -11237 / 43545600
    )
)


@wp.func
def poisson_by_search(mean: float, u: float):
    """Count photons by walking up the distribution until the tail is below u."""
    p, above = exact_exp_negative(mean)
    count = float(0.0)
    for j in range(1, MOST_BY_SEARCH + 1):
        n = float(j)
        p = p * (mean * (1.0 / n))
        if not (u < above and u * ((n + 1.0) - mean) < p * (n + 1.0)):
            break
        count += 1.0
        above -= p
    return count


@wp.func
def poisson_by_expansion(mean: float, z: float):
    """Count photons from a normal number, fourth-order Cornish-Fisher."""
    root = wp.sqrt(mean)
    inverse = 1.0 / root
    whole = wp.floor(mean)
    s = z * z
    rest = ((s * (-23.0 / 17280.0) + (-137.0 / 38880.0)) * s + 671.0 / 38880.0) * z
    rest = ((s * (1.0 / 270.0) + 7.0 / 810.0) * s + (-8.0 / 405.0)) + rest * inverse
    rest = (s * (-1.0 / 72.0) + (-1.0 / 36.0)) * z + rest * inverse
    rest = (s * (1.0 / 6.0) + 1.0 / 3.0) + rest * inverse
    count = whole + wp.floor((mean - whole) + (root * z + rest))
    return wp.where(count < 0.0, 0.0, count)


@wp.func
def poisson(mean: float, high: wp.uint32, low: wp.uint32, z: float):
    """Return a number within 1e-4 of Poisson in total variation."""
    if mean < SEARCH_BELOW:
        return poisson_by_search(mean, exact_uniform(high, low))
    return poisson_by_expansion(mean, z)


@wp.func
def exact_by_search(mean: f64, u: f64):
    """Count photons by walking up the distribution until the tail is below u."""
    p, above = exact_exp_negative64(mean)
    count = f64(0.0)
    for j in range(1, EXACT_MOST_BY_SEARCH + 1):
        p = p * (mean * (f64(1.0) / f64(j)))
        if not u < above:
            break
        count += f64(1.0)
        above -= p
    return count


@wp.func
def exact_by_expansion(mean: f64, u: f64):
    """Count photons from a uniform number, sixth-order Cornish-Fisher."""
    z = exact_normal_quantile(u)
    root = wp.sqrt(mean)
    s = z * z
    inverse = f64(1.0) / root
    rest = (((C5[3] * s + C5[2]) * s + C5[1]) * s + C5[0]) * z
    rest = (((C4[3] * s + C4[2]) * s + C4[1]) * s + C4[0]) + rest * inverse
    rest = ((C3[2] * s + C3[1]) * s + C3[0]) * z + rest * inverse
    rest = ((C2[2] * s + C2[1]) * s + C2[0]) + rest * inverse
    rest = (C1[1] * s + C1[0]) * z + rest * inverse
    rest = (C0[1] * s + C0[0]) + rest * inverse
    count = wp.floor(mean + (root * z + rest))
    return wp.where(count < f64(0.0), f64(0.0), count)


@wp.func
def poisson_exact(mean: float, high: wp.uint32, low: wp.uint32):
    """Return a number within 1e-6 of Poisson in total variation."""
    u = exact_uniform64(high, low)
    if mean < EXACT_SEARCH_BELOW:
        return float(exact_by_search(f64(mean), u))
    return float(exact_by_expansion(f64(mean), u))
