// Three passes: move and compare, weigh, add. A GPU's work-item makes a block, a block, a pixel; a CPU's a row, in runs
// of a tile's width: pixels of a tile have one displacement, and neighbours are read in vectors.
// From the host: FRAMES, TILE, PERIOD_Y, PERIOD_X, CPU (0 or 1), WIDTH, OUTSIDE.
#pragma OPENCL FP_CONTRACT OFF
#include "lanes.clh"

#define RUN (CPU ? TILE * PERIOD_X : PERIOD_X)  // columns that a work-item of `move` does

// Weights of the samples at -1, 0, 1, 2 at 0 <= s < 1, after Keys.
INLINE float4 keys(const float s)
{
    const float r = 1.0f - s;
    return (float4)(-0.5f * s * r * r, 1.0f - s * s * (2.5f - 1.5f * s), 1.0f - r * r * (2.5f - 1.5f * r),
                    -0.5f * s * s * r);
}

INLINE void move_run(
    __global const ushort *restrict raw,          // [FRAMES][rows][cols]
    __global const float *restrict displacement,  // [FRAMES][tiles_y][tiles_x][2]
    __global float *restrict moved,               // [FRAMES][rows][cols]
    __global float *restrict misfit,              // [FRAMES][h][w]
    const int reference, const float black_level, const float gain, const float read2,
    const int tiles_y, const int tiles_x, const int rows, const int cols, const int h, const int w, const int first,
    const int by, const int i)
{
    const int bx = first / PERIOD_X, length = min(RUN, cols - first);
    const int tile = min(by / TILE, tiles_y - 1) * tiles_x + min(bx / TILE, tiles_x - 1);
    __global const float *d = displacement + 2 * ((size_t)i * tiles_y * tiles_x + tile);
    const float whole_y = i == reference ? 0.0f : floor(d[0]), whole_x = i == reference ? 0.0f : floor(d[1]);
    const float4 wy = keys(i == reference ? 0.0f : d[0] - whole_y), wx = keys(i == reference ? 0.0f : d[1] - whole_x);
    const float weights_y[4] = {wy.x, wy.y, wy.z, wy.w}, weights_x[4] = {wx.x, wx.y, wx.z, wx.w};
    const float spread = 1.0f + dot(wy, wy) * dot(wx, wx);
    const long left = first + ((long)whole_x - 1) * PERIOD_X;
    const bool columns_inside = left >= 0 && left + length + 3 * PERIOD_X <= cols;
    float sums[RUN / PERIOD_X];
#pragma unroll
    for (int b = 0; b < RUN / PERIOD_X; ++b) sums[b] = 0.0f;
    for (int k = 0; k < PERIOD_Y; ++k) {
        const int y = by * PERIOD_Y + k;
        if (y >= rows) break;
        const long top = y + ((long)whole_y - 1) * PERIOD_Y;
        const bool inside = columns_inside && top >= 0 && top + 3 * PERIOD_Y < rows && length == RUN;
        __global const ushort *wanted = raw + ((size_t)reference * rows + y) * cols + first;
        __global float *to = moved + ((size_t)i * rows + y) * cols + first;
        float q[RUN];
#if WIDTH == 8
        if (inside && RUN % WIDTH == 0) {
            __global const ushort *from = raw + ((size_t)i * rows + top) * cols + left;
            for (int x = 0; x < RUN; x += WIDTH) {
                real value = 0.0f;
#pragma unroll
                for (int a = 0; a < 4; ++a) {
                    real line = 0.0f;
#pragma unroll
                    for (int b = 0; b < 4; ++b) {
                        __global const ushort *tap = from + (size_t)a * PERIOD_Y * cols + b * PERIOD_X;
                        line += weights_x[b] * TO_REAL(vload8(0, tap + x));
                    }
                    value += weights_y[a] * line;
                }
                const real other = TO_REAL(vload8(0, wanted + x)), difference = value - other;
                const real above = 0.5f * (value + other) - black_level;
                const real light = above > 0.0f ? above : (real)0.0f;  // fmax() is slow on PoCL
                vstore8(value, 0, to + x);
                vstore8(difference * difference / (spread * (gain * light + read2)), 0, q + x);
            }
        } else
#endif
        for (int x = 0; x < length; ++x) {
            bool there = true;
            float value = 0.0f;
            for (int a = 0; a < 4; ++a) {
                const long v = top + a * PERIOD_Y;
                float line = 0.0f;
                for (int b = 0; b < 4; ++b) {
                    const long u = left + x + b * PERIOD_X;
                    if (inside || (v >= 0 && v < rows && u >= 0 && u < cols))
                        line += weights_x[b] * raw[((size_t)i * rows + v) * cols + u];
                    else
                        there = there && weights_y[a] * weights_x[b] == 0.0f;
                }
                value += weights_y[a] * line;
            }
            const float other = wanted[x], difference = value - other;
            const float light = fmax(0.5f * (value + other) - black_level, 0.0f);
            to[x] = value;
            q[x] = there ? difference * difference / (spread * (gain * light + read2)) : OUTSIDE;
        }
        for (int x = length; x < RUN; ++x) q[x] = 0.0f;
        for (int b = 0; b < RUN / PERIOD_X; ++b)
#pragma unroll
            for (int x = 0; x < PERIOD_X; ++x) sums[b] += q[b * PERIOD_X + x];
    }
    const int tall = min(PERIOD_Y, rows - by * PERIOD_Y);
    for (int b = 0; b * PERIOD_X < length; ++b)
        misfit[((size_t)i * h + by) * w + bx + b] = sums[b] / (float)(tall * min(PERIOD_X, length - b * PERIOD_X));
}

