// CPUs' three passes; GPUs have learned_tiles.cl. `encode` writes the codes with REACH pixels of surroundings on every
// side; later passes need not check borders. `classify` finds each pixel's row of the table, `apply` the planes.
// From the host: ROOT; lists of constants, one F(..) each: DOWN, ALONG (offset, weight) of the contrast, DOWN_DETAIL,
// ALONG_DETAIL, TAPS (group, row, column); numbers of things: SPAN (rows and columns of the box), BOUNDS, RATIOS,
// SHARES, LEVELS, TERMS (groups, up to whole vectors), COMPUTED (planes by filters; KEPT is 1 if one more is the sample).
// No contraction: a mirrored mosaic then gives the mirrored picture bit for bit.
#pragma OPENCL FP_CONTRACT OFF
#define LANES 8  // pixels of a vector
#include "bayer.clh"
#include "learned.clh"

#define LOAD(from) vload8(0, from)
#define STORE(value, to) vstore8(value, 0, to)
#define TO_REAL convert_float8
#define TO_WHOLE convert_int8
#define FIRST_LANES ((int8)(0, 1, 2, 3, 4, 5, 6, 7))

// A work-item does a row. BALANCED frames have a period of 2.
__kernel void encode(
    // in:
    __global const ushort *restrict raw,     // [rows][cols]
    __global const float *restrict factors,  // [period_y][period_x]
    // out:
    __global float *restrict codes,          // [rows + 2 REACH][stride]
    // params:
    const float shift, const float zero, const int shift_y, const int shift_x,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int stride)
{
    const int y = get_global_id(1);
    __global const ushort *from = raw + (size_t)outside(y - REACH, rows, period_y) * cols;
    __global float *to = codes + (size_t)y * stride;
#if BALANCED
    __global const float *here = factors + ((y - REACH + shift_y) & 1) * 2;
    const float even = here[shift_x & 1], odd = here[1 - (shift_x & 1)];
#define FACTORS (float8)(even, odd, even, odd, even, odd, even, odd)
#define FACTOR(x) ((x) & 1 ? odd : even)
#else
#define FACTORS 1.0f
#define FACTOR(x) 1.0f
#endif
    for (int x = 0; x + 8 <= cols; x += 8)
        vstore8(code(convert_float8(vload8(0, from + x)), FACTORS, shift, zero), 0, to + x + REACH);
    for (int x = 0; x < stride; ++x) {
        if (x == REACH) x += cols / 8 * 8;
        const float8 number = (float8)from[outside(min(x - REACH, cols + REACH - 1), cols, period_x)];
        to[x] = code(number, (float8)FACTOR(x - REACH), shift, zero).s0;
    }
}

// Sums over the box are taken down the columns first, by lanes that do ROWS rows of their column each, and then along
// the rows. A work-item does a strip, LANES columns at a time.
#if ROOT
#define WHOLE(value) TO_WHOLE(floor((value) * STEPS + 0.5f))
#else
#define WHOLE(value) TO_WHOLE(value)
#endif

// Contrasts and details of one row at one column, or LANES. Their sums are exact: multiples of 1 / GRAIN below 2^12.
inline void features(__global const float *restrict at, const int stride, whole *restrict found)
{
    real sum = 0.0f;
#define F(offset, weight) sum += weight * LOAD(at + (offset) * stride);
    DOWN
    found[0] = WHOLE(fabs(sum));
#if SHARES
    sum = 0.0f;
    DOWN_DETAIL
    found[2] = WHOLE(fabs(sum));
#endif
#undef F
#define F(offset, weight) sum += weight * LOAD(at + (offset));
    sum = 0.0f;
    ALONG
    found[1] = WHOLE(fabs(sum));
#if SHARES
    sum = 0.0f;
    ALONG_DETAIL
    found[3] = WHOLE(fabs(sum));
#endif
#undef F
#if LEVELS > 1
    found[KINDS - 1] = WHOLE(LOAD(at));
#endif
}

