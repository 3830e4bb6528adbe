// The whole of learned.cl in one pass over tiles, for GPUs: codes, sums and classes stay in local memory.
// A work-group makes STRIP columns of ROWS rows, a work-item one column of them. From the host: as for learned.cl, and
// PERIOD_Y, PERIOD_X of the mosaic, ITEMS of a group, RUN, rows whose taps are added at once (a divisor of ROWS).
// ROWS + SPAN - 1 is a multiple of SPAN, TERMS of 16. OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#pragma OPENCL FP_CONTRACT OFF
#include "bayer.clh"
#include "learned.clh"

#ifndef PAIR
#define PAIR(x, y) ((float2)(x, y))
#define QUAD(a, b) ((float4)(a, b))
#define FLOATS(at) ((__local float *)(at))
#endif

#define WIDE (STRIP + 2 * REACH)
#define HIGH (ROWS + 2 * REACH)
#define APART (4 * COMPUTED + 1)  // an odd number: neighbours meet all banks
#define PRODUCT(a, b) fma((a).x, (b).x, fma((a).y, (b).y, fma((a).z, (b).z, (a).w * (b).w)))
#define ROOM (KINDS * SPAN > 20 + APART ? KINDS * SPAN : 20 + APART)
#define SUMS FLOATS(memory)                   // [KINDS][SPAN][ITEMS]: sums down the columns; later:
#define TERM(item, i) memory[(item) * 5 + (i)]  // 16 terms of each pixel; with a fifth float4 neighbours meet all banks,
#define PART(item, i) FLOATS(memory + 5 * ITEMS)[(item) * APART + (i)]  // parts of their outputs

