// Statistics of light, for CPUs: a work-item does a strip of a row, 8 pixels at once, or a chunk of the frame.
// From the host: WIDTH, STRIP and, of `tally`, LISTS, histograms that are counted at a time.
#pragma OPENCL FP_CONTRACT OFF
#include "lanes.clh"
#include "meter.clh"

#define BLOCK 256  // columns with a separate sum, to keep sums short: 32 terms a lane

INLINE real chosen(const integer is, const real value, const real other) { return is ? value : other; }

// A square, in the unit of its size.
INLINE real scaled_square(const real value, const integer is_large, const integer is_small)
{
    const real scaled = value * chosen(is_large, (real)DOWN, chosen(is_small, (real)UP, (real)1.0f));
    return scaled * scaled;
}

__kernel void parts(
    // in:
    __global const float *restrict rates,      // [rows][cols]
    __global const float *restrict weights_y,  // [rows]
    __global const float *restrict weights_x,  // [cols]
    // out:
    __global float *restrict sums,             // [FIELDS][rows][strips]
    // sizes:
    const int rows, const int cols, const int strips)
{
    const int strip = get_global_id(0), y = get_global_id(1);
    const int end = min((strip + 1) * STRIP, cols);
    __global const float *restrict row = rates + (size_t)y * cols;
    real high = -MOST_FINITE, low = MOST_FINITE, total[5] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    integer left_out = 0;
    for (int block = strip * STRIP; block < end; block += BLOCK) {
        real sum[5] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        const int stop = min(block + BLOCK, end);
        for (int x = block; x < stop; x += WIDTH) {
            const int lanes = min(WIDTH, stop - x);
            const real found = load(row + x, lanes), weight = load(weights_x + x, lanes);
            const integer is_inside = TO_INTEGER(FIRST_LANES) < lanes;
            const integer is_finite = is_inside & ((AS_INTEGER(found) & (int)EXPONENT) != (int)EXPONENT);
            left_out -= is_inside & ~is_finite;  // -1 is true
            const real value = AS_REAL(AS_INTEGER(found) & is_finite);
            const real above = chosen(is_finite, value, high), below = chosen(is_finite, value, low);
            high = above > high ? above : high;
            low = below < low ? below : low;
            sum[0] += value;
            sum[1] += value * weight;
            const real size = fabs(value);
            const integer is_large = size >= LARGE, is_small = size < SMALL;
            const real square = scaled_square(value, is_large, is_small);
            sum[2] += AS_REAL(AS_INTEGER(square) & is_large);
            sum[3] += AS_REAL(AS_INTEGER(square) & ~is_large & ~is_small);
            sum[4] += AS_REAL(AS_INTEGER(square) & is_small);
        }
#pragma unroll
        for (int k = 0; k < 5; ++k) total[k] += sum[k];
    }
    float fields[FIELDS] = {-MOST_FINITE, MOST_FINITE, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    for (int lane = 0; lane < WIDTH; ++lane) {
        fields[0] = max(fields[0], ((float *)&high)[lane]);
        fields[1] = min(fields[1], ((float *)&low)[lane]);
        for (int k = 0; k < 5; ++k) fields[2 + k] += ((float *)&total[k])[lane];
        fields[7] += ((int *)&left_out)[lane];
    }
    fields[3] *= weights_y[y];
    for (int k = 0; k < FIELDS; ++k) sums[((size_t)k * rows + y) * strips + strip] = fields[k];
}

__kernel void finish(
    // in:
    __global const float *restrict sums,  // [FIELDS][count]
    // out:
    __global float *restrict out,         // the first 6
    // sizes:
    const int count, const int size)
{
    float high = -MOST_FINITE, low = MOST_FINITE, total[FIELDS - 2] = {0.0f}, rest[FIELDS - 2] = {0.0f};
    for (int i = 0; i < count; ++i) {
        high = max(high, sums[i]);
        low = min(low, sums[count + i]);
        for (int k = 0; k < FIELDS - 2; ++k) ADD_EXACTLY(total[k], rest[k], sums[(size_t)(k + 2) * count + i])
    }
    for (int k = 0; k < FIELDS - 2; ++k) total[k] += rest[k];
    const float finite = (float)(size - (int)total[5]);
    out[0] = finite > 0.0f ? high : 0.0f;
    out[1] = finite > 0.0f ? total[0] / finite : 0.0f;
    out[2] = finite > 0.0f ? root_mean_square(total[2], total[3], total[4], finite) : 0.0f;
    out[3] = total[1];
    out[4] = total[5];
    out[5] = finite > 0.0f ? low : 0.0f;
}

#ifdef LISTS
__kernel void tally(
    // in:
    __global const float *restrict rates,  // [size]
    __global const int *restrict state,    // [fractions][3]: prefix, rank among keys with it, finite values
    // out:
    __global int *restrict counts,         // [chunks][LISTS][2][BINS]: two, for a count in a row waits for the last
    __global int *restrict above,          // [chunks][LISTS]: ~ the lowest key beyond the prefix, 0 for none
    // sizes:
    const int size, const int chunk, const int shift, const int bits)
{
    const int item = get_global_id(0), end = min((item + 1) * chunk, size);
    __global int *restrict own = counts + (size_t)item * LISTS * 2 * BINS;
    for (int i = 0; i < LISTS * 2 * BINS; ++i) own[i] = 0;
    uint prefix[LISTS];
    word best[LISTS];
    for (int list = 0; list < LISTS; ++list) {
        prefix[list] = shift == FIRST_SHIFT ? 0 : state[3 * list];
        best[list] = 0;
    }
    for (int i = item * chunk; i < end; i += WIDTH) {
        const int lanes = min(WIDTH, end - i);
        const word number = AS_WORD(load(rates + i, lanes));
        word key = (number & SIGN) != 0 ? ~number : (number | SIGN);
        const integer is_none = ((number & EXPONENT) == EXPONENT) | (FIRST_LANES >= (uint)lanes);
        key = is_none ? (word)NONE : key;
        const word high = key >> (uint)shift, bin = high & ((1u << bits) - 1), start = high >> (uint)bits;
#pragma unroll
        for (int list = 0; list < LISTS; ++list) {
            const integer is_own = start == prefix[list];
            if (ANY(is_own)) {
                __global int *restrict to = own + list * 2 * BINS;
#pragma unroll
                for (int lane = 0; lane < WIDTH; ++lane)
                    to[lane % 2 * BINS + ((uint *)&bin)[lane]] -= ((int *)&is_own)[lane];
            }
            const word beyond = start > prefix[list] ? ~key : (word)0;
            best[list] = beyond > best[list] ? beyond : best[list];
        }
    }
    for (int list = 0; list < LISTS; ++list) {
        uint found = 0;
        for (int lane = 0; lane < WIDTH; ++lane) found = max(found, ((uint *)&best[list])[lane]);
        above[item * LISTS + list] = found;
    }
}
#endif

__kernel void choose(
    // in:
    __global const int *restrict counts,
    __global const int *restrict above,
    __global const int *restrict fractions,  // [fractions][3]: times 2^32, the rest times 2^64, times 2^96
    // out:
    __global int *restrict state,
    __global int *restrict merged,           // [fractions][BINS]
    __global float *restrict out,            // from 6 on
    // sizes:
    const int chunks, const int lists, const int shift, const int bits)
{
    const int f = get_global_id(0), list = lists == 1 ? 0 : f;
    __global int *restrict all = merged + f * BINS;
    for (int bin = 0; bin < BINS; ++bin) all[bin] = 0;
    uint beyond = 0;
    for (int chunk = 0; chunk < chunks; ++chunk) {
        __global const int *restrict from = counts + ((size_t)chunk * lists + list) * 2 * BINS;
        for (int bin = 0; bin < BINS; ++bin) all[bin] += from[bin] + from[BINS + bin];
        beyond = max(beyond, (uint)above[chunk * lists + list]);
    }
    uint prefix = state[3 * f];
    int rank = state[3 * f + 1], finite = state[3 * f + 2];
    if (shift == FIRST_SHIFT) {
        finite = -all[BINS - 1];  // values that are not finite
        for (int bin = 0; bin < BINS; ++bin) finite += all[bin];
        prefix = 0;
        rank = finite ? rank_of(fractions[3 * f], fractions[3 * f + 1], fractions[3 * f + 2], finite - 1) : 0;
    }
    int bin = 0;
    for (; bin < BINS - 1 && rank >= all[bin]; ++bin) rank -= all[bin];
    prefix = prefix << bits | bin;
    state[3 * f] = prefix;
    state[3 * f + 1] = rank;
    state[3 * f + 2] = finite;
    if (shift) return;
    uint next = prefix;
    if (rank + 1 >= all[bin]) {
        int other = bin + 1;
        while (other < BINS && !all[other]) ++other;
        next = other < BINS ? prefix + other - bin : beyond ? ~beyond : prefix;
    }
    out[6 + 2 * f] = finite ? value_of(prefix) : 0.0f;
    out[7 + 2 * f] = finite ? value_of(next) : 0.0f;
}
