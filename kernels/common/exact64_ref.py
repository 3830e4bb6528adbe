"""Elementary functions in float64 with the same bits on every device; `exact_ref` has the reasons.

The polynomials are Taylor series, whose constants need no source. Largest errors over random
arguments [ulp]: log 0.8, exp 0.93, 1 - exp 1.7; normal quantile 7e-16 of its value
(tests/host/test_poisson.py).
"""

import numpy as np

LN2_HIGH = np.float64(0.6931471803691238)  # 32 bits: a small integer times it is exact
LN2_LOW = np.float64(1.9082149292705877e-10)
ONE_OVER_LN2 = np.float64(1.4426950408889634)
SQRT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)
LOG_TERMS = 10  # the first omitted term is s^20 2 / 21 < 2^-54, s <= 3 - sqrt(8)
EXP_TERMS = 14  # (ln(2)/2)^14 / 14! < 2^-54

# Wichura, "Algorithm AS 241: the percentage points of the normal distribution", Applied Statistics
# 37 (1988), 477-484: numerator and denominator of q P(0.425^2 - q^2), and of P(r - 1.6) and P(r - 5), r = sqrt(-log u)
CENTRE = (
    (
        3.3871328727963666080e0,
        1.3314166789178437745e2,
        1.9715909503065514427e3,
        1.3731693765509461125e4,
        4.5921953931549871457e4,
        6.7265770927008700853e4,
        3.3430575583588128105e4,
        2.5090809287301226727e3,
    ),
    (
        1.0,
        4.2313330701600911252e1,
        6.8718700749205790830e2,
        5.3941960214247511077e3,
        2.1213794301586595867e4,
        3.9307895800092710610e4,
        2.8729085735721942674e4,
        5.2264952788528545610e3,
    ),
)
NEAR_TAIL = (
    (
        1.42343711074968357734e0,
        4.63033784615654529590e0,
        5.76949722146069140550e0,
        3.64784832476320460504e0,
        1.27045825245236838258e0,
        2.41780725177450611770e-1,
        2.27238449892691845833e-2,
        7.74545014278341407640e-4,
    ),
    (
        1.0,
        2.05319162663775882187e0,
        1.67638483018380384940e0,
        6.89767334985100004550e-1,
        1.48103976427480074590e-1,
        1.51986665636164571966e-2,
        5.47593808499534494600e-4,
        1.05075007164441684324e-9,
    ),
)
FAR_TAIL = (
    (
        6.65790464350110377720e0,
        5.46378491116411436990e0,
        1.78482653991729133580e0,
        2.96560571828504891230e-1,
        2.65321895265761230930e-2,
        1.24266094738807843860e-3,
        2.71155556874348757815e-5,
        2.01033439929228813265e-7,
    ),
    (
        1.0,
        5.99832206555887937690e-1,
        1.36929880922735805310e-1,
        1.48753612908506148525e-2,
        7.86869131145613259100e-4,
        1.84631831751005468180e-5,
        1.42151175831644588870e-7,
        2.04426310338993978564e-15,
    ),
)


def horner(x, coefficients):
    """Return a polynomial with the coefficients in rising order."""
    result = np.float64(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        result = result * x + np.float64(coefficient)
    return result


def log(x):
    """Return the natural logarithm of positive normal float64 numbers."""
    bits = np.asarray(x, np.float64).view(np.int64)
    exponent = (bits - SQRT_HALF_BITS) >> np.int64(52)
    f = (bits - (exponent << np.int64(52))).view(np.float64) - 1.0  # exact
    n = exponent.astype(np.float64)
    # log(1 + f) = 2 artanh s = f - f^2/2 + s (f^2/2 + R), R = 2 (s^2/3 + s^4/5 + ...)
    s = f / (f + 2.0)
    half, square = 0.5 * f * f, s * s
    rest = square * horner(square, [2.0 / (2 * k + 3) for k in range(LOG_TERMS)])
    return n * LN2_HIGH - ((half - (s * (half + rest) + n * LN2_LOW)) - f)


def exp_negative(x):
    """Return exp(-x) and 1 - exp(-x), each to full relative precision, for 0 <= x <= 700."""
    x = np.asarray(x, np.float64)
    n = np.floor(x * ONE_OVER_LN2 + 0.5)
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    factors = [1.0]
    for k in range(3, EXP_TERMS):
        factors.append(-factors[-1] / k)  # (exp(-r) - 1 + r) / (r^2 / 2) = 1 - r/3 + r^2/12 - ...
    complement = r - (0.5 * (r * r)) * horner(r, factors)
    scale = ((np.int64(1023) - n.astype(np.int64)) << np.int64(52)).view(np.float64)  # 2^-n
    value = (1.0 - complement) * scale
    return value, np.where(n == 0, complement, 1.0 - value)


def uniform(high, low):
    """Return float64 numbers in (0, 1) from 64 random bits: the upper 52, half a step up.

    With 53 bits the last number would be 1.
    """
    return (
        high.astype(np.float64) * 1048576.0 + (low >> np.uint32(12)).astype(np.float64) + 0.5
    ) * 2.0**-52


def normal_quantile(u):
    """Return the standard normal quantile of u, 0 < u < 1 (AS 241)."""
    q = np.asarray(u, np.float64) - 0.5
    middle = np.abs(q) <= 0.425
    near = 0.180625 - np.where(middle, q, 0.0) ** 2
    central = q * (horner(near, CENTRE[0]) / horner(near, CENTRE[1]))
    r = np.sqrt(-log(np.where(middle, 0.5, np.where(q < 0, u, 1.0 - u))))
    far = r > 5.0
    close, distant = r - 1.6, np.where(far, r, 5.0) - 5.0
    tail = np.where(
        far,
        horner(distant, FAR_TAIL[0]) / horner(distant, FAR_TAIL[1]),
        horner(close, NEAR_TAIL[0]) / horner(close, NEAR_TAIL[1]),
    )
    return np.where(middle, central, np.where(q < 0, -tail, tail))