__kernel void classify(
    // in:
    __global const float *restrict codes,   // [rows + 2 REACH][stride]
    __global const int *restrict limits,    // bounds, ratios, shares
    __global const float *restrict knots,   // [LEVELS]
    // out:
    __global ushort *restrict units,        // [rows][cols]: position K + class
    __global float *restrict levels,        // [rows][cols] if LEVELS > 1: number of the level below, plus the part
    // params:
    const int least, const float level_scale, const float level_zero, const int shift_y, const int shift_x,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int stride)
{
    int sums[KINDS][ROWS][STRIP + SPAN - 1 + 2 * LANES];
    const int left = get_group_id(0) * STRIP, top = get_group_id(1) * ROWS;
    for (int u = 0; u < STRIP + SPAN - 1; u += LANES) {
        // values beyond the frame's surroundings are not used: anything may be read there
        __global const float *at = codes + (size_t)(top + REACH - BOX) * stride
                                   + min(left + REACH - BOX + u, cols + REACH + BOX - 1);
        whole run[KINDS], history[SPAN][KINDS];
#pragma unroll
        for (int k = 0; k < KINDS; ++k) run[k] = 0;
        for (int r = 0; r < ROWS + SPAN - 1; ++r) {
            whole now[KINDS];
            features(at + (size_t)min(r, rows - 1 - top + SPAN - 1) * stride, stride, now);
#pragma unroll
            for (int k = 0; k < KINDS; ++k) {
                run[k] += now[k];
                if (r >= SPAN) run[k] -= history[r % SPAN][k];
                history[r % SPAN][k] = now[k];
                if (r >= SPAN - 1) STORE(run[k], &sums[k][r - SPAN + 1][u]);
            }
        }
    }
    for (int u = 0; u < STRIP && left + u < cols; u += LANES) {
        const int x = left + u;
        const whole column = (x + shift_x + FIRST_LANES) % period_x;
        for (int r = 0; r < ROWS && top + r < rows; ++r) {
            whole total[KINDS];
            const int y = top + r;
#pragma unroll
            for (int k = 0; k < KINDS; ++k) {
                total[k] = 0;
#pragma unroll
                for (int i = 0; i < SPAN; ++i) total[k] += LOAD(&sums[k][r][u + i]);
            }
            const whole position = (y + shift_y) % period_y * period_x + column;
            const whole unit = position * CLASSES + class_of(total, limits, least);
            const size_t to = (size_t)y * cols + x;
#if LEVELS > 1
            const real level = TO_REAL(total[KINDS - 1]) * level_scale - level_zero;
            real at = 0.0f;
#pragma unroll
            for (int i = 1; i < LEVELS; ++i)
                at += clamp((level - knots[i - 1]) / (knots[i] - knots[i - 1]), 0.0f, 1.0f);
#endif
            if (x + 8 > cols) {
                for (int lane = 0; lane < cols - x; ++lane) {
                    units[to + lane] = ((int *)&unit)[lane];
#if LEVELS > 1
                    levels[to + lane] = ((float *)&at)[lane];
#endif
                }
                continue;
            }
            vstore8(convert_ushort8(unit), 0, units + to);
#if LEVELS > 1
            STORE(at, levels + to);
#endif
        }
    }
}

// Rows of a square of 8 x 8 into its columns, by three perfect shuffles.
inline void transpose(float8 *square)
{
#pragma unroll
    for (int round = 0; round < 3; ++round) {
        float8 next[8];
#pragma unroll
        for (int i = 0; i < 4; ++i) {
            const float8 a = square[i], b = square[i + 4];
            next[2 * i].even = a.lo;
            next[2 * i].odd = b.lo;
            next[2 * i + 1].even = a.hi;
            next[2 * i + 1].odd = b.hi;
        }
#pragma unroll
        for (int i = 0; i < 8; ++i) square[i] = next[i];
    }
}

// Result of filter o for each of 8 pixels; sums: pixel i has i, i + 8, ..; rows: starts of their weights.
inline float8 outputs(__global const float *restrict weights, const size_t *rows, const int o, const float8 *sums)
{
    float8 parts[8];
#pragma unroll
    for (int i = 0; i < 8; ++i) {
        __global const float *row = weights + rows[i] + o * TERMS;
        parts[i] = 0.0f;
#pragma unroll
        for (int g = 0; g < TERMS; g += 8) parts[i] += vload8(0, row + g) * sums[g + i];
    }
    transpose(parts);
    return ((parts[0] + parts[1]) + (parts[2] + parts[3])) + ((parts[4] + parts[5]) + (parts[6] + parts[7]));
}

