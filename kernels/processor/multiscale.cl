// multiscale.py has the formulas. Each level is a plane per axis with a margin: 3 rows above and below, LEFT columns before,
// some after; row and column 0 of the picture are (3, LEFT) there. A work-item of `shrink` goes down BAND rows. On CPUs
// (LINES) it has CHUNK columns and makes the sum of all blocks; elsewhere it has two neighbouring columns in which blocks
// begin, and `gather` adds what they say about each pixel.
#define LEFT 8
#define TOP 3
#define CEILING 1.5f  // of the share that is removed, before it is limited to 1: see `noise_part`

// Pixel of 0 .. size - 1 in place of one outside, mirrored with the end repeated.
inline int mirror_index(const int i, const int size)
{
    return clamp(i < 0 ? -1 - i : i >= size ? 2 * size - 1 - i : i, 0, size - 1);
}

// Place of pixel i among nodes that are even from edge to edge, as in shade.cl: the node before it, and the fraction.
inline int node_before(const int i, const int nodes, const int size, float *fraction)
{
    const int place = (2 * i + 1) * (nodes - 1), before = place / (2 * size);
    *fraction = (float)(place - before * 2 * size) / (float)(2 * size);
    return before;
}

// Gain of the shading correction that was applied to a pixel.
inline float gain_at(__global const float *restrict gains, const int y, const int x, const int rows, const int cols,
                     const int ny, const int nx)
{
#if SHADED
    float v, u;
    __global const float *near = gains + node_before(y, ny, rows, &v) * nx + node_before(x, nx, cols, &u);
    return (1.0f - v) * ((1.0f - u) * near[0] + u * near[1]) + v * ((1.0f - u) * near[nx] + u * near[nx + 1]);
#else
    return 1.0f;
#endif
}

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
    for (int c = 0; c < CHANNELS; ++c) {
        const float value = planes[c * pixels + from] / gain + offset;
        root[c] = copysign(sqrt(fabs(value)), value);
    }
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

#if LINES
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
    __global float *restrict parts,         // [..][rows][wide], the noise
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
        __global float *to = parts + ((long)axis * rows + y0 + y - 3) * wide + x0;
        for (int i = 0; i < CHUNK / 8; ++i) vstore8(vload8(i + 1, sums) * (1.0f / 256.0f), i, to);
    }
}
#else
inline float4 walsh(const float4 v)
{
    const float2 sums = v.xz + v.yw, differences = v.xz - v.yw;
    return (float4)(sums.x + sums.y, sums.x - sums.y, differences.x - differences.y, differences.x + differences.y);
}

inline float4 noise_part(const float4 coefficient, const float4 scale)
{
    return coefficient * clamp(CEILING - coefficient * coefficient * scale, 0.0f, 1.0f);
}

// Add what a block removes from its four rows; all are Walsh coefficients along the rows.
inline void remove_noise(const float4 row[4], const float4 scale[4], float4 removed[4])
{
    const float4 up = row[0] + row[1], low = row[2] + row[3], fall = row[0] - row[1], rise = row[2] - row[3];
    float4 mean = noise_part(up + low, scale[0]);
    mean.x = 0.0f;  // of the block: a coarser level removes its noise
    const float4 half_part = noise_part(up - low, scale[1]), bump = noise_part(fall - rise, scale[2]),
                 zigzag = noise_part(fall + rise, scale[3]);
    const float4 same = mean + half_part, other = mean - half_part, one = bump + zigzag, two = bump - zigzag;
    removed[0] += same + one;
    removed[1] += same - one;
    removed[2] += other - two;
    removed[3] += other + two;
}

__kernel void shrink(
    // in:
    __global const float *restrict values,  // [..][rows + 2 TOP][stride]
    __global const float *restrict scales,  // [..][4 down][4 along], 1 / (2 t^2)
    // out:
    __global float *restrict parts,         // [..][5][rows][wide], of two columns of blocks for the five they reach
    // sizes:
    const int rows, const int cols, const int stride, const int wide)
{
    const int x = get_global_id(0), y0 = get_global_id(1) * BAND, axis = get_global_id(2);
    GUARD(x >= wide || y0 >= rows)
    __global const float *from = values + ((long)axis * (rows + 2 * TOP) + y0) * stride + 2 * x + LEFT - 4;
    float4 scale[4], first[4], second[4], removed[4], added[4];  // of blocks in the first and in the second column
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        scale[k] = vload4(4 * axis + k, scales);
        removed[k] = added[k] = (float4)(0.0f);
        if (k == 3) break;
        const float4 row = vload4(0, from + (long)k * stride);
        first[k + 1] = walsh(row);
        second[k + 1] = walsh((float4)(row.yzw, from[(long)k * stride + 4]));
    }
    const int last = min(BAND, rows - y0) + TOP;
    for (int y = 0; y < last; ++y) {
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            first[k] = first[k + 1];
            second[k] = second[k + 1];
        }
        const long at = (long)(y + 3) * stride;
        const float4 row = vload4(0, from + at);
        first[3] = walsh(row);
        second[3] = walsh((float4)(row.yzw, from[at + 4]));
        remove_noise(first, scale, removed);
        remove_noise(second, scale, added);
        if (y >= TOP) {
            const float4 one = walsh(removed[0]), two = walsh(added[0]);
            const long plane = (long)rows * wide;
            __global float *to = parts + 5 * axis * plane + (long)(y0 + y - TOP) * wide + x;
            to[0] = one.x;
            to[plane] = one.y + two.x;
            to[2 * plane] = one.z + two.y;
            to[3 * plane] = one.w + two.z;
            to[4 * plane] = two.w;
        }
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            removed[k] = removed[k + 1];
            added[k] = added[k + 1];
        }
        removed[3] = added[3] = (float4)(0.0f);
    }
}
#endif

__kernel void gather(
    // in:
    __global const float *restrict parts,  // [..][5][rows][wide]
    // out:
    __global float *restrict noise,        // [..][rows][cols]
    // sizes:
    const int rows, const int cols, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1), axis = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    const long plane = (long)rows * wide;
    const int odd = x & 1, half_x = x / 2;
    __global const float *at = parts + (5 * axis + odd) * plane + (long)y * wide + half_x;
    float sum = at[2] + at[2 * plane + 1];
    if (!odd) sum += at[4 * plane];
    noise[((long)axis * rows + y) * cols + x] = sum * (1.0f / 256.0f);
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
        const float near = fmin(loss[1] / (loss[0] + root * root), 1.0f);
        const float lost = (((loss[2] * near + loss[3]) * near + loss[4]) * near + loss[5]) * near + loss[6];
        planes[((long)c * rows + y) * cols + x] = gain * (root * fabs(root) - offset + share[c] * lost);
    }
}
