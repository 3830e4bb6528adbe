// One pixel of all PLANES that share a grid per work-item: its place and weights are found once.
#ifdef PLANES
#include "distort.clh"

// Grids interpolated along the columns, once for every half-pixel row that the pixels' centres and corners lie on.
__kernel void along_columns(
    // in:
    __global const float *restrict grids,  // [maps][ny][values], values = 3 nx
    // out:
    __global float *restrict lines,        // [maps][2 rows + 1][values]
    // sizes:
    const int maps, const int ny, const int values, const int rows)
{
    const int j = get_global_id(0), half_y = get_global_id(1), m = get_global_id(2);
    GUARD(j >= values || half_y > 2 * rows || m >= maps)
    float w[4];
    const int i = nodes(half_y, rows, ny, w);
    __global const float *restrict at = grids + ((size_t)m * ny + i) * values + j;
    float total = 0.0f;  // of differences: nodes that are equal have no rounding
#pragma unroll
    for (int a = 1; a < 4; ++a) total += w[a] * (at[a * values] - at[0]);
    lines[((size_t)m * (2 * rows + 1) + half_y) * values + j] = at[0] + total;
}

__kernel void cubic(
    // in:
    __global const float *restrict planes, __global const float *restrict lines,
    // out:
    __global float *restrict out,
    // sizes:
    const int source_rows, const int source_cols, const int nx, const int maps, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), m = get_global_id(2);
    GUARD(x >= cols || y >= rows || m >= maps)
    const float3 at = place(lines + ((size_t)m * (2 * rows + 1) + 2 * y + 1) * nx * 3, 2 * x + 1, nx, cols);
    const float floor_y = floor(at.x), floor_x = floor(at.y);
    const int first_y = y + (int)floor_y - 1, first_x = x + (int)floor_x - 1;
    const float4 wy = keys(at.x - floor_y), wx = keys(at.y - floor_x);
    if (first_y >= 0 && first_x >= 0 && first_y + 4 <= source_rows && first_x + 4 <= source_cols) {  // nearly everywhere
#pragma unroll
        for (int p = 0; p < PLANES; ++p) {
            __global const float *from = planes + ((size_t)(m * PLANES + p) * source_rows + first_y) * source_cols + first_x;
            const float4 sums = wy.x * vload4(0, from) + wy.y * vload4(0, from + source_cols) +
                                wy.z * vload4(0, from + 2 * source_cols) + wy.w * vload4(0, from + 3 * source_cols);
            out[((size_t)(m * PLANES + p) * rows + y) * cols + x] = at.z * dot(sums, wx);
        }
        return;
    }
    const float in_y[4] = {wy.x, wy.y, wy.z, wy.w}, in_x[4] = {wx.x, wx.y, wx.z, wx.w};
    float total[PLANES];
#pragma unroll
    for (int p = 0; p < PLANES; ++p) total[p] = 0.0f;
#pragma unroll
    for (int a = 0; a < 4; ++a)
#pragma unroll
        for (int b = 0; b < 4; ++b) {
            const int sy = inside(first_y + a, source_rows, BORDER), sx = inside(first_x + b, source_cols, BORDER);
            const int dropped = BORDER == 0 && (sy != first_y + a || sx != first_x + b);
            const float w = dropped ? 0.0f : in_y[a] * in_x[b];
#pragma unroll
            for (int p = 0; p < PLANES; ++p)
                total[p] += w * planes[((size_t)(m * PLANES + p) * source_rows + sy) * source_cols + sx];
        }
#pragma unroll
    for (int p = 0; p < PLANES; ++p) out[((size_t)(m * PLANES + p) * rows + y) * cols + x] = at.z * total[p];
}

// Part of the samples next to a cell, outside of it, that its interpolants can take without falling below 0: the least
// ratio of positive to negative terms at nine places in it; 1 - 2 (1 - ratio) of it, or all from a ratio of 1 on.
__kernel void rooms(
    // in:
    __global const float *restrict light,  // [channels][rows + 3][cols + 3], 3 samples around the frame's
    // out:
    __global float *restrict room,         // [rows][cols], of cells
    // params:
    const int top, const int left,         // first of the cells that are computed
    // sizes:
    const int channels, const int rows, const int cols, const int high, const int wide)
{
    const int dx = get_global_id(0), dy = get_global_id(1), x = left + dx, y = top + dy;
    GUARD(dx >= wide || dy >= high)
    const int pitch = cols + 3;
    float least = 1.0f;
    for (int c = 0; c < channels; ++c) {
        __global const float *at = light + ((size_t)c * (rows + 3) + y) * pitch + x;
        float4 r[4];
#pragma unroll
        for (int k = 0; k < 4; ++k) r[k] = fmax(vload4(0, at + k * pitch), 0.0f);
        const float4 high4 = fmax(fmax(r[0], r[1]), fmax(r[2], r[3])), low4 = fmin(fmin(r[0], r[1]), fmin(r[2], r[3]));
        // else the positive weights, 4.55 times the negative ones or more, prevail
        if (fmax(fmax(high4.x, high4.y), fmax(high4.z, high4.w)) <= 4.5f * fmin(fmin(low4.x, low4.y), fmin(low4.z, low4.w)))
            continue;
#pragma unroll
        for (int v = 0; v < 3; ++v) {
            const float4 wy = fabs(keys(0.3f + 0.2f * v));
            const float4 in = wy.y * r[1] + wy.z * r[2], out = wy.x * r[0] + wy.w * r[3];
#pragma unroll
            for (int u = 0; u < 3; ++u) {
                const float4 wx = fabs(keys(0.3f + 0.2f * u));
                const float with = wx.y * in.y + wx.z * in.z + (wx.x * out.x + wx.w * out.w);
                const float against = wx.y * out.y + wx.z * out.z + (wx.x * in.x + wx.w * in.w);
                if (against > with) least = fmin(least, fmax(2.0f * (with / against) - 1.0f, 0.0f));
            }
        }
    }
    room[y * cols + x] = least;
}