__kernel void move(
    // in:
    __global const ushort *restrict raw,          // [FRAMES][rows][cols]
    __global const float *restrict displacement,  // [FRAMES][tiles_y][tiles_x][2]
    // out:
    __global float *restrict moved,               // [FRAMES][rows][cols]
    __global float *restrict misfit,              // [FRAMES][h][w]
    // params:
    const int reference, const float black_level, const float gain, const float read2,
    // sizes:
    const int tiles_y, const int tiles_x, const int frames, const int rows, const int cols, const int h, const int w)
{
    const int bx = get_global_id(0), by = get_global_id(1), i = get_global_id(2);
    if (bx >= w || by >= h || i >= frames) return;
#if CPU
    for (int first = 0; first < cols; first += RUN)
        move_run(raw, displacement, moved, misfit, reference, black_level, gain, read2, tiles_y, tiles_x, rows, cols, h,
                 w, first, by, i);
#else
    move_run(raw, displacement, moved, misfit, reference, black_level, gain, read2, tiles_y, tiles_x, rows, cols, h, w,
             bx * PERIOD_X, by, i);
#endif
}

INLINE float share(__global const float *restrict up, __global const float *restrict here,
                   __global const float *restrict down, const long left, const long x, const long right, const float low,
                   const float high)
{
    const float sum = (up[left] + up[x] + up[right]) + (here[left] + here[x] + here[right])
        + (down[left] + down[x] + down[right]);
    const float trusted = (high - sum / 9.0f) / (high - low);
    return trusted > 1.0f ? 1.0f : trusted < 0.0f ? 0.0f : trusted;
}

__kernel void weigh(
    // in:
    __global const float *restrict misfit,  // [FRAMES][h][w]
    // out:
    __global float *restrict weights,       // [FRAMES][h][w]
    // params:
    const int reference, const float low, const float high,
    // sizes:
    const int frames, const int h, const int w)
{
    const int x = get_global_id(0), y = get_global_id(1), i = get_global_id(2);
    GUARD(x >= w || y >= h || i >= frames)
    __global const float *here = misfit + ((size_t)i * h + y) * w;
    __global const float *up = y > 0 ? here - w : here, *down = y + 1 < h ? here + w : here;
    __global float *to = weights + ((size_t)i * h + y) * w;
#if CPU
    if (i == reference) {
        for (long u = 0; u < w; ++u) to[u] = 1.0f;
        return;
    }
    to[0] = share(up, here, down, 0, 0, min(1, w - 1), low, high);
    for (long u = 1; u < w - 1; ++u) to[u] = share(up, here, down, u - 1, u, u + 1, low, high);
    to[w - 1] = share(up, here, down, max(w - 2, 0), w - 1, w - 1, low, high);
#else
    to[x] = i == reference ? 1.0f : share(up, here, down, max(x - 1, 0), x, min(x + 1, w - 1), low, high);
#endif
}

__kernel void average(
    // in:
    __global const float *restrict moved,    // [FRAMES][rows][cols]
    __global const float *restrict weights,  // [FRAMES][h][w]
    // out:
    __global float *restrict out,            // [rows][cols]
    // sizes:
    const int rows, const int cols, const int h, const int w)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int by = y / PERIOD_Y;
#if CPU
    float totals[TILE * PERIOD_X], shares[TILE];
    for (int start = 0; start < w; start += TILE) {
        const int length = min(TILE * PERIOD_X, cols - start * PERIOD_X);
        const bool whole = length == TILE * PERIOD_X;
        for (int c = 0; c < TILE * PERIOD_X; ++c) totals[c] = 0.0f;
        for (int b = 0; b < TILE; ++b) shares[b] = 0.0f;
        for (int i = 0; i < FRAMES; ++i) {
            __global const float *from = moved + ((size_t)i * rows + y) * cols + start * PERIOD_X;
            __global const float *weight = weights + ((size_t)i * h + by) * w + start;
            if (whole)
                for (int b = 0; b < TILE; ++b) {
                    shares[b] += weight[b];
#pragma unroll
                    for (int c = 0; c < PERIOD_X; ++c) totals[b * PERIOD_X + c] += weight[b] * from[b * PERIOD_X + c];
                }
            else
                for (int c = 0; c < length; ++c) {
                    if (c % PERIOD_X == 0) shares[c / PERIOD_X] += weight[c / PERIOD_X];
                    totals[c] += weight[c / PERIOD_X] * from[c];
                }
        }
        __global float *to = out + (size_t)y * cols + start * PERIOD_X;
        for (int c = 0; c < length; ++c) to[c] = totals[c] / shares[c / PERIOD_X];
    }
#else
    float total = 0.0f, shares = 0.0f;
#pragma unroll 4
    for (int i = 0; i < FRAMES; ++i) {
        const float weight = weights[((size_t)i * h + by) * w + x / PERIOD_X];
        total += weight * moved[((size_t)i * rows + y) * cols + x];
        shares += weight;
    }
    out[(size_t)y * cols + x] = total / shares;
#endif
}
