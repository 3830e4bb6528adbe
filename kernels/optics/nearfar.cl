// One level of a pyramid of separable kernels, the way down to the next level and the way back.

#include "border.clh"

#ifdef FACTOR
float block(__global const float *plane, const int y, const int x, const int border, const int rows, const int cols)
{
    float sum = 0.0f;
    for (int i = y; i < y + FACTOR; ++i)
        for (int j = x; j < x + FACTOR; ++j)
            if (border != 0 || (i >= 0 && i < rows && j >= 0 && j < cols))
                sum += plane[(size_t)inside(i, rows, border) * cols + inside(j, cols, border)];
    return sum;
}

// Sums of blocks of FACTOR x FACTOR pixels; the frame's corner is at `margin` in the image, at `before` in the source.
// A work-item is a pixel on GPUs, a row on CPUs, inside of the frame eight pairs of pixels at a time.
__kernel void shrink(
    // in:
    __global const float *restrict source,  // [count][rows][cols]
    // out:
    __global float *restrict image,         // [count][low_rows][low_cols]
    // params:
    const int border, const int before, const int margin,
    // sizes:
    const int count, const int rows, const int cols, const int low_rows, const int low_cols)
{
#ifdef GPU
    const int y = get_global_id(1), k = get_global_id(2), first = get_global_id(0), last = first + 1;
    GUARD(first >= low_cols || y >= low_rows || k >= count)
#else
    const int y = get_global_id(0), k = get_global_id(1), first = 0, last = low_cols;
#endif
    const int v = FACTOR * (y - margin) + before;
    __global const float *plane = source + (size_t)k * rows * cols;
    __global float *target = image + ((size_t)k * low_rows + y) * low_cols;
    for (int x = first; x < last; ++x) {
#if !defined(GPU) && FACTOR == 2
        for (; x + 8 <= last; x += 8) {
            const int u = 2 * (x - margin) + before;
            if ((border == 0 && (v < 0 || v + 1 >= rows)) || u < 0 || u + 16 > cols) break;
            __global const float *line = plane + (size_t)inside(v, rows, border) * cols + u;
            __global const float *next = plane + (size_t)inside(v + 1, rows, border) * cols + u;
            const float8 left = vload8(0, line) + vload8(0, next), right = vload8(1, line) + vload8(1, next);
            vstore8((float8)(left.even + left.odd, right.even + right.odd), 0, target + x);
        }
        if (x >= last) break;
#endif
        target[x] = block(plane, v, FACTOR * (x - margin) + before, border, rows, cols);
    }
}

// Adds the next level's result, linear between the centres of its pixels; `margin` and `low_margin` are what the
// results have around the frame.
__kernel void enlarge(
    // in:
    __global const float *restrict low,  // [count][low_rows][low_cols]
    // out:
    __global float *restrict out,        // [count][rows][cols]
    // params:
    const int margin, const int low_margin,
    // sizes:
    const int count, const int rows, const int cols, const int low_rows, const int low_cols)
{
#ifdef GPU
    const int y = get_global_id(1), c = get_global_id(2), first = get_global_id(0), last = first + 1;
    GUARD(first >= cols || y >= rows || c >= count)
#else
    const int y = get_global_id(0), c = get_global_id(1), first = 0, last = cols;
#endif
    const float v = (y - margin + 0.5f) / FACTOR - 0.5f, row = floor(v), b = v - row;
    __global const float *above = low + ((size_t)c * low_rows + (int)row + low_margin) * low_cols + low_margin;
    __global const float *below = above + low_cols;
    __global float *target = out + ((size_t)c * rows + y) * cols;
    for (int x = first; x < last; ++x) {
#if !defined(GPU) && FACTOR == 2
        if ((x - margin) % 2 == 0)
            for (; x + 16 <= last; x += 16) {  // the two pixels of a block take 1 / 4 of the neighbour on their side
                const int at = (x - margin) / 2;
                const float8 here = (1 - b) * vload8(0, above + at) + b * vload8(0, below + at);
                const float8 left = (1 - b) * vload8(0, above + at - 1) + b * vload8(0, below + at - 1);
                const float8 right = (1 - b) * vload8(0, above + at + 1) + b * vload8(0, below + at + 1);
                const float8 e = 0.75f * here + 0.25f * left, o = 0.75f * here + 0.25f * right;
                vstore8(vload8(0, target + x) + (float8)(e.s0, o.s0, e.s1, o.s1, e.s2, o.s2, e.s3, o.s3), 0, target + x);
                vstore8(vload8(1, target + x) + (float8)(e.s4, o.s4, e.s5, o.s5, e.s6, o.s6, e.s7, o.s7), 1, target + x);
            }
        if (x >= last) break;
#endif
        const float u = (x - margin + 0.5f) / FACTOR - 0.5f, col = floor(u), a = u - col;
        const int at = (int)col;
        target[x] += (1 - b) * ((1 - a) * above[at] + a * above[at + 1])
                     + b * ((1 - a) * below[at] + a * below[at + 1]);
    }
}
#endif

