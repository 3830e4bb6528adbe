// For CPUs; multiscale.py has the formulas, multiscale_groups.cl is for GPUs. Each level is a plane per axis with a margin:
// 3 rows above and below, LEFT columns before, some after; row and column 0 of the picture are (3, LEFT) there.
// A work-item of `shrink` goes down BAND rows of CHUNK columns.
#include "multiscale.clh"

#define LEFT 8
#define TOP 3

__kernel void split(
    // in:
    __global const float *restrict planes,  // [CHANNELS][rows][cols]
    __global const float *restrict gains,   // [ny][nx]
    __global const float *restrict axes,    // [CHANNELS][CHANNELS]
    // out:
    __global float *restrict values,        // [CHANNELS][rows + 2 TOP][stride]
    // params:
    const float offset,
    // sizes:
    const int rows, const int cols, const int stride, const int ny, const int nx)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= stride || y >= rows + 2 * TOP)
    const long pixels = (long)rows * cols, level = (long)(rows + 2 * TOP) * stride;
    const int v = mirror_index(y - TOP, rows), u = mirror_index(x - LEFT, cols);
    const long from = (long)v * cols + u, to = (long)y * stride + x;
    const float gain = gain_at(gains, v, u, rows, cols, ny, nx);
    float root[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) root[c] = signed_root(planes[c * pixels + from] / gain + offset);
#pragma unroll
    for (int a = 0; a < CHANNELS; ++a) {
        float sum = 0.0f;
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) sum += axes[a * CHANNELS + c] * root[c];
        values[a * level + to] = sum;
    }
}

__kernel void halve(
    // in:
    __global const float *restrict values,  // [..][rows + 2 TOP][stride]
    // out:
    __global float *restrict means,         // [..][high + 2 TOP][wide], of 2 x 2 pixels
    // sizes:
    const int rows, const int cols, const int stride, const int high, const int across, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1), axis = get_global_id(2);
    GUARD(x >= wide || y >= high + 2 * TOP)
    const int v = 2 * mirror_index(y - TOP, high), u = 2 * mirror_index(x - LEFT, across);
    const int right = min(u + 1, cols - 1) - u, down = (min(v + 1, rows - 1) - v) * stride;
    __global const float *at = values + ((long)axis * (rows + 2 * TOP) + v + TOP) * stride + u + LEFT;
    means[((long)axis * (high + 2 * TOP) + y) * wide + x] =
        0.25f * ((at[0] + at[right]) + (at[down] + at[down + right]));
}

typedef float8 real;
#define COUNT (CHUNK / 8 + 1)  // vectors of columns in which blocks begin: 8 before the chunk, of which 3 count, and its own

// The part of a coefficient that is taken for noise: all up to the threshold t, nothing from sqrt(3) t on.
inline real noise_part(const real coefficient, const float scale)
{
    return coefficient * clamp(CEILING - coefficient * coefficient * scale, 0.0f, 1.0f);
}

__kernel void shrink(
    // in:
    __global const float *restrict values,  // [..][rows + 2 TOP][stride]
    __global const float *restrict scales,  // [..][4 down][4 along], 1 / (2 t^2)
    // out:
    __global float *restrict noise,         // [..][rows][wide]
    // sizes:
    const int rows, const int cols, const int stride, const int wide)
{
    const int x0 = get_global_id(0) * CHUNK, y0 = get_global_id(1) * BAND, axis = get_global_id(2);
    __global const float *from = values + ((long)axis * (rows + 2 * TOP) + y0) * stride + x0;
    __global const float *scale = scales + 16 * axis;
    real along[4][4][COUNT];    // rows of Walsh coefficients along each of four rows
    real removed[4][4][COUNT];  // the same of what blocks remove from four rows
    for (int r = 0; r < 4; ++r)
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < COUNT; ++i) removed[r][k][i] = 0.0f;
    const int last = min(BAND, rows - y0) + TOP;  // blocks begin in `last` rows, from three rows above on
    for (int y = -3; y < last; ++y) {
        const int fresh = (y + 3) & 3;
        __global const float *row = from + (long)(y + 3) * stride;
        for (int i = 0; i < COUNT; ++i) {
            const real a = vload8(0, row + 8 * i), b = vload8(0, row + 8 * i + 1), c = vload8(0, row + 8 * i + 2),
                       d = vload8(0, row + 8 * i + 3);
            const real left = a + b, right = c + d, fall = a - b, rise = c - d;
            along[fresh][0][i] = left + right;
            along[fresh][1][i] = left - right;
            along[fresh][2][i] = fall - rise;
            along[fresh][3][i] = fall + rise;
        }
        if (y < 0) continue;
        const int r0 = y & 3, r1 = (y + 1) & 3, r2 = (y + 2) & 3, r3 = fresh;
        for (int k = 0; k < 4; ++k) {
            const float s0 = scale[k], s1 = scale[4 + k], s2 = scale[8 + k], s3 = scale[12 + k];
            for (int i = 0; i < COUNT; ++i) {
                const real a = along[r0][k][i], b = along[r1][k][i], c = along[r2][k][i], d = along[r3][k][i];
                const real up = a + b, low = c + d, fall = a - b, rise = c - d;
                const real mean = k ? noise_part(up + low, s0) : (real)0.0f;
                const real half_part = noise_part(up - low, s1), bump = noise_part(fall - rise, s2),
                           zigzag = noise_part(fall + rise, s3);
                const real same = mean + half_part, other = mean - half_part, one = bump + zigzag, two = bump - zigzag;
                removed[r0][k][i] += same + one;
                removed[r1][k][i] += same - one;
                removed[r2][k][i] += other - two;
                removed[r3][k][i] += other + two;
            }
        }
        float sums[CHUNK + 24];
        for (int i = 0; i < COUNT + 2; ++i) vstore8((real)0.0f, i, sums);
        for (int i = 0; i < COUNT; ++i) {
            const real a = removed[r0][0][i], b = removed[r0][1][i], c = removed[r0][2][i], d = removed[r0][3][i];
            for (int k = 0; k < 4; ++k) removed[r0][k][i] = 0.0f;
            const real same = a + b, other = a - b, one = c + d, two = c - d;
            vstore8(vload8(i, sums) + (same + one), i, sums);
            vstore8(vload8(0, sums + 8 * i + 1) + (same - one), 0, sums + 8 * i + 1);
            vstore8(vload8(0, sums + 8 * i + 2) + (other - two), 0, sums + 8 * i + 2);
            vstore8(vload8(0, sums + 8 * i + 3) + (other + two), 0, sums + 8 * i + 3);
        }
        if (y < 3) continue;
        __global float *to = noise + ((long)axis * rows + y0 + y - 3) * wide + x0;
        for (int i = 0; i < CHUNK / 8; ++i) vstore8(vload8(i + 1, sums) * (1.0f / 256.0f), i, to);
    }
}

