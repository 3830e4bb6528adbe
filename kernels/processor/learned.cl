// Three passes. `encode` writes the codes with what is around the frame, so that nobody asks for borders any more, REACH
// pixels on every side. `classify` finds the row of the table that each pixel takes, `apply` the planes.
// From the host: ROOT; lists of constants, one F(..) each: DOWN, ALONG (offset, weight) of the contrast, DOWN_DETAIL,
// ALONG_DETAIL, TAPS (group, row, column); numbers of things: SPAN (rows and columns of the box), BOUNDS, RATIOS,
// SHARES, LEVELS, TERMS (groups, up to whole vectors), COMPUTED (planes by filters; KEPT is 1 if one more is the sample).
// No contraction: a mirrored mosaic then gives the mirrored picture bit for bit.
#pragma OPENCL FP_CONTRACT OFF
#include "bayer.clh"

#define GRAIN 4096.0f
#define STEPS 256.0f

// The pixel that stands for pixel i: mirrored where that keeps the colour, else a whole number of periods away.
inline int outside(const int i, const int n, const int period)
{
    if (i >= 0 && i < n) return i;
    if (period <= 2) return mirror(i, n);
    return i < 0 ? (i % period + period) % period : n - period + (i - n) % period;
}

#if LANES == 8
typedef int8 whole;
typedef float8 real;
#define LOAD(from) vload8(0, from)
#define STORE(value, to) vstore8(value, 0, to)
#define TO_REAL convert_float8
#define TO_WHOLE convert_int8
#define FIRST_LANES ((int8)(0, 1, 2, 3, 4, 5, 6, 7))
#define COUNT(condition) (-(condition))  // true is -1 in vectors
#else
typedef int whole;
typedef float real;
#define LOAD(from) (*(from))
#define STORE(value, to) (*(to) = (value))
#define TO_REAL (float)
#define TO_WHOLE (int)
#define FIRST_LANES 0
#define COUNT(condition) (condition)
#endif

inline real code(const real number, const float shift, const float zero)
{
#if ROOT
    const real shifted = number + shift;
    return floor((copysign(sqrt(fabs(shifted)), shifted) - zero) * GRAIN + 0.5f) * (1.0f / GRAIN);
#else
    return number;
#endif
}

// A GPU's work-item does a pixel, a CPU's a row.
__kernel void encode(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    // out:
    __global float *restrict codes,       // [rows + 2 REACH][stride]
    // params:
    const float shift, const float zero,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int stride)
{
    const int y = get_global_id(1);
    GUARD(get_global_id(0) >= stride || y >= rows + 2 * REACH)
    __global const ushort *from = raw + (size_t)outside(y - REACH, rows, period_y) * cols;
    __global float *to = codes + (size_t)y * stride;
#if LANES == 8
    for (int x = 0; x + 8 <= cols; x += 8) vstore8(code(convert_float8(vload8(0, from + x)), shift, zero), 0, to + x + REACH);
    for (int x = 0; x < stride; ++x) {
        if (x == REACH) x += cols / 8 * 8;
        to[x] = code((float8)from[outside(min(x - REACH, cols + REACH - 1), cols, period_x)], shift, zero).s0;
    }
#else
    const int x = get_global_id(0);
    to[x] = code(from[outside(min(x - REACH, cols + REACH - 1), cols, period_x)], shift, zero);
#endif
}

// Sums over the box are taken down the columns first, by lanes that do ROWS rows of their column each, and then along
// the rows, through local memory. A GPU's work-item is one lane, a CPU's does a strip, LANES columns at a time.
#if ROOT
#define WHOLE(value) TO_WHOLE(floor((value) * STEPS + 0.5f))
#else
#define WHOLE(value) TO_WHOLE(value)
#endif
#define KINDS (2 + 2 * (SHARES > 0) + (LEVELS > 1))
#define BOX (SPAN / 2)

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
    __local int sums[KINDS][ROWS][STRIP + SPAN - 1 + 2 * LANES];
    const int left = get_group_id(0) * STRIP, top = get_group_id(1) * ROWS;
    for (int u = get_local_id(0) * LANES; u < STRIP + SPAN - 1; u += get_local_size(0) * LANES) {
        // beyond the frame's own surroundings nothing is asked for: anything may be read there
        __global const float *at = codes + (size_t)(top + REACH - BOX) * stride
                                   + min(left + REACH - BOX + u, cols + REACH + BOX - 1);
        whole run[KINDS], history[SPAN][KINDS];
#pragma unroll
        for (int k = 0; k < KINDS; ++k) run[k] = 0;
#if LANES == 1  // so that all indices are known and the history is in registers; CPUs have memory at hand
#pragma unroll
#endif
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
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int u = get_local_id(0) * LANES; u < STRIP && left + u < cols; u += get_local_size(0) * LANES) {
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
            whole direction = RATIOS, kind = 0;
#pragma unroll
            for (int i = 0; i < RATIOS; ++i) {
                const int ratio = limits[BOUNDS + i], more = (ratio - 8) * least;
                direction += COUNT(8 * total[1] > ratio * total[0] + more) - COUNT(8 * total[0] > ratio * total[1] + more);
            }
#pragma unroll
            for (int i = 0; i < BOUNDS; ++i) kind += COUNT(total[0] + total[1] > limits[i]);
#if SHARES
            const whole contrast = min(total[0], total[1]), detail = min(total[2], total[3]);
            kind *= SHARES + 1;
#pragma unroll
            for (int i = 0; i < SHARES; ++i) {
                const int ratio = limits[BOUNDS + RATIOS + i];
                kind += COUNT(8 * contrast > ratio * detail + (ratio - 8) * least);
            }
#endif
            const whole position = (y + shift_y) % period_y * period_x + column;
            const whole unit = (position * (2 * RATIOS + 1) + direction) * ((BOUNDS + 1) * (SHARES + 1)) + kind;
            const size_t to = (size_t)y * cols + x;
#if LEVELS > 1
            const real level = TO_REAL(total[KINDS - 1]) * level_scale - level_zero;
            real at = 0.0f;
#pragma unroll
            for (int i = 1; i < LEVELS; ++i)
                at += clamp((level - knots[i - 1]) / (knots[i] - knots[i - 1]), 0.0f, 1.0f);
#endif
#if LANES == 8
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
#else
            units[to] = unit;
#endif
#if LEVELS > 1
            STORE(at, levels + to);
#endif
        }
    }
}