#ifdef TAPS
#ifndef GPU
#define JOIN(a, b) a##b
#define LOAD(width, p) JOIN(vload, width)(0, p)
#define STORE(width, value, p) JOIN(vstore, width)(value, 0, p)
#define LINES (TILE + TAPS - 1)

// out_c = sum over k and t of columns[c, k, t] * (rows[c, k, t] * planes_k). CPU: a work-item makes TILE rows of
// BLOCK x WIDTH pixels; every value read goes into all RANK horizontal sums, every line of these into ROWS rows.
__kernel void separable(
    // in:
    __global const float *restrict planes,   // [count][period_y][period_x]
    __global const float *restrict columns,  // [groups][count][RANK][TAPS]
    __global const float *restrict across,   // [groups][count][TAPS][RANK]
    // out:
    __global float *restrict out,            // [groups][rows][cols]
    // params:
    const int skip, const int diagonal,
    // sizes:
    const int groups, const int count, const int rows, const int cols, const int period_y, const int period_x)
{
    const int x = get_global_id(0) * BLOCK * WIDTH, y = get_global_id(1) * TILE, c = get_global_id(2);
    VECTOR lines[RANK][LINES][BLOCK], sums[TILE][BLOCK];
    for (int r = 0; r < TILE; ++r)
        for (int b = 0; b < BLOCK; ++b) sums[r][b] = 0;
    for (int k = diagonal ? c : 0; k < (diagonal ? c + 1 : count); ++k) {
        const size_t pair = diagonal ? c : c * count + k;
        __global const float *source = planes + ((size_t)k * period_y + y + skip) * period_x + x + skip;
        for (int v = 0; v < LINES; v += 2, source += 2 * period_x) {
            VECTOR made[RANK][2][BLOCK];
#pragma unroll
            for (int t = 0; t < RANK; ++t)
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) made[t][0][b] = made[t][1][b] = 0;
            __global const float *factor = across + pair * TAPS * RANK;
            for (int j = 0; j < TAPS; ++j, factor += RANK) {
                VECTOR values[2][BLOCK];
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) {
                    values[0][b] = LOAD(WIDTH, source + j + b * WIDTH);
                    values[1][b] = LOAD(WIDTH, source + period_x + j + b * WIDTH);
                }
#pragma unroll
                for (int t = 0; t < RANK; ++t)
#pragma unroll
                    for (int b = 0; b < BLOCK; ++b) {
                        made[t][0][b] = factor[t] * values[0][b] + made[t][0][b];
                        made[t][1][b] = factor[t] * values[1][b] + made[t][1][b];
                    }
            }
#pragma unroll
            for (int t = 0; t < RANK; ++t)
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) {
                    lines[t][v][b] = made[t][0][b];
                    lines[t][v + 1][b] = made[t][1][b];
                }
        }
        for (int r0 = 0; r0 < TILE; r0 += ROWS) {
            VECTOR part[ROWS][BLOCK];
#pragma unroll
            for (int r = 0; r < ROWS; ++r)
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) part[r][b] = sums[r0 + r][b];
            for (int t = 0; t < RANK; ++t) {
                __global const float *factor = columns + (pair * RANK + t) * TAPS;
#pragma unroll
                for (int v = 0; v < TAPS + ROWS - 1; ++v) {
                    VECTOR values[BLOCK];
#pragma unroll
                    for (int b = 0; b < BLOCK; ++b) values[b] = lines[t][r0 + v][b];
#pragma unroll
                    for (int r = 0; r < ROWS; ++r)
                        if (v - r >= 0 && v - r < TAPS) {
#pragma unroll
                            for (int b = 0; b < BLOCK; ++b) part[r][b] = factor[v - r] * values[b] + part[r][b];
                        }
                }
            }
