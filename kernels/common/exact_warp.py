"""Elementary functions with the same bits on every device; see `exact_ref`.

Modules that use them must set `fuse_fp=False`: every operation must be rounded separately.
"""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  imported only by modules that a Warp device launches

LN2_HIGH = wp.constant(0.693145752)
LN2_LOW = wp.constant(1.42860677e-06)
TWO_TO_MINUS_32 = wp.constant(2.0**-32)
SQRT_HALF_BITS = wp.constant(wp.int32(0x3F3504F3))
SIGN = wp.constant(wp.uint32(0x80000000))
SWAP = wp.constant(wp.uint32(0x40000000))


@wp.func
def exact_log(x: float):
    """Return the natural logarithm of positive normal numbers."""
    bits = wp.cast(x, wp.int32)
    exponent = (bits - SQRT_HALF_BITS) >> 23
    f = wp.cast(bits - (exponent << 23), wp.float32) - 1.0
    n = float(exponent)
    square = f * f
    p = f * -0.0763643906 + 0.127622172
    p = p * f + -0.131596103
    p = p * f + 0.1420158
    p = p * f + -0.166234091
    p = p * f + 0.200012416
    p = p * f + -0.250008196
    p = p * f + 0.333333313
    rest = (f * square) * p - 0.5 * square
    whole = n * LN2_HIGH
    head = whole + f
    lost = f - (head - whole)
    return head + (rest + (lost + n * LN2_LOW))


@wp.func
def exact_exp_negative(x: float):
    """Return exp(-x) and 1 - exp(-x) for 0 <= x <= 87."""
    n = wp.floor(x * 1.44269502 + 0.5)
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    p = r * 0.00138201355 + -0.00836868584
    p = p * r + 0.0416682735
    p = p * r + -0.166665211
    p = p * r + 0.49999994
    lost = r - (r * r) * p
    value = (1.0 - lost) * wp.cast((127 - int(n)) << 23, wp.float32)
    return value, wp.where(n == 0.0, lost, 1.0 - value)


@wp.func
def exact_uniform(high: wp.uint32, low: wp.uint32):
    """Return a number in (0, 1], from 64 random bits."""
    return (float(high) + (float(low) + 0.5) * TWO_TO_MINUS_32) * TWO_TO_MINUS_32


@wp.func
def exact_normal_pair(radial: wp.uint32, angular: wp.uint32):
    """Return two independent standard normal numbers from two random words (Box-Muller)."""
    radius = wp.sqrt(-2.0 * exact_log((float(radial) + 0.5) * TWO_TO_MINUS_32))
    a = float(wp.cast(angular << wp.uint32(2), wp.int32)) * 3.6572953e-10
    square = a * a
    s = (square * -0.000195182918 + 0.00833218917) * square + -0.166666552
    c = (square * 2.44323273e-05 + -0.00138873095) * square + 0.0416666456
    sine = a + (a * square) * s
    even = 1.0 - (0.5 * square - (square * square) * c)
    cosine = wp.cast(wp.cast(even, wp.uint32) ^ (angular & SIGN), wp.float32)
    swap = (angular & SWAP) != wp.uint32(0)
    return wp.vec2(radius * wp.where(swap, sine, cosine), radius * wp.where(swap, cosine, sine))