__kernel void learned_tiles(
    // in:
    __global const ushort *restrict raw,     // [rows][cols]
    __global const int *restrict limits,     // bounds, ratios, shares
    __global const float *restrict knots,    // [LEVELS]
    __global const float *restrict weights,  // [LEVELS][UNITS][COMPUTED][TERMS]
    __global const int *restrict planes,     // [positions][COMPUTED + KEPT]: their places, the sample last
    __global const float *restrict factors,  // [PERIOD_Y][PERIOD_X]
    __global const float *restrict loss,     // of roots, see levels.py
    // out:
    __global float *restrict out,            // [COMPUTED + KEPT][rows][cols]
    // params:
    const int least, const float level_scale, const float level_zero, const float shift, const float zero,
    const float offset, const float scale, const float black_level, const int shift_y, const int shift_x,
    // sizes:
    const int rows, const int cols, const int across)
{
    __local float tile[HIGH * WIDE];
    __local float4 memory[ITEMS * ROOM / 4];  // ITEMS is a multiple of 4
    __local ushort units[ROWS * ITEMS];
#if LEVELS > 1
    __local float levels[ROWS * ITEMS];
#endif
    const int item = get_local_id(0);
    const int left = get_group_id(0) % across * STRIP, top = get_group_id(0) / across * ROWS;
    const int position_x = (left + item + shift_x) % PERIOD_X;

    const int y0 = top - REACH, x0 = left - REACH;
    const int is_inside = y0 >= 0 && x0 >= 0 && y0 + HIGH <= rows && x0 + WIDE <= cols;
    for (int i = item; i < HIGH * WIDE; i += 4 * ITEMS) {
        float numbers[4], factor[4];
#pragma unroll
        for (int j = 0; j < 4; ++j) {
            const int at = min(i + j * ITEMS, HIGH * WIDE - 1);
            int y = y0 + at / WIDE, x = x0 + at % WIDE;
            if (!is_inside) {
                y = outside(y, rows, PERIOD_Y);
                x = outside(x, cols, PERIOD_X);
            }
            numbers[j] = (float)raw[y * cols + x];
#if BALANCED
            factor[j] = factors[((y + shift_y) & 1) * 2 + ((x + shift_x) & 1)];  // mirroring keeps the colour
#else
            factor[j] = 1.0f;
#endif
        }
#pragma unroll
        for (int j = 0; j < 4; ++j)
            if (i + j * ITEMS < HIGH * WIDE) tile[i + j * ITEMS] = code(numbers[j], factor[j], shift, zero);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // Sums are exact, in whatever order: whole multiples of 1 / GRAIN or of 1, below 2^24 of them.
    {
        float run[KINDS], history[SPAN][KINDS];
#pragma unroll
        for (int k = 0; k < KINDS; ++k) {
            run[k] = 0.0f;
#pragma unroll
            for (int s = 0; s < SPAN; ++s) history[s][k] = 0.0f;
        }
#if ROOT
#define WHOLE(value) floor(fma(value, STEPS, 0.5f))
#else
#define WHOLE(value) (value)
#endif
        for (int first = 0; first < ROWS + SPAN - 1; first += SPAN) {
            const int from = (first + REACH - BOX) * WIDE + REACH - BOX + min(item, STRIP + SPAN - 2);
#pragma unroll
            for (int s = 0; s < SPAN; ++s) {
                const int at = from + s * WIDE;
                float now[KINDS], sum = 0.0f;
#define F(offset, weight) sum = fma((float)weight, tile[at + (offset) * WIDE], sum);
                DOWN
                now[0] = WHOLE(fabs(sum));
#if SHARES
                sum = 0.0f;
                DOWN_DETAIL
                now[2] = WHOLE(fabs(sum));
#endif
#undef F
#define F(offset, weight) sum = fma((float)weight, tile[at + (offset)], sum);
                sum = 0.0f;
                ALONG
                now[1] = WHOLE(fabs(sum));
#if SHARES
                sum = 0.0f;
                ALONG_DETAIL
                now[3] = WHOLE(fabs(sum));
#endif
#undef F
#if LEVELS > 1
                now[KINDS - 1] = WHOLE(tile[at]);
#endif
#pragma unroll
                for (int k = 0; k < KINDS; ++k) {
                    run[k] += now[k] - history[s][k];
                    history[s][k] = now[k];
                    SUMS[(k * SPAN + s) * ITEMS + item] = run[k];
                }
            }
            barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
            for (int s = 0; s < SPAN; ++s) {
                const int row = first + s - (SPAN - 1);
                if (row < 0 || item >= STRIP) continue;
                int total[KINDS];
#pragma unroll
                for (int k = 0; k < KINDS; ++k) {
                    float sum = 0.0f;
#pragma unroll
                    for (int i = 0; i < SPAN; ++i) sum += SUMS[(k * SPAN + s) * ITEMS + item + i];
                    total[k] = (int)sum;
                }
                const int position = (top + row + shift_y) % PERIOD_Y * PERIOD_X + position_x;
                units[row * ITEMS + item] = position * CLASSES + class_of(total, limits, least);
#if LEVELS > 1
                const float level = (float)total[KINDS - 1] * level_scale - level_zero;
                float place = 0.0f;
#pragma unroll
                for (int i = 1; i < LEVELS; ++i)
                    place += min(max((level - knots[i - 1]) / (knots[i] - knots[i - 1]), 0.0f), 1.0f);
                levels[row * ITEMS + item] = place;
#endif
            }
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }

    const int x = left + item;
    for (int first = 0; first < ROWS; first += RUN) {
        float sums[RUN][TERMS];  // of all rows, whose windows overlap
#pragma unroll
        for (int r = 0; r < RUN; ++r) {
            const int at = (first + r + REACH) * WIDE + REACH + min(item, STRIP - 1);
#pragma unroll
            for (int g = 0; g < TERMS; ++g) sums[r][g] = g == CONSTANT && !UNBIASED ? 1.0f : 0.0f;
#define F(group, dy, dx) sums[r][group] += tile[at + (dy) * WIDE + (dx)];
            TAPS
#undef F
        }
#pragma unroll
        for (int r = 0; r < RUN; ++r) {
            const int row = first + r, y = top + row;
            float found[COMPUTED];
#pragma unroll
            for (int o = 0; o < COMPUTED; ++o) found[o] = 0.0f;
#pragma unroll
            for (int g = 0; g < TERMS; g += 16) {
#pragma unroll
                for (int i = 0; i < 4; ++i)
                    TERM(item, i) = QUAD(PAIR(sums[r][g + 4 * i], sums[r][g + 4 * i + 1]),
                                         PAIR(sums[r][g + 4 * i + 2], sums[r][g + 4 * i + 3]));
                barrier(CLK_LOCAL_MEM_FENCE);
                // Neighbouring work-items read weights of one pixel side by side: each pixel's are elsewhere in the table.
#pragma unroll
                for (int k = 0; k < 4; ++k) {
                    const int pixel = (k * ITEMS + item) / 4, i = item % 4;
                    const int unit = units[row * ITEMS + min(pixel, STRIP - 1)];
                    const float4 term = TERM(pixel, i);
                    __global const float *at = weights + unit * (COMPUTED * TERMS) + g + 4 * i;
#if LEVELS > 1
                    const float place = levels[row * ITEMS + min(pixel, STRIP - 1)];
                    const int below = min((int)place, LEVELS - 2);
                    at += below * (UNITS * COMPUTED * TERMS);
#endif
#pragma unroll
                    for (int o = 0; o < COMPUTED; ++o) {
                        const float4 weight = *(__global const float4 *)(at + o * TERMS);
                        float product = PRODUCT(weight, term);
#if LEVELS > 1
                        const float4 above = *(__global const float4 *)(at + (UNITS * COMPUTED + o) * TERMS);
                        product += (place - below) * (PRODUCT(above, term) - product);
#endif
                        PART(pixel, 4 * o + i) = product;
                    }
                }
                barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
                for (int o = 0; o < COMPUTED; ++o)
                    found[o] += (PART(item, 4 * o) + PART(item, 4 * o + 1)) + (PART(item, 4 * o + 2) + PART(item, 4 * o + 3));
            }
            if (x >= cols || y >= rows || item >= STRIP) continue;
#pragma unroll
            for (int o = 0; o < COMPUTED; ++o) {
#if ROOT
                found[o] += zero;
#if UNBIASED
                __global const float *left = weights + units[row * ITEMS + item] * (COMPUTED * TERMS) + o * TERMS + CONSTANT;
#if LEVELS > 1
                const float place = levels[row * ITEMS + item];
                const int below = min((int)place, LEVELS - 2);
                left += below * (UNITS * COMPUTED * TERMS);
                const float share = *left + (place - below) * (left[UNITS * COMPUTED * TERMS] - *left);
#else
                const float share = *left;
#endif
                found[o] = found[o] * fabs(found[o]) - offset + share * lost(found[o], loss);
#else
                found[o] = found[o] * fabs(found[o]) - offset;
#endif
#endif
                found[o] *= scale;
            }
            const int pixel = y * cols + x, position = (y + shift_y) % PERIOD_Y * PERIOD_X + position_x;
#if KEPT
            const float sample = ((float)raw[pixel] - black_level) * scale;
#else
            const float sample = 0.0f;
#endif
            // values are chosen, not addresses: neighbours, of other positions, write side by side
#pragma unroll
            for (int p = 0; p < COMPUTED + KEPT; ++p) {
                float value = sample;
#pragma unroll
                for (int o = 0; o < COMPUTED; ++o)
                    value = planes[position * (COMPUTED + KEPT) + o] == p ? found[o] : value;
                out[(size_t)p * rows * cols + pixel] = value;
            }
        }
    }
}
