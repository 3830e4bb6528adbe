// Statistics of light, for GPUs: work-groups of ITEMS, a power of two, add and count in local memory.
// From the host: ITEMS, and of `parts` STRIP, of `tally` LISTS, histograms that are counted at a time, and SHARE, pixels of
// a group. OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#pragma OPENCL FP_CONTRACT OFF
#include "meter.clh"

#define COPIES (LISTS == 1 ? 4 : LISTS == 2 ? 2 : 1)  // of a histogram: work-items that count in the same bin wait less
#define EACH (BINS / ITEMS)

// Brings values[FIELDS][ITEMS] to values[FIELDS][0], in a fixed order.
#define REDUCE                                                                                             \
    for (int reach = ITEMS / 2; reach; reach /= 2) {                                                       \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                      \
        if (item < reach) {                                                                                \
            values[item] = max(values[item], values[item + reach]);                                        \
            values[ITEMS + item] = min(values[ITEMS + item], values[ITEMS + item + reach]);                \
            for (int k = 2; k < FIELDS; ++k) values[k * ITEMS + item] += values[k * ITEMS + item + reach]; \
        }                                                                                                  \
    }                                                                                                      \
    barrier(CLK_LOCAL_MEM_FENCE);

__kernel void parts(
    // in:
    __global const float *restrict rates,      // [rows][cols]
    __global const float *restrict weights_y,  // [rows]
    __global const float *restrict weights_x,  // [cols]
    // out:
    __global float *restrict sums,             // [FIELDS][rows][strips]
    __global int *restrict counts,             // [cleared]: zeros, for later counts
    // sizes:
    const int rows, const int cols, const int strips, const int cleared)
{
    __local float values[FIELDS * ITEMS];
    const int item = get_local_id(0), group = get_group_id(0);
    for (size_t i = (size_t)group * ITEMS + item; i < cleared; i += (size_t)rows * strips * ITEMS) counts[i] = 0;
    const int y = group / strips, strip = group % strips, first = strip * STRIP + item;
    __global const float *restrict row = rates + (size_t)y * cols;
    float high = -MOST_FINITE, low = MOST_FINITE;
    float total = 0.0f, weighted = 0.0f, large = 0.0f, middle = 0.0f, small = 0.0f, left_out = 0.0f;
    float found[STRIP / ITEMS], weights[STRIP / ITEMS];
#pragma unroll
    for (int k = 0; k < STRIP / ITEMS; ++k) {  // all at once, to wait once
        const int x = min(first + k * ITEMS, cols - 1);
        found[k] = row[x];
        weights[k] = weights_x[x];
    }
#pragma unroll
    for (int k = 0; k < STRIP / ITEMS; ++k) {
        const int is_inside = first + k * ITEMS < cols, is_finite = (AS_BITS(found[k]) & EXPONENT) != EXPONENT;
        const float value = is_inside && is_finite ? found[k] : 0.0f, size = fabs(value);
        const int is_large = size >= LARGE, is_small = size < SMALL;
        const float scaled = value * (is_large ? DOWN : is_small ? UP : 1.0f), square = scaled * scaled;
        high = is_inside && is_finite ? max(high, value) : high;
        low = is_inside && is_finite ? min(low, value) : low;
        total += value;
        weighted += value * weights[k];
        large += is_large ? square : 0.0f;
        middle += is_large || is_small ? 0.0f : square;
        small += is_small ? square : 0.0f;
        left_out += is_inside && !is_finite ? 1.0f : 0.0f;
    }
    values[item] = high;
    values[ITEMS + item] = low;
    values[2 * ITEMS + item] = total;
    values[3 * ITEMS + item] = weighted;
    values[4 * ITEMS + item] = large;
    values[5 * ITEMS + item] = middle;
    values[6 * ITEMS + item] = small;
    values[7 * ITEMS + item] = left_out;
    REDUCE
    if (item < FIELDS) sums[item * rows * strips + group] = values[item * ITEMS] * (item == 3 ? weights_y[y] : 1.0f);
}

__kernel void finish(
    // in:
    __global const float *restrict sums,  // [FIELDS][count]
    // out:
    __global float *restrict out,         // the first 6
    // sizes:
    const int count, const int size)
{
    __local float values[FIELDS * ITEMS];
    const int item = get_local_id(0);
    float high = -MOST_FINITE, low = MOST_FINITE, total[FIELDS - 2], rest[FIELDS - 2];
#pragma unroll
    for (int k = 0; k < FIELDS - 2; ++k) total[k] = rest[k] = 0.0f;
    for (int i = item; i < count; i += ITEMS) {
        high = max(high, sums[i]);
        low = min(low, sums[count + i]);
#pragma unroll
        for (int k = 0; k < FIELDS - 2; ++k) ADD_EXACTLY(total[k], rest[k], sums[(k + 2) * count + i])
    }
    values[item] = high;
    values[ITEMS + item] = low;
#pragma unroll
    for (int k = 0; k < FIELDS - 2; ++k) values[(k + 2) * ITEMS + item] = total[k] + rest[k];
    REDUCE
    if (item) return;
    const float left_out = values[7 * ITEMS], finite = (float)(size - (int)left_out);
    const int is_any = finite > 0.0f;
    out[0] = is_any ? values[0] : 0.0f;
    out[1] = is_any ? values[2 * ITEMS] / finite : 0.0f;
    out[2] = is_any ? root_mean_square(values[4 * ITEMS], values[5 * ITEMS], values[6 * ITEMS], finite) : 0.0f;
    out[3] = values[3 * ITEMS];
    out[4] = left_out;
    out[5] = is_any ? values[ITEMS] : 0.0f;
}