// Share of every sample that is interpolated by cubics: the most that the cells with a negative weight allow.
__kernel void shares(
    // in:
    __global const float *restrict room,  // [rows + 3][cols + 3]
    // out:
    __global float *restrict share,       // [rows][cols]
    // params:
    const int top, const int left,        // first sample whose share is computed; it is 1 elsewhere
    // sizes:
    const int rows, const int cols, const int high, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int pitch = cols + 3;
    __global const float *at = room + (size_t)y * pitch + x;
    const float down = fmin(fmin(at[1], at[2]), fmin(at[3 * pitch + 1], at[3 * pitch + 2]));
    const float across = fmin(fmin(at[pitch], at[2 * pitch]), fmin(at[pitch + 3], at[2 * pitch + 3]));
    const int computed = y >= top && y < top + high && x >= left && x < left + wide;
    share[y * cols + x] = computed ? fmin(down, across) : 1.0f;
}

// No light outside of a window.
__kernel void clear(
    // out:
    __global float *restrict out,
    // sizes:
    const int count, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    out[((size_t)p * rows + y) * cols + x] = 0.0f;
}

// Samples by their shares, see `pixel`.
__kernel void limited(
    // in:
    __global const float *restrict planes, __global const float *restrict lines, __global const float *restrict share,
    __global const float *restrict cover,  // [COVERS][source_rows][source_cols]; any array if COVERS is 0
    // out:
    __global float *restrict out,          // [maps PLANES + COVERS][rows][cols]
    // params:
    const int top, const int left,         // first of the pixels that are computed
    // sizes:
    const int source_rows, const int source_cols, const int nx, const int maps, const int rows, const int cols,
    const int high, const int wide)
{
    const int dx = get_global_id(0), dy = get_global_id(1), m = get_global_id(2), x = left + dx, y = top + dy;
    GUARD(dx >= wide || dy >= high || m >= maps)
    __global const float *line = lines + ((size_t)m * (2 * rows + 1) + 2 * y) * nx * 3;
    const float3 at = place(line + 3 * nx, 2 * x + 1, nx, cols);
    pixel(planes, line, share, cover, out, at, x, y, m, source_rows, source_cols, nx, maps, rows, cols);
}

#ifdef SPAN
__kernel void area(
    // in:
    __global const float *restrict planes, __global const float *restrict lines,
    // out:
    __global float *restrict out,
    // params:
    const float density,
    // sizes:
    const int source_rows, const int source_cols, const int nx, const int maps, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), m = get_global_id(2);
    GUARD(x >= cols || y >= rows || m >= maps)
    __global const float *above = lines + ((size_t)m * (2 * rows + 1) + 2 * y) * nx * 3, *under = above + 6 * nx;
    const float3 c00 = place(above, 2 * x, nx, cols);
    const float3 c10 = place(under, 2 * x, nx, cols);
    const float3 c11 = place(under, 2 * x + 2, nx, cols);
    const float3 c01 = place(above, 2 * x + 2, nx, cols);
    // corners from the first sample that the quadrilateral touches
    const float low_y = floor(fmin(fmin(c00.x, c01.x), 1.0f + fmin(c10.x, c11.x)));
    const float low_x = floor(fmin(fmin(c00.y, c10.y), 1.0f + fmin(c01.y, c11.y)));
    const float y00 = c00.x - low_y, y10 = 1.0f + (c10.x - low_y), y11 = 1.0f + (c11.x - low_y), y01 = c01.x - low_y;
    const float x00 = c00.y - low_x, x10 = c10.y - low_x, x11 = 1.0f + (c11.y - low_x), x01 = 1.0f + (c01.y - low_x);
    const int first_y = y + (int)low_y, first_x = x + (int)low_x;
    float total[PLANES];
#pragma unroll
    for (int p = 0; p < PLANES; ++p) total[p] = 0.0f;
    for (int a = 0; a < SPAN; ++a)
        for (int b = 0; b < SPAN; ++b) {
            const float overlap = below(y00 - a, x00 - b, y10 - a, x10 - b) + below(y10 - a, x10 - b, y11 - a, x11 - b)
                                + below(y11 - a, x11 - b, y01 - a, x01 - b) + below(y01 - a, x01 - b, y00 - a, x00 - b);
            const int sy = inside(first_y + a, source_rows, BORDER), sx = inside(first_x + b, source_cols, BORDER);
            const int dropped = BORDER == 0 && (sy != first_y + a || sx != first_x + b);
            // neighbours share their corners to rounding: one pixel's loss is the other's gain; below zero is rounding
            const float w = dropped ? 0.0f : fmax(overlap, 0.0f);
#pragma unroll
            for (int p = 0; p < PLANES; ++p)
                total[p] += w * planes[((size_t)(m * PLANES + p) * source_rows + sy) * source_cols + sx];
        }
#pragma unroll
    for (int p = 0; p < PLANES; ++p) out[((size_t)(m * PLANES + p) * rows + y) * cols + x] = density * total[p];
}
#endif
#endif