#if LANES == 8
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

// What filter o of each of 8 pixels gives; sums: those of pixel i are i, i + 8, ..; rows: where their weights begin.
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
#else
inline float outputs(__global const float *restrict weights, const size_t *rows, const int o, const float *sums)
{
    float result = 0.0f;
    __global const float *row = weights + *rows + o * TERMS;
#pragma unroll
    for (int g = 0; g < TERMS; g += 4) {
        const float4 weight = vload4(0, row + g);
        result += (weight.x * sums[g] + weight.y * sums[g + 1]) + (weight.z * sums[g + 2] + weight.w * sums[g + 3]);
    }
    return result;
}
#endif

__kernel void apply(
    // in:
    __global const ushort *restrict raw,     // [rows][cols]
    __global const float *restrict codes,    // [rows + 2 REACH][stride]
    __global const ushort *restrict units,   // [rows][cols]
    __global const float *restrict levels,   // [rows][cols]
    __global const float *restrict weights,  // [LEVELS][UNITS][COMPUTED][TERMS]
    __global const int *restrict planes,     // [positions][COMPUTED + KEPT]: where they go, the sample last
    // out:
    __global float *restrict out,            // [COMPUTED + KEPT][rows][cols]
    // params:
    const float zero, const float offset, const float scale, const float black_level,
    // sizes:
    const int rows, const int cols, const int stride)
{
    const size_t pixels = (size_t)rows * cols;
    const int top = get_global_id(1) * RUN, end = min(top + RUN, rows);
#if LANES == 8
    for (int y = top; y < end; ++y) for (int block = 0; block < cols; block += 8) {
        const int x = max(0, min(block, cols - 8)), lanes = min(8, cols);  // the last overlaps the one before it
        real sums[TERMS];
#else
    const int x = get_global_id(0), lanes = 1;
    GUARD(x >= cols || top >= rows)
    real run[RUN][TERMS];  // of all rows, whose windows overlap, before anything is stored
#pragma unroll
    for (int y = top; y < top + RUN; ++y) {
        real *sums = run[y - top];
#endif
        __global const float *at = codes + (size_t)(min(y, rows - 1) + REACH) * stride + REACH + x;
#pragma unroll
        for (int g = 0; g < TERMS; ++g) sums[g] = g == CONSTANT ? 1.0f : 0.0f;
#define F(group, dy, dx) sums[group] += LOAD(at + (dy) * stride + (dx));
        TAPS
#undef F
#if LANES == 8
#pragma unroll
        for (int g = 0; g < TERMS; g += 8) transpose(sums + g);
#else
    }
#pragma unroll
    for (int y = top; y < top + RUN; ++y) {
        if (y >= rows) continue;
        const real *sums = run[y - top];
#endif
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
            code = code * fabs(code) - offset;
#endif
            found[o] = code * scale;
        }
#if KEPT
#if LANES == 8
        float8 numbers;
        for (int i = 0; i < lanes; ++i) ((float *)&numbers)[i] = raw[pixel + i];
#else
        const float numbers = raw[pixel];
#endif
        found[COMPUTED] = (numbers - black_level) * scale;
#endif
#if LANES == 8 && KEPT
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
#if LANES == 8
            __global float *to = out + o * pixels + pixel;
            if (lanes == 8) vstore8(found[o], 0, to);
            else for (int i = 0; i < lanes; ++i) to[i] = ((float *)&found[o])[i];
#else
            out[planes[*own + o] * pixels + pixel] = found[o];
#endif
        }
    }
}
