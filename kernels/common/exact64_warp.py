"""Float64 functions with the same bits on every device; see `exact64_ref`.

Modules that use them must set `fuse_fp=False`: every operation must be rounded separately.
"""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  imported only by modules that a Warp device launches

from gpusim.kernels.common import exact64_ref

f64 = wp.float64
Eight = wp.types.vector(length=8, dtype=f64)
LogTerms = wp.types.vector(length=exact64_ref.LOG_TERMS, dtype=f64)
ExpTerms = wp.types.vector(length=exact64_ref.EXP_TERMS - 2, dtype=f64)


def _exp_factors():
    factors = [1.0]
    for k in range(3, exact64_ref.EXP_TERMS):
        factors.append(-factors[-1] / k)
    return factors


SQRT_HALF_BITS = wp.constant(wp.int64(0x3FE6A09E667F3BCD))
LN2_HIGH = wp.constant(f64(0.6931471803691238))
LN2_LOW = wp.constant(f64(1.9082149292705877e-10))
ONE_OVER_LN2 = wp.constant(f64(1.4426950408889634))
TWO_TO_MINUS_52 = wp.constant(f64(2.0**-52))
LOG = wp.constant(LogTerms(*(2.0 / (2 * k + 3) for k in range(exact64_ref.LOG_TERMS))))
EXP = wp.constant(ExpTerms(*_exp_factors()))
CENTRE_ABOVE, CENTRE_BELOW = (wp.constant(Eight(*part)) for part in exact64_ref.CENTRE)
NEAR_ABOVE, NEAR_BELOW = (wp.constant(Eight(*part)) for part in exact64_ref.NEAR_TAIL)
FAR_ABOVE, FAR_BELOW = (wp.constant(Eight(*part)) for part in exact64_ref.FAR_TAIL)


@wp.func
def exact_log64(x: f64):
    """Return the natural logarithm of positive normal numbers."""
    bits = wp.cast(x, wp.int64)
    exponent = (bits - SQRT_HALF_BITS) >> wp.int64(52)
    f = wp.cast(bits - (exponent << wp.int64(52)), f64) - f64(1.0)
    n = f64(exponent)
    s = f / (f + f64(2.0))
    half = f64(0.5) * f * f
    square = s * s
    p = LOG[9]
    for k in range(1, 10):
        p = p * square + LOG[9 - k]
    rest = square * p
    return n * LN2_HIGH - ((half - (s * (half + rest) + n * LN2_LOW)) - f)


@wp.func
def exact_exp_negative64(x: f64):
    """Return exp(-x) and 1 - exp(-x) for 0 <= x <= 700."""
    n = wp.floor(x * ONE_OVER_LN2 + f64(0.5))
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    p = EXP[11]
    for k in range(1, 12):
        p = p * r + EXP[11 - k]
    lost = r - (f64(0.5) * (r * r)) * p
    value = (f64(1.0) - lost) * wp.cast((wp.int64(1023) - wp.int64(n)) << wp.int64(52), f64)
    return value, wp.where(n == f64(0.0), lost, f64(1.0) - value)


@wp.func
def exact_uniform64(high: wp.uint32, low: wp.uint32):
    """Return a number in (0, 1), from the upper 52 of 64 random bits."""
    return (f64(high) * f64(1048576.0) + f64(low >> wp.uint32(12)) + f64(0.5)) * TWO_TO_MINUS_52


@wp.func
def ratio(x: f64, above: Eight, below: Eight):
    """Return the quotient of two polynomials."""
    p = above[7]
    q = below[7]
    for k in range(1, 8):
        p = p * x + above[7 - k]
        q = q * x + below[7 - k]
    return p / q


@wp.func
def exact_normal_quantile(u: f64):
    """Return the standard normal quantile (AS 241)."""
    q = u - f64(0.5)
    if wp.abs(q) <= f64(0.425):
        return q * ratio(f64(0.180625) - q * q, CENTRE_ABOVE, CENTRE_BELOW)
    side = wp.where(q < f64(0.0), u, f64(1.0) - u)
    r = wp.sqrt(-exact_log64(side))
    size = f64(0.0)
    if r > f64(5.0):
        size = ratio(r - f64(5.0), FAR_ABOVE, FAR_BELOW)
    else:
        size = ratio(r - f64(1.6), NEAR_ABOVE, NEAR_BELOW)
    return wp.where(q < f64(0.0), -size, size)