#ifdef LISTS
__kernel void tally(
    // in:
    __global const float *restrict rates,  // [size]
    __global const int *restrict state,    // [fractions][3]: prefix, rank among keys with it, finite values
    // out:
    __global int *restrict counts,         // [LISTS][BINS] from `start` on; from `above` on [fractions]: ~ the lowest key
                                           // beyond the prefix, 0 for none
    // sizes:
    const int size, const int start, const int above, const int shift, const int bits)
{
    __local int bins[LISTS * COPIES * BINS];
    const int item = get_local_id(0), group = get_group_id(0);
    for (int i = item; i < LISTS * COPIES * BINS; i += ITEMS) bins[i] = 0;
    WORD prefix[LISTS], best[LISTS];
#pragma unroll
    for (int list = 0; list < LISTS; ++list) {
        prefix[list] = shift == FIRST_SHIFT ? 0 : state[3 * list];
        best[list] = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < SHARE; k += 4 * ITEMS) {
        const int at = group * SHARE + k + 4 * item;
        if (at >= size) break;
        WORD keys[4] = {NONE, NONE, NONE, NONE};
        if (at + 4 <= size) {
            const float4 four = QUADS(rates)[at / 4];
            keys[0] = key_of(four.x);
            keys[1] = key_of(four.y);
            keys[2] = key_of(four.z);
            keys[3] = key_of(four.w);
        } else {
#pragma unroll
            for (int j = 0; j < 3; ++j)
                if (at + j < size) keys[j] = key_of(rates[at + j]);
        }
#pragma unroll
        for (int list = 0; list < LISTS; ++list) {
            int held = 0, number = 0;  // neighbours are often equal: one addition for all
#pragma unroll
            for (int j = 0; j < 4; ++j) {
                const WORD high = keys[j] >> shift;
                if (high >> bits == prefix[list]) {
                    const int bin = high & ((1u << bits) - 1);
                    if (number && bin != held) {
                        ADD_LOCAL(&bins[(list * BINS + held) * COPIES + item % COPIES], number);
                        number = 0;
                    }
                    held = bin;
                    ++number;
                } else if (high >> bits > prefix[list]) {
                    best[list] = max(best[list], ~keys[j]);
                }
            }
            if (number) ADD_LOCAL(&bins[(list * BINS + held) * COPIES + item % COPIES], number);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = item; i < LISTS * BINS; i += ITEMS) {
        int sum = 0;
        for (int copy = 0; copy < COPIES; ++copy) sum += bins[i * COPIES + copy];
        if (sum) ADD(&counts[start + i], sum);
    }
    if (shift != 0) return;
    // The lowest keys beyond take the place of the counts: these fill the 32 KiB that some GPUs have.
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < LISTS) bins[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
    for (int list = 0; list < LISTS; ++list)
        if (best[list]) MOST_LOCAL((LOCAL_WORD *)&bins[list], best[list]);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < LISTS && bins[item]) MOST(&counts[above + item], (WORD)bins[item]);
}
#endif

__kernel void choose(
    // in:
    __global const int *restrict counts,     // as in `tally`
    __global const int *restrict fractions,  // [fractions][3]: times 2^32, the rest times 2^64, times 2^96
    // out:
    __global int *restrict state,
    __global float *restrict out,            // from 6 on
    // sizes:
    const int start, const int above, const int lists, const int shift, const int bits)
{
    __local int sums[ITEMS];
    __local int found[4];  // bin, rank in it, its count, next bin that has any
    const int item = get_local_id(0), f = get_group_id(0), list = lists == 1 ? 0 : f;
    __global const int *restrict from = counts + start + list * BINS;
    int own = 0;
#pragma unroll
    for (int k = 0; k < EACH; ++k) own += from[item * EACH + k];
    sums[item] = own;
    if (item < 4) found[item] = item < 3 ? 0 : BINS;
    int until = own;
    for (int step = 1; step < ITEMS; step *= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        const int before = item < step ? 0 : sums[item - step];
        barrier(CLK_LOCAL_MEM_FENCE);
        until += before;
        sums[item] = until;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    WORD prefix = 0;
    int rank = 0, finite = sums[ITEMS - 1] - from[BINS - 1];  // the last bin counts values that are not finite
    if (shift != FIRST_SHIFT) {
        prefix = state[3 * f];
        rank = state[3 * f + 1];
        finite = state[3 * f + 2];
    } else if (finite) {
        rank = rank_of(fractions[3 * f], fractions[3 * f + 1], fractions[3 * f + 2], finite - 1);
    }
    if (rank >= until - own && rank < until) {
        int left = rank - (until - own), bin = item * EACH;
        while (left >= from[bin]) left -= from[bin++];
        found[0] = bin;
        found[1] = left;
        found[2] = from[bin];
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);  // all have read the state
    for (int bin = item * EACH; bin < (item + 1) * EACH; ++bin)
        if (bin > found[0] && from[bin]) {
            LEAST_LOCAL(&found[3], bin);
            break;
        }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item) return;
    prefix = prefix << bits | found[0];
    state[3 * f] = prefix;
    state[3 * f + 1] = found[1];
    state[3 * f + 2] = finite;
    if (shift) return;
    const WORD beyond = counts[above + f];
    WORD next = prefix;
    if (found[1] + 1 >= found[2])
        next = found[3] < BINS ? prefix + found[3] - found[0] : beyond ? ~beyond : prefix;
    out[6 + 2 * f] = finite ? value_of(prefix) : 0.0f;
    out[7 + 2 * f] = finite ? value_of(next) : 0.0f;
}
