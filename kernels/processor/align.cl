// Planes are continued by PAD blocks on all sides: no search needs to check the picture's ends.
// From the host: WIDTH (8 lanes on CPUs), TILE, PAD, PERIOD_Y, PERIOD_X, LIKELY, SAVED, SURE.
#pragma OPENCL FP_CONTRACT OFF
#include "lanes.clh"

__kernel void blocks(
    // in:
    __global const ushort *restrict raw,  // [frames][rows][cols]
    // out:
    __global int *restrict out,           // [frames][h + 2 PAD][w + 2 PAD]
    // sizes:
    const int frames, const int rows, const int cols, const int h, const int w)
{
    const int x = get_global_id(0), y = get_global_id(1), i = get_global_id(2);
    GUARD(x >= w + 2 * PAD || y >= h + 2 * PAD || i >= frames)
    const int by = clamp(y - PAD, 0, h - 1), bx = clamp(x - PAD, 0, w - 1);
    __global const ushort *from = raw + ((size_t)i * rows + by * PERIOD_Y) * cols + bx * PERIOD_X;
    int sum = 0;
#pragma unroll
    for (int j = 0; j < PERIOD_Y; ++j)
#pragma unroll
        for (int k = 0; k < PERIOD_X; ++k) sum += from[(size_t)j * cols + k];
    out[((size_t)i * (h + 2 * PAD) + y) * (w + 2 * PAD) + x] = sum;
}

__kernel void halve(
    // in:
    __global const int *restrict fine,  // [frames][fine_h + 2 PAD][fine_w + 2 PAD]
    // out:
    __global int *restrict out,         // [frames][h + 2 PAD][w + 2 PAD]
    // sizes:
    const int frames, const int fine_h, const int fine_w, const int h, const int w)
{
    const int x = get_global_id(0), y = get_global_id(1), i = get_global_id(2);
    GUARD(x >= w + 2 * PAD || y >= h + 2 * PAD || i >= frames)
    const int by = 2 * clamp(y - PAD, 0, h - 1) + PAD, bx = 2 * clamp(x - PAD, 0, w - 1) + PAD;
    const size_t stride = fine_w + 2 * PAD;
    __global const int *from = fine + ((size_t)i * (fine_h + 2 * PAD) + by) * stride + bx;
    out[((size_t)i * (h + 2 * PAD) + y) * (w + 2 * PAD) + x]
        = (from[0] + from[1] + from[stride] + from[stride + 1] + 2) >> 2;
}

INLINE word differences(__global const int *a, __global const int *b)
{
#if WIDTH == 8
    const int8 p = vload8(0, a), q = vload8(0, b);
    return TO_WORD(max(p, q) - min(p, q));
#else
    return abs_diff(*a, *b);
#endif
}

INLINE int difference_sum(__global const int *restrict wanted, __global const int *restrict seen, const int stride)
{
    word sum = 0;
    for (int j = 0; j < TILE; ++j)
#pragma unroll
        for (int k = 0; k < TILE; k += WIDTH) sum += differences(wanted + j * stride + k, seen + j * stride + k);
#if WIDTH == 8
    const uint4 half_ = sum.lo + sum.hi;
    return half_.x + half_.y + half_.z + half_.w;
#else
    return sum;
#endif
}

INLINE float square_sum(__global const int *restrict wanted, __global const int *restrict seen, const int stride)
{
    real sum = 0.0f;
    for (int j = 0; j < TILE; ++j)
#pragma unroll
        for (int k = 0; k < TILE; k += WIDTH) {
            const real d = TO_REAL(differences(wanted + j * stride + k, seen + j * stride + k));
            sum += d * d;
        }
#if WIDTH == 8
    const float4 half_ = sum.lo + sum.hi;
    return half_.x + half_.y + half_.z + half_.w;
#else
    return sum;
#endif
}

// Number of a tile's rows or columns that are inside a picture of n blocks, there and displaced by d.
INLINE int overlap(const int tile, const int d, const int n)
{
    return max(min(min((tile + 1) * TILE, n), n - d) - max(tile * TILE, -d), 0);
}

// The whole part of the square root of up to TILE^2.
INLINE int whole_root(const int n)
{
    int root = 0;
    while ((root + 1) * (root + 1) <= n) ++root;
    return root;
}