__kernel void compare(
    // in:
    __global const float *restrict noise,   // [..][rows][stride]
    // inout:
    __global float *restrict coarse,        // [..][high][wide], of half the resolution: minus the means of `noise`
    // sizes:
    const int rows, const int cols, const int stride, const int high, const int across, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1), axis = get_global_id(2);
    GUARD(x >= across || y >= high)
    const int right = min(2 * x + 1, cols - 1) - 2 * x, down = (min(2 * y + 1, rows - 1) - 2 * y) * stride;
    __global const float *at = noise + ((long)axis * rows + 2 * y) * stride + 2 * x;
    coarse[((long)axis * high + y) * wide + x] -= 0.25f * ((at[0] + at[right]) + (at[down] + at[down + right]));
}

// Bilinear interpolation from half the resolution at pixel (y, x).
inline float interpolate(__global const float *restrict coarse, const int y, const int x, const int high, const int across,
                     const int wide)
{
    const int v = y / 2, u = x / 2;
    const int next = clamp(u - 1 + 2 * (x & 1), 0, across - 1);
    __global const float *near = coarse + (long)v * wide, *far = coarse + (long)clamp(v - 1 + 2 * (y & 1), 0, high - 1) * wide;
    return 0.75f * (0.75f * near[u] + 0.25f * near[next]) + 0.25f * (0.75f * far[u] + 0.25f * far[next]);
}

__kernel void merge(
    // in:
    __global const float *restrict coarse,  // [..][high][wide]
    // inout:
    __global float *restrict noise,         // [..][rows][stride]
    // sizes:
    const int rows, const int cols, const int stride, const int high, const int across, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1), axis = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    noise[((long)axis * rows + y) * stride + x] +=
        interpolate(coarse + (long)axis * high * wide, y, x, high, across, wide);
}

__kernel void join(
    // in:
    __global const float *restrict values,  // [CHANNELS][rows + 2 TOP][stride]
    __global const float *restrict noise,   // [CHANNELS][rows][pitch]
    __global const float *restrict coarse,  // [CHANNELS][high][wide]
    __global const float *restrict gains,   // [ny][nx]
    __global const float *restrict inverse, // [CHANNELS][CHANNELS], of the axes
    __global const float *restrict share,   // [CHANNELS]
    __global const float *restrict loss,    // of roots, see levels.py
    // out:
    __global float *restrict planes,        // [CHANNELS][rows][cols]
    // params:
    const float offset,
    // sizes:
    const int rows, const int cols, const int stride, const int pitch, const int high, const int across, const int wide,
    const int ny, const int nx)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const long level = (long)(rows + 2 * TOP) * stride, from = (long)(y + TOP) * stride + x + LEFT;
    const float gain = gain_at(gains, y, x, rows, cols, ny, nx);
    float clean[CHANNELS];
#pragma unroll
    for (int a = 0; a < CHANNELS; ++a)
        clean[a] = values[a * level + from] - noise[((long)a * rows + y) * pitch + x]
                   - interpolate(coarse + (long)a * high * wide, y, x, high, across, wide);
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) {
        float root = 0.0f;
#pragma unroll
        for (int a = 0; a < CHANNELS; ++a) root += inverse[c * CHANNELS + a] * clean[a];
        planes[((long)c * rows + y) * cols + x] = gain * (light_of(root, share[c], loss) - offset);
    }
}
