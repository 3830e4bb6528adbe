// From mean electrons to digital numbers, WIDTH pixels per work-item. noise_ref.py has the formulas.
// From the host: WIDTH, and as 0 or 1 PHOTON_NOISE, READ_NOISE, PRNU, DSNU.
#include "philox.clh"
#include "exact.clh"

#define SEARCH_BELOW 12.0f  // mean [e-]
#define MOST_BY_SEARCH 40
#define MOST_EXPECTED 1e30f
#define TEMPORAL 0u
#define FIXED 1u

// Number of photons by walking up the distribution until the tail is below u; for means below SEARCH_BELOW.
INLINE real poisson_by_search(const real mean, const real u)
{
    const Exponential start = exact_exp_negative(mean);
    real p = start.value, above = start.complement, count = 0.0f;
    integer going = -1;  // true in a vector; the comparisons make it 1 in a scalar
    for (int j = 1; j <= MOST_BY_SEARCH; ++j) {
        p = p * (mean * (1.0f / j));
        going = going & (u < above) & (u * ((j + 1) - mean) < p * (j + 1));
        if (!ANY(going)) break;
        count += going ? (real)1.0f : (real)0.0f;
        above -= p;
    }
    return count;
}

// Number of photons from a normal number, third-order Cornish-Fisher; for the other means.
INLINE real poisson_by_expansion(const real mean, const real z)
{
    const real root = sqrt(mean), whole = floor(mean), square = z * z;
    const real second = square * (1.0f / 6) + (1.0f / 3);
    const real third = z * (square * (-1.0f / 72) + (-1.0f / 36));
    const real fourth = square * (square * (1.0f / 270) + (7.0f / 810)) + (-8.0f / 405);
    const real shift = root * z + (second + (third + fourth / root) / root);
    const real count = whole + floor((mean - whole) + shift);
    return count < 0.0f ? (real)0.0f : count;
}

INLINE real poisson(const real mean, const Words words, const real z)
{
    const integer few = mean < SEARCH_BELOW;
    real count = poisson_by_expansion(mean, z);
    if (ANY(few)) {
        const real searched = poisson_by_search(few ? mean : (real)0.0f, exact_uniform(words.c, words.d));
        count = few ? searched : count;
    }
    return count;
}

// Lanes beyond the last pixel are computed from 0 and not stored.
INLINE real load(__global const float *restrict from, const int lanes)
{
    real values = 0.0f;
    for (int lane = 0; lane < lanes; ++lane) ((float *)&values)[lane] = from[lane];
    return values;
}

// Electrons at the analog-digital converter.
INLINE real noisy_electrons(
    real expected, const int start, const float dark_electrons, const float read_noise, const float prnu,
    const float dsnu, const float full_well, const int seed_low, const int seed_high, const int sensor_low,
    const int sensor_high, const int frame)
{
    const word pixel = (uint)start + FIRST_LANES;
#if PRNU || DSNU
    const Words pattern = philox(pixel, 0u, 0u, FIXED, sensor_low, sensor_high);
    const Normals fixed = exact_normal_pair(pattern.a, pattern.b);
#endif
#if PHOTON_NOISE || READ_NOISE
    const Words words = philox(pixel, 0u, frame, TEMPORAL, seed_low, seed_high);
    const Normals z = exact_normal_pair(words.a, words.b);
#endif
    expected = expected > MOST_EXPECTED ? (real)MOST_EXPECTED : expected;
#if PRNU
    expected = expected * (1.0f + prnu * fixed.first);
#endif
    expected = (expected < 0.0f ? (real)0.0f : expected) + dark_electrons;
#if PHOTON_NOISE
    real electrons = poisson(expected, words, z.first);
#else
    real electrons = expected;
#endif
    electrons = electrons > full_well ? (real)full_well : electrons;
#if READ_NOISE
    electrons = electrons + read_noise * z.second;
#endif
#if DSNU
    electrons = electrons + dsnu * fixed.second;
#endif
    return electrons;
}

__kernel void electrons(
    // in:
    __global const float *restrict mean,  // [pixels]
    // out:
    __global float *restrict out,         // [pixels]
    // sizes and numbers:
    const int pixels, const float dark_electrons, const float read_noise, const float prnu, const float dsnu,
    const float full_well, const int seed_low, const int seed_high, const int sensor_low, const int sensor_high,
    const int frame)
{
    const int start = get_global_id(0) * WIDTH, lanes = min(WIDTH, pixels - start);
    if (lanes <= 0) return;
    const real result = noisy_electrons(load(mean + start, lanes), start, dark_electrons, read_noise, prnu, dsnu,
                                        full_well, seed_low, seed_high, sensor_low, sensor_high, frame);
    for (int lane = 0; lane < lanes; ++lane) out[start + lane] = ((float *)&result)[lane];
}

__kernel void digital_numbers(
    // in:
    __global const float *restrict mean,  // [pixels]
    // out:
    __global ushort *restrict out,        // [pixels]
    // sizes and numbers:
    const int pixels, const float dark_electrons, const float read_noise, const float prnu, const float dsnu,
    const float full_well, const int seed_low, const int seed_high, const int sensor_low, const int sensor_high,
    const int frame, const float gain, const float black_level, const float white_level)
{
    const int start = get_global_id(0) * WIDTH, lanes = min(WIDTH, pixels - start);
    if (lanes <= 0) return;
    const real result = noisy_electrons(load(mean + start, lanes), start, dark_electrons, read_noise, prnu, dsnu,
                                        full_well, seed_low, seed_high, sensor_low, sensor_high, frame);
    real level = gain * result + black_level;
    level = level > 0.0f ? level : (real)0.0f;  // NaN too
    level = rint(level < white_level ? level : (real)white_level);
    for (int lane = 0; lane < lanes; ++lane) out[start + lane] = (ushort)((float *)&level)[lane];
}
