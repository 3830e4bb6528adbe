"""Elementary functions with the same bits on every device: every operation is correctly rounded.

IEEE 754 fixes the bits of + - * / sqrt and of conversions, but not of library functions. Logarithm,
exponential, sine and cosine are therefore built from these operations, in float32 and without
contraction into fused multiply-adds. The polynomials are weighted minimax fits (Lawson's
iteration). Their coefficients were rounded to float32 one after the other, and the remaining ones
fitted again. Largest errors over every float32 of the ranges in use [ulp]: log 0.91, exp 0.99, 1 -
exp 1.47, sine 0.74, cosine 0.99 (tests/host/test_poisson.py). The devices' versions (`exact.clh`,
`exact_warp.py`) do the same operations in the same order.
"""

import numpy as np

f32 = np.float32

# (log(1 + f) - f + f^2/2) / f^3 on [sqrt(1/2) - 1, sqrt(2) - 1]
LOG = [
    f32(c)
    for c in (
        0.333333313,
        -0.250008196,
        0.200012416,
        -0.166234091,
        0.1420158,
        -0.131596103,
        0.127622172,
        -0.0763643906,
    )
]
# (exp(-r) - 1 + r) / r^2 on [-ln(2)/2, ln(2)/2]
EXP = [f32(c) for c in (0.49999994, -0.166665211, 0.0416682735, -0.00836868584, 0.00138201355)]
# (sin(a) - a) / a^3 and (cos(a) - 1 + a^2/2) / a^4, in a^2, on [0, (pi/4)^2]
SIN = [f32(c) for c in (-0.166666552, 0.00833218917, -0.000195182918)]
COS = [f32(c) for c in (0.0416666456, -0.00138873095, 2.44323273e-05)]
LN2_HIGH = f32(0.693145752)  # 16 bits: a small integer times it is exact
LN2_LOW = f32(1.42860677e-06)
ONE_OVER_LN2 = f32(1.44269502)
TWO_TO_MINUS_32 = f32(2.0**-32)
QUARTER_PI_TO_MINUS_31 = f32(3.6572953e-10)  # pi/4 / 2^31
SQRT_HALF_BITS = np.int32(0x3F3504F3)


def horner(x, coefficients):
    """Return a polynomial with the coefficients in rising order."""
    result = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        result = result * x + coefficient
    return result


def log(x):
    """Return the natural logarithm of positive normal float32 numbers."""
    bits = np.asarray(x, f32).view(np.int32)
    exponent = (bits - SQRT_HALF_BITS) >> np.int32(23)
    # exact: x / 2^exponent is in [sqrt(1/2), sqrt(2))
    f = (bits - (exponent << np.int32(23))).view(f32) - f32(1)
    n = exponent.astype(f32)
    square = f * f
    rest = (f * square) * horner(f, LOG) - f32(0.5) * square
    whole = n * LN2_HIGH
    head = whole + f
    lost = f - (head - whole)  # exact, as |whole| > |f| or whole = 0
    return head + (rest + (lost + n * LN2_LOW))


def exp_negative(x):
    """Return exp(-x) and 1 - exp(-x), each to full relative precision, for 0 <= x <= 87."""
    x = np.asarray(x, f32)
    n = np.floor(x * ONE_OVER_LN2 + f32(0.5))
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    complement = r - (r * r) * horner(r, EXP)
    scale = ((np.int32(127) - n.astype(np.int32)) << np.int32(23)).view(f32)  # 2^-n
    value = (f32(1) - complement) * scale
    return value, np.where(n == 0, complement, f32(1) - value)


def sine_cosine(a):
    """Return sin(a) and cos(a) for |a| <= pi/4."""
    square = a * a
    return (
        a + (a * square) * horner(square, SIN),
        f32(1) - (f32(0.5) * square - (square * square) * horner(square, COS)),
    )


def uniform(high, low):
    """Return float32 numbers in (0, 1] from 64 random bits, fully precise down to 2^-65."""
    return (high.astype(f32) + (low.astype(f32) + f32(0.5)) * TWO_TO_MINUS_32) * TWO_TO_MINUS_32


def normal_pair(radial, angular):
    """Return two independent standard normal numbers from two random words.

    Source: Box and Muller, Annals of Mathematical Statistics 29 (1958), p. 610. The radius comes
    from `radial`. The top two bits of `angular` choose one of four arcs around the axes, the other
    thirty the angle a in [-pi/4, pi/4) within it. |z| reaches sqrt(66 ln 2) = 6.76.
    """
    u = (radial.astype(f32) + f32(0.5)) * TWO_TO_MINUS_32
    radius = np.sqrt(f32(-2) * log(u))
    a = (angular << np.uint32(2)).view(np.int32).astype(f32) * QUARTER_PI_TO_MINUS_31
    sine, cosine = sine_cosine(a)
    cosine = np.where(angular >> np.uint32(31), -cosine, cosine)
    swap = (angular & np.uint32(0x40000000)) != 0
    return radius * np.where(swap, sine, cosine), radius * np.where(swap, cosine, sine)