#pragma unroll
            for (int r = 0; r < ROWS; ++r)
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) sums[r0 + r][b] = part[r][b];
        }
    }
    for (int r = 0; r < TILE; ++r) {
        if (y + r < rows) {
            __global float *target = out + ((size_t)c * rows + y + r) * cols + x;
            for (int b = 0; b < BLOCK; ++b) {
                if (x + (b + 1) * WIDTH <= cols) {
                    STORE(WIDTH, sums[r][b], target + b * WIDTH);
                } else {
                    float last[WIDTH];
                    STORE(WIDTH, sums[r][b], last);
                    for (int i = 0; x + b * WIDTH + i < cols; ++i) target[b * WIDTH + i] = last[i];
                }
            }
        }
    }
}
#else
#define SIDE_Y (GROUP_Y * ROWS + TAPS - 1)
#define SIDE_X (GROUP_X + TAPS - 1)

// The same on a GPU: a group makes GROUP_Y * ROWS x GROUP_X pixels; its part of a plane, and one product's horizontal
// sums at a time, lie in local memory.
__kernel void separable(
    // in:
    __global const float *restrict planes,   // [count][period_y][period_x]
    __global const float *restrict columns,  // [groups][count][RANK][TAPS]
    __global const float *restrict across,   // [groups][count][TAPS][RANK]
    // out:
    __global float *restrict out,            // [groups][rows][cols]
    // params:
    const int skip, const int diagonal,
    // sizes:
    const int groups, const int count, const int rows, const int cols, const int period_y, const int period_x)
{
    __local float values[SIDE_Y][SIDE_X], lines[SIDE_Y][GROUP_X];
    const int tx = get_local_id(0), ty = get_local_id(1), c = get_global_id(2), thread = ty * GROUP_X + tx;
    const int left = get_group_id(0) * GROUP_X, top = get_group_id(1) * GROUP_Y * ROWS;
    float sums[ROWS];
#pragma unroll
    for (int r = 0; r < ROWS; ++r) sums[r] = 0.0f;
    for (int k = diagonal ? c : 0; k < (diagonal ? c + 1 : count); ++k) {
        const size_t pair = diagonal ? c : c * count + k;
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int n = thread; n < SIDE_Y * SIDE_X; n += GROUP_Y * GROUP_X) {
            const int y = n / SIDE_X, x = n % SIDE_X;
            values[y][x] = planes[((size_t)k * period_y + top + skip + y) * period_x + left + skip + x];
        }
        for (int t = 0; t < RANK; ++t) {
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int y = ty; y < SIDE_Y; y += GROUP_Y) {
                float sum = 0.0f;
#pragma unroll
                for (int j = 0; j < TAPS; ++j) sum += across[(pair * TAPS + j) * RANK + t] * values[y][tx + j];
                lines[y][tx] = sum;
            }
            barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
            for (int v = 0; v < TAPS + ROWS - 1; ++v) {
                const float value = lines[ty * ROWS + v][tx];
#pragma unroll
                for (int r = 0; r < ROWS; ++r)
                    if (v - r >= 0 && v - r < TAPS) sums[r] += columns[(pair * RANK + t) * TAPS + v - r] * value;
            }
        }
    }
    const int x = left + tx;
    if (x >= cols) return;
#pragma unroll
    for (int r = 0; r < ROWS; ++r) {
        const int y = top + ty * ROWS + r;
        if (y < rows) out[((size_t)c * rows + y) * cols + x] = sums[r];
    }
}
#endif
#endif