__kernel void search(
    // in:
    __global const int *restrict plane,    // [frames][h + 2 PAD][w + 2 PAD]
    __global const int *restrict parents,  // [frames][parent_y][parent_x][3], if parent_y > 0
    // out:
    __global int *restrict out,            // [frames][tiles_y][tiles_x][3]: displacement, and whether noise cannot be it
    // params:
    const int reference, const int radius,
    // sizes:
    const int parent_y, const int parent_x, const int h, const int w, const int tiles_y, const int tiles_x,
    const int frames)
{
    const int tx = get_global_id(0), ty = get_global_id(1), i = get_global_id(2);
    if (tx >= tiles_x || ty >= tiles_y || i >= frames) return;
    const int stride = w + 2 * PAD;
    const size_t size = (size_t)(h + 2 * PAD) * stride;
    __global const int *wanted = plane + reference * size + (size_t)(ty * TILE + PAD) * stride + tx * TILE + PAD;
    __global const int *seen = wanted + ((long)i - reference) * (long)size;
    __global int *to = out + 3 * (((size_t)i * tiles_y + ty) * tiles_x + tx);
    int y = 0, x = 0, sure = 0;
    if (i != reference) {
        if (parent_y > 0) {
            __global const int *parent = parents
                + 3 * (((size_t)i * parent_y + min(ty / 2, parent_y - 1)) * parent_x + min(tx / 2, parent_x - 1));
            y = clamp(2 * parent[0], -(2 + ty) * TILE, h + TILE - ty * TILE);
            x = clamp(2 * parent[1], -(2 + tx) * TILE, w + TILE - tx * TILE);
            sure = parent[2];
        }
        const int at_start = difference_sum(wanted, seen + (long)y * stride + x, stride);
        int least = at_start, best_y = y, best_x = x;
        for (int dy = -radius; dy <= radius; ++dy)
            for (int dx = -radius; dx <= radius; ++dx) {
                const int sum = difference_sum(wanted, seen + (long)(y + dy) * stride + x + dx, stride);
                const int root = whole_root(overlap(ty, y + dy, h) * overlap(tx, x + dx, w));
                if (sum < least && root > 0 && at_start - sum > at_start / root * LIKELY) {
                    least = sum;
                    best_y = y + dy;
                    best_x = x + dx;
                }
            }
        y = best_y;
        x = best_x;
        const int root = whole_root(overlap(ty, y, h) * overlap(tx, x, w));
        const int at_rest = difference_sum(wanted, wanted + ((long)i - reference) * (long)size, stride);
        sure |= root > 0 && at_rest - least > at_rest / root * SAVED;
    }
    to[0] = y;
    to[1] = x;
    to[2] = sure;
}

__kernel void fraction(
    // in:
    __global const int *restrict plane,  // [frames][h + 2 PAD][w + 2 PAD]
    __global const int *restrict found,  // [frames][tiles_y][tiles_x][3], see search
    // out:
    __global float *restrict out,        // [frames][tiles_y][tiles_x][2]
    // params:
    const int reference,
    // sizes:
    const int h, const int w, const int tiles_y, const int tiles_x, const int frames)
{
    const int tx = get_global_id(0), ty = get_global_id(1), i = get_global_id(2);
    if (tx >= tiles_x || ty >= tiles_y || i >= frames) return;
    const int stride = w + 2 * PAD;
    const size_t size = (size_t)(h + 2 * PAD) * stride, at = ((size_t)i * tiles_y + ty) * tiles_x + tx;
    const int whole_y = found[3 * at + 2] ? found[3 * at] : 0, whole_x = found[3 * at + 2] ? found[3 * at + 1] : 0;
    __global const int *wanted = plane + reference * size + (size_t)(ty * TILE + PAD) * stride + tx * TILE + PAD;
    __global const int *seen = wanted + ((long)i - reference) * (long)size + (long)whole_y * stride + whole_x;
    float y = 0.0f, x = 0.0f;
    if (i != reference) {
        float f[3][3];
        for (int dy = -1; dy <= 1; ++dy)
            for (int dx = -1; dx <= 1; ++dx)
                f[dy + 1][dx + 1] = square_sum(wanted + max(-dy, 0) * stride + max(-dx, 0),
                                               seen + max(dy, 0) * stride + max(dx, 0), stride);
        const float slope_y = (f[2][0] + f[2][1] + f[2][2] - (f[0][0] + f[0][1] + f[0][2])) / 6.0f;
        const float slope_x = (f[0][2] + f[1][2] + f[2][2] - (f[0][0] + f[1][0] + f[2][0])) / 6.0f;
        const float bend_y = (f[2][0] + f[2][1] + f[2][2] + (f[0][0] + f[0][1] + f[0][2])
                              - 2.0f * (f[1][0] + f[1][1] + f[1][2])) / 3.0f;
        const float bend_x = (f[0][2] + f[1][2] + f[2][2] + (f[0][0] + f[1][0] + f[2][0])
                              - 2.0f * (f[0][1] + f[1][1] + f[2][1])) / 3.0f;
        const float twist = (f[2][2] - f[2][0] - (f[0][2] - f[0][0])) / 4.0f;
        const bool sure_y = bend_y > 0.25f * f[1][1], sure_x = bend_x > 0.25f * f[1][1];
        const float count = max(overlap(ty, whole_y, h) * overlap(tx, whole_x, w), 1);
        const float noise = SURE * f[1][1] / count;  // depth of a minimum, see align.py
        // a square of sums leaves float32's range never: they are below 2^54
        const float determinant = bend_y * bend_x - twist * twist;
        if (sure_y && sure_x && determinant > 0.25f * (bend_y * bend_x)) {
            y = (twist * slope_x - bend_x * slope_y) / determinant;
            x = (twist * slope_y - bend_y * slope_x) / determinant;
            if (-0.5f * (y * slope_y + x * slope_x) < noise * (1.0f + f[1][1] / (4.0f * min(bend_y, bend_x))))
                y = x = 0.0f;
        } else {
            if (sure_y && slope_y * slope_y / (2.0f * bend_y) >= noise * (1.0f + f[1][1] / (4.0f * bend_y)))
                y = -slope_y / bend_y;
            if (sure_x && slope_x * slope_x / (2.0f * bend_x) >= noise * (1.0f + f[1][1] / (4.0f * bend_x)))
                x = -slope_x / bend_x;
        }
        y = whole_y + clamp(y, -0.5f, 0.5f);
        x = whole_x + clamp(x, -0.5f, 0.5f);
    }
    out[2 * at] = y;
    out[2 * at + 1] = x;
}
