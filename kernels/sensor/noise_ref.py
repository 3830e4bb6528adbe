"""Photon, dark, read and fixed-pattern noise, saturation and the analog-digital converter.

Unlike every other reference this one computes in float32: digital numbers have to agree bit for bit on all devices, so
the order of correctly rounded float32 operations written here *is* the specification. What judges it is probability
theory (tests/test_noise.py), not a more precise computation.
"""

import numpy as np

from gpusim.kernels.common.exact_ref import exp_negative, f32, horner, normal_pair, uniform
from gpusim.kernels.common.philox_ref import philox, seed_words

SEARCH_BELOW = f32(12)  # mean [e-]; least for which the expansion is within 1e-4 of Poisson in total variation
MOST_BY_SEARCH = 40  # P(k > 40) < 1e-10 at mean 12
MOST_EXPECTED = f32(1e30)  # stands for infinity, so that no inf - inf arises
TEMPORAL, FIXED = 0, 1  # random streams: anew for every frame, or belonging to the sensor

SECOND = f32(1) / f32(3), f32(1) / f32(6)
THIRD = f32(-1) / f32(36), f32(-1) / f32(72)
FOURTH = f32(-8) / f32(405), f32(7) / f32(810), f32(1) / f32(270)


def noise(mean, *, dark_electrons=0.0, read_noise=0.0, prnu=0.0, dsnu=0.0, full_well, gain, black_level=0.0,
          white_level, photon_noise=True, seed=0, sensor_seed=0, frame=0, electrons=False):
    """See `gpusim.kernels.sensor.noise`."""
    mean = np.asarray(mean, f32)
    pixel = np.arange(mean.size, dtype=np.uint32).reshape(mean.shape)
    z_prnu, z_dsnu = normal_pair(*philox((pixel, 0, 0, FIXED), seed_words(sensor_seed))[:2])
    words = philox((pixel, 0, frame, TEMPORAL), seed_words(seed))
    z_photon, z_read = normal_pair(*words[:2])

    expected = np.where(mean > MOST_EXPECTED, MOST_EXPECTED, mean)
    if prnu:
        expected = expected * (f32(1) + f32(prnu) * z_prnu)
    expected = np.where(expected < 0, f32(0), expected) + f32(dark_electrons)
    collected = poisson(expected, z_photon, uniform(*words[2:])) if photon_noise else expected
    result = np.where(collected > f32(full_well), f32(full_well), collected)
    if read_noise:
        result = result + f32(read_noise) * z_read
    if dsnu:
        result = result + f32(dsnu) * z_dsnu
    if electrons:
        return result
    level = f32(gain) * result + f32(black_level)
    level = np.where(level > 0, level, f32(0))  # NaN too
    return np.rint(np.where(level < f32(white_level), level, f32(white_level))).astype(np.uint16)


def poisson(mean, z, u):
    """Poisson numbers of float32 `mean`: by search where it is below SEARCH_BELOW, else by expansion; NaN gives NaN.

    z: standard normal numbers; u: uniform numbers in (0, 1].
    """
    few = mean < SEARCH_BELOW
    count = np.empty_like(mean)
    count[few] = poisson_by_search(mean[few], u[few])
    count[~few] = poisson_by_expansion(mean[~few], z[~few])
    return count


def poisson_by_search(mean, u):
    """Walk up the distribution while P(k >= j) > u, the inversion of its upper tail.

    Small u are many photons, so that rare events keep the relative precision of u, and mean 1e-8 its one in 1e8. The
    tail is 1 less the probabilities so far; where that is rounding error only, its bound by a geometric series,
    P(k >= j) <= p_j (j + 1) / (j + 1 - mean), ends the walk. Without it up to 7 pixels in 1e8 ran to the cap.
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
    """Third-order Cornish-Fisher expansion of the Poisson quantile at Phi(z).

    Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function", ACM TOMS 42 (2016),
    equation of the normal asymptotic expansion, rounded down. The whole part of the mean stays apart, so that large
    counts are rounded once: rounded twice, odd ones would be rarer than even ones.
    """
    root, whole, square = np.sqrt(mean), np.floor(mean), z * z
    third = z * horner(square, THIRD)
    shift = root * z + (horner(square, SECOND) + (third + horner(square, FOURTH) / root) / root)
    count = whole + np.floor((mean - whole) + shift)
    return np.where(count < 0, f32(0), count)