__kernel void apply(
    // in:
    __global const ushort *restrict raw,     // [rows][cols]
    __global const float *restrict codes,    // [rows + 2 REACH][stride]
    __global const ushort *restrict units,   // [rows][cols]
    __global const float *restrict levels,   // [rows][cols]
    __global const float *restrict weights,  // [LEVELS][UNITS][COMPUTED][TERMS]
    __global const int *restrict planes,     // [positions][COMPUTED + KEPT]: their places, the sample last
    __global const float *restrict loss,     // of roots, see levels.py
    // out:
    __global float *restrict out,            // [COMPUTED + KEPT][rows][cols]
    // params:
    const float zero, const float offset, const float scale, const float black_level,
    // sizes:
    const int rows, const int cols, const int stride)
{
    const size_t pixels = (size_t)rows * cols;
    const int y = get_global_id(1);
    for (int block = 0; block < cols; block += 8) {
        const int x = max(0, min(block, cols - 8)), lanes = min(8, cols);  // the last overlaps the one before it
        real sums[TERMS];
        __global const float *at = codes + (size_t)(y + REACH) * stride + REACH + x;
#pragma unroll
        for (int g = 0; g < TERMS; ++g) sums[g] = g == CONSTANT && !UNBIASED ? 1.0f : 0.0f;
#define F(group, dy, dx) sums[group] += LOAD(at + (dy) * stride + (dx));
        TAPS
#undef F
#pragma unroll
        for (int g = 0; g < TERMS; g += 8) transpose(sums + g);
        const size_t pixel = (size_t)y * cols + x;
        size_t from[LANES];
        int own[LANES];
        real found[COMPUTED + KEPT];
#pragma unroll
        for (int i = 0; i < LANES; ++i) {
            const int unit = units[pixel + min(i, lanes - 1)];
            from[i] = (size_t)unit * COMPUTED * TERMS;
            own[i] = unit / CLASSES * (COMPUTED + KEPT);
        }
#if LEVELS > 1
        real part;
#pragma unroll
        for (int i = 0; i < LANES; ++i) {
            const float level = levels[pixel + min(i, lanes - 1)];
            const int below = min((int)level, LEVELS - 2);
            ((float *)&part)[i] = level - below;
            from[i] += (size_t)below * UNITS * COMPUTED * TERMS;
        }
#endif
#pragma unroll
        for (int o = 0; o < COMPUTED; ++o) {
            real code = outputs(weights, from, o, sums);
#if LEVELS > 1
            code = (1.0f - part) * code
                   + part * outputs(weights + (size_t)UNITS * COMPUTED * TERMS, from, o, sums);
#endif
#if ROOT
            code += zero;
#if UNBIASED
            real share;
#pragma unroll
            for (int i = 0; i < LANES; ++i) {
                __global const float *left = weights + from[i] + o * TERMS + CONSTANT;
#if LEVELS > 1
                ((float *)&share)[i] = *left + ((float *)&part)[i] * (left[UNITS * COMPUTED * TERMS] - *left);
#else
                ((float *)&share)[i] = *left;
#endif
            }
            code = code * fabs(code) - offset + share * lost(code, loss);
#else
            code = code * fabs(code) - offset;
#endif
#endif
            found[o] = code * scale;
        }
#if KEPT
        float8 numbers;
        for (int i = 0; i < lanes; ++i) ((float *)&numbers)[i] = raw[pixel + i];
        found[COMPUTED] = (numbers - black_level) * scale;
        float turned[COMPUTED + 1][8];
#pragma unroll
        for (int o = 0; o <= COMPUTED; ++o)
#pragma unroll
            for (int i = 0; i < 8; ++i) turned[planes[own[i] + o]][i] = ((float *)&found[o])[i];
#pragma unroll
        for (int o = 0; o <= COMPUTED; ++o) found[o] = vload8(0, turned[o]);
#endif
#pragma unroll
        for (int o = 0; o < COMPUTED + KEPT; ++o) {
            __global float *to = out + o * pixels + pixel;
            if (lanes == 8) vstore8(found[o], 0, to);
            else for (int i = 0; i < lanes; ++i) to[i] = ((float *)&found[o])[i];
        }
    }
}
