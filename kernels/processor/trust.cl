// Two passes: `compare` makes the misfit of each block, `weigh` the weights. One block per work-item.
// From the host: TILE, PERIOD_Y, PERIOD_X, OUTSIDE.
#pragma OPENCL FP_CONTRACT OFF
#include "tiles.clh"

// Weights of the samples at -1, 0, 1, 2 at 0 <= s < 1: cubic B-splines.
inline float4 spline(const float s)
{
    const float r = 1.0f - s;
    return (float4)(r * r * r, 4.0f - 6.0f * s * s + 3.0f * s * s * s, 4.0f - 6.0f * r * r + 3.0f * r * r * r,
                    s * s * s) / 6.0f;
}

// Mean, and mean of squares, of samples a period apart around (y, x), and whether any of them is full.
inline float3 smoothed(__global const ushort *restrict frame, const float4 wy, const float4 wx, const int y,
                       const int x, const float dark, const float scale, const float full, const int rows,
                       const int cols)
{
    const float weights_y[4] = {wy.x, wy.y, wy.z, wy.w}, weights_x[4] = {wx.x, wx.y, wx.z, wx.w};
    float sum = 0.0f, squares = 0.0f, is_full = 0.0f;
    for (int a = 0; a < 4; ++a) {
        // outside, the last sample of this place in the period
        int v = y + (a - 1) * PERIOD_Y;
        if (v < 0) v = (v % PERIOD_Y + PERIOD_Y) % PERIOD_Y;
        if (v >= rows) v -= (v - rows + PERIOD_Y) / PERIOD_Y * PERIOD_Y;
        if (weights_y[a] == 0.0f || v < 0) continue;
        float line = 0.0f, line_squares = 0.0f;
        for (int b = 0; b < 4; ++b) {
            int u = x + (b - 1) * PERIOD_X;
            if (u < 0) u = (u % PERIOD_X + PERIOD_X) % PERIOD_X;
            if (u >= cols) u -= (u - cols + PERIOD_X) / PERIOD_X * PERIOD_X;
            if (weights_x[b] == 0.0f || u < 0) continue;
            const float number = frame[(size_t)v * cols + u], value = (number - dark) * scale;
            if (number >= full) is_full = 1.0f;
            line += weights_x[b] * value;
            line_squares += weights_x[b] * value * value;
        }
        sum += weights_y[a] * line;
        squares += weights_y[a] * line_squares;
    }
    return (float3)(sum, squares, is_full);
}

__kernel void compare(
    // in:
    __global const ushort *restrict raw,          // [frames][rows][cols]
    __global const float *restrict displacement,  // [frames][tiles_y][tiles_x][2]
    __global const float *restrict table,         // [5][frames] dark, scale, shot, floor, full
    // out:
    __global float *restrict misfit,              // [frames][h][w]
    // params:
    const int reference, const int last, const float texture, const float margin,
    // sizes:
    const int tiles_y, const int tiles_x, const int frames, const int rows, const int cols, const int h, const int w)
{
    const int bx = get_global_id(0), by = get_global_id(1), i = get_global_id(2);
    GUARD(bx >= w || by >= h || i >= frames)
    __global const float *tiles = displacement + 2 * (size_t)i * tiles_y * tiles_x;
    __global const ushort *wanted = raw + (size_t)reference * rows * cols, *seen = raw + (size_t)i * rows * cols;
    const float full = table[4 * frames + i], scale = table[frames + i], dark = table[i];
    const float4 still = spline(0.0f);
    const float kept = dot(still, still) * dot(still, still);
    float sum = 0.0f, pixels = 0.0f;
    bool is_full = false;
    for (int k = 0; k < PERIOD_Y; ++k)
        for (int m = 0; m < PERIOD_X; ++m) {
            const int y = by * PERIOD_Y + k, x = bx * PERIOD_X + m;
            if (y >= rows || x >= cols) continue;
            float2 move = (float2)(0.0f);
            if (i != reference) move = displacement_at(tiles, y, x, tiles_y, tiles_x);
            const float moved_y = clamp(move.x / PERIOD_Y, -1e5f, 1e5f), moved_x = clamp(move.y / PERIOD_X, -1e5f, 1e5f);
            const float whole_y = floor(moved_y), whole_x = floor(moved_x);
            const float4 wy = spline(moved_y - whole_y), wx = spline(moved_x - whole_x);
            const float3 other = smoothed(seen, wy, wx, y + (int)whole_y * PERIOD_Y, x + (int)whole_x * PERIOD_X, dark,
                                          scale, full, rows, cols);
            const float light = fmax(other.x, 0.0f);
            const float noise = table[2 * frames + i] * light + table[3 * frames + i];
            const float left = (full - dark) * scale - other.x;
            if (other.z != 0.0f || left < 0.0f || left * left < margin * margin * noise) is_full = true;
            pixels += 1.0f;
            if (i == reference) continue;
            const float3 own = smoothed(wanted, still, still, y, x, table[reference], table[frames + reference],
                                        table[4 * frames + reference], rows, cols);
            if (own.z != 0.0f || other.z != 0.0f) continue;
            const float own_noise = table[2 * frames + reference] * light + table[3 * frames + reference];
            const float change = fmax(own.y - own.x * own.x - (1.0f - kept) * own_noise, 0.0f);
            const float expected = kept * own_noise + dot(wy, wy) * dot(wx, wx) * noise + texture * change;
            sum += (other.x - own.x) * (other.x - own.x) / expected;
        }
    misfit[((size_t)i * h + by) * w + bx] = is_full && last >= 0 && i != last ? OUTSIDE : sum / pixels;
}

__kernel void weigh(
    // in:
    __global const float *restrict misfit,  // [frames][h][w]
    // out:
    __global float *restrict out,           // [frames][h][w]
    // params:
    const float low, const float high,
    // sizes:
    const int frames, const int h, const int w)
{
    const int x = get_global_id(0), y = get_global_id(1), i = get_global_id(2);
    GUARD(x >= w || y >= h || i >= frames)
    float sum = 0.0f;
    for (int k = -1; k <= 1; ++k) {
        __global const float *line = misfit + ((size_t)i * h + clamp(y + k, 0, h - 1)) * w;
        sum += line[max(x - 1, 0)] + line[x] + line[min(x + 1, w - 1)];
    }
    out[((size_t)i * h + y) * w + x] = clamp((high - sum / 9.0f) / (high - low), 0.0f, 1.0f);
}
