// One pixel of all PLANES that share a grid per work-item: its place and weights are found once.
// Places stay differences from the pixel's own index: float32 then keeps its fractions.

#include "border.clh"

#ifdef PLANES
float4 keys(const float s)  // weights of the samples -1, 0, 1, 2 at s in 0 .. 1
{
    const float r = 1.0f - s;
    return 0.5f * (float4)(-s * r * r, 2.0f - s * s * (5.0f - 3.0f * s), 2.0f - r * r * (5.0f - 3.0f * r), -r * s * s);
}

// First of four nodes and the weights of all for half-pixel number `half_steps` of 2 n, 0 the frame's edge. Whole numbers
// while possible: the fraction is then equally exact in the first and the last cell.
int nodes(const int half_steps, const int n, const int count, float *weights)
{
    const int at = half_steps * (count - 1);
    const int first = clamp((int)(at * (0.5f / n)) - 1, 0, count - 4);
    const float s = (at - first * 2 * n) * (0.5f / n), s1 = s - 1.0f, s2 = s - 2.0f, s3 = s - 3.0f;
    weights[0] = s1 * s2 * s3 * (-1.0f / 6.0f);
    weights[1] = s * s2 * s3 * 0.5f;
    weights[2] = s * s1 * s3 * -0.5f;
    weights[3] = s * s1 * s2 * (1.0f / 6.0f);
    return first;
}

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

// Values at half-pixel column half_x of a line: row difference, column difference, flux factor.
float3 place(__global const float *restrict line, const int half_x, const int nx, const int cols)
{
    float w[4];
    const int j = nodes(half_x, cols, nx, w);
    __global const float *restrict at = line + j * 3;
    float v = 0.0f, u = 0.0f, flux = 0.0f;
#pragma unroll
    for (int b = 1; b < 4; ++b) {
        v += w[b] * (at[b * 3] - at[0]);
        u += w[b] * (at[b * 3 + 1] - at[1]);
        flux += w[b] * (at[b * 3 + 2] - at[2]);
    }
    return (float3)(at[0] + v, at[1] + u, at[2] + flux);
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

float mean_clamped(const float t0, const float t1)  // mean of clamp(t, 0, 1) over t between t0 and t1
{
    // (difference of the antiderivatives) / (t1 - t0), arranged without cancellation for t1 close to t0
    const float low = fmin(t0, t1), high = fmax(t0, t1), d = high - low;
    const float a = clamp(low, 0.0f, 1.0f), b = clamp(high, 0.0f, 1.0f);
    const float sum = (b - a) * (0.5f * (a + b)) + (fmax(high, 1.0f) - fmax(low, 1.0f));
    return d > 0.0f ? sum / d : a;
}

// Signed area within the unit square between its lower side and the edge (x0, y0) -> (x1, y1).
float below(const float y0, const float x0, const float y1, const float x1)
{
    const float d = x1 - x0, a = clamp(x0, 0.0f, 1.0f), b = clamp(x1, 0.0f, 1.0f);
    const float per = d != 0.0f ? 1.0f / d : 0.0f;
    const float t0 = clamp((a - x0) * per, 0.0f, 1.0f), t1 = clamp((b - x0) * per, 0.0f, 1.0f);
    return (b - a) * mean_clamped(y0 + t0 * (y1 - y0), y0 + t1 * (y1 - y0));
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

#ifndef COVERS
#define COVERS 0
#endif
// 4 x 4 samples: neighbours, or folded back at the border. rows: where these begin; columns: from there on.
void load(__global const float *restrict plane, const int is_inside, const int4 rows, const int4 columns, float4 *values)
{
    const int row[4] = {rows.x, rows.y, rows.z, rows.w};
    if (is_inside) {
#pragma unroll
        for (int k = 0; k < 4; ++k) values[k] = vload4(0, plane + row[k] + columns.x);
    } else {
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            __global const float *at = plane + row[k];
            values[k] = (float4)(at[columns.x], at[columns.y], at[columns.z], at[columns.w]);
        }
    }
}

// Whether light comes from line i of n. (NVIDIA 580 mistook line numbers that were compared with clamped ones.)
float lit(const int i, const int n) { return BORDER != 0 || (i >= 0 && i < n) ? 1.0f : 0.0f; }

float total_of(const float4 *values, const float *weights)
{
    float4 total = (float4)(0.0f);
#pragma unroll
    for (int k = 0; k < 4; ++k) total += vload4(k, weights) * values[k];
    return (total.x + total.y) + (total.z + total.w);
}

// As `cubic`, of each sample's share; the rest of it by area, over the 4 x 4 samples that the cubic takes.
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
    const float floor_y = floor(at.x), floor_x = floor(at.y);
    const int first_y = y + (int)floor_y - 1, first_x = x + (int)floor_x - 1;
    const float4 wy = keys(at.x - floor_y), wx = keys(at.y - floor_x);
    const float in_y[4] = {wy.x, wy.y, wy.z, wy.w};
    const int is_inside = first_y >= 0 && first_x >= 0 && first_y + 4 <= source_rows && first_x + 4 <= source_cols;
#if !COVERS
    if (is_inside) {
        __global const float *of_light = share + (size_t)first_y * source_cols + first_x;
        const float4 all = fmin(fmin(vload4(0, of_light), vload4(0, of_light + source_cols)),
                                fmin(vload4(0, of_light + 2 * source_cols), vload4(0, of_light + 3 * source_cols)));
        if (fmin(fmin(all.x, all.y), fmin(all.z, all.w)) >= 1.0f) {  // nearly everywhere: as `cubic`
#pragma unroll
            for (int p = 0; p < PLANES; ++p) {
                __global const float *source = planes + ((size_t)(m * PLANES + p) * source_rows + first_y) * source_cols + first_x;
                const float4 sums = wy.x * vload4(0, source) + wy.y * vload4(0, source + source_cols) +
                                    wy.z * vload4(0, source + 2 * source_cols) + wy.w * vload4(0, source + 3 * source_cols);
                out[((size_t)(m * PLANES + p) * rows + y) * cols + x] = at.z * dot(sums, wx);
            }
            return;
        }
    }
#endif
    const int4 at_x = first_x + (int4)(0, 1, 2, 3);
    const int4 sx = (int4)(inside(at_x.x, source_cols, BORDER), inside(at_x.y, source_cols, BORDER),
                           inside(at_x.z, source_cols, BORDER), inside(at_x.w, source_cols, BORDER));
    const float4 lit_x = (float4)(lit(at_x.x, source_cols), lit(at_x.y, source_cols), lit(at_x.z, source_cols),
                                  lit(at_x.w, source_cols));
    float w[16], rest[16];
    float4 lowest = (float4)(1.0f), values[4];
    int line_of[4];
#if COVERS
    float of_cover[16], parts[16];
#endif
#pragma unroll
    for (int k = 0; k < 4; ++k) line_of[k] = inside(first_y + k, source_rows, BORDER) * source_cols;
    const int4 from = (int4)(line_of[0], line_of[1], line_of[2], line_of[3]);
    load(share, is_inside, from, sx, values);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const float4 part = values[k];
        const float4 kept = lit(first_y + k, source_rows) * lit_x;
        lowest = fmin(lowest, part);
        vstore4(at.z * in_y[k] * wx * part * kept, k, w);
        vstore4((1.0f - part) * kept, k, rest);
#if COVERS
        vstore4(part, k, parts);
        vstore4(in_y[k] * wx * part, k, of_cover);  // coverage goes on beyond a dark border
#endif
    }
    const float least = fmin(fmin(lowest.x, lowest.y), fmin(lowest.z, lowest.w));
    if (least < 1.0f) {  // rarely
        const float3 c00 = place(line, 2 * x, nx, cols);
        const float3 c10 = place(line + 6 * nx, 2 * x, nx, cols);
        const float3 c11 = place(line + 6 * nx, 2 * x + 2, nx, cols);
        const float3 c01 = place(line, 2 * x + 2, nx, cols);
        // corners from the first sample
        const float y00 = c00.x - floor_y + 1.0f, y10 = c10.x - floor_y + 2.0f;
        const float y11 = c11.x - floor_y + 2.0f, y01 = c01.x - floor_y + 1.0f;
        const float x00 = c00.y - floor_x + 1.0f, x10 = c10.y - floor_x + 1.0f;
        const float x11 = c11.y - floor_x + 2.0f, x01 = c01.y - floor_x + 2.0f;
        const float top_y = fmin(fmin(y00, y01), fmin(y10, y11)), end_y = fmax(fmax(y00, y01), fmax(y10, y11));
        const float top_x = fmin(fmin(x00, x01), fmin(x10, x11)), end_x = fmax(fmax(x00, x01), fmax(x10, x11));
        float overlaps[16], whole = 0.0f;
        for (int k = 0; k < 16; ++k) {
            const float a = k / 4, b = k % 4;
            overlaps[k] = 0.0f;
            if (a >= end_y || b >= end_x || a + 1.0f <= top_y || b + 1.0f <= top_x) continue;
            const float overlap = below(y00 - a, x00 - b, y10 - a, x10 - b) + below(y10 - a, x10 - b, y11 - a, x11 - b)
                                + below(y11 - a, x11 - b, y01 - a, x01 - b) + below(y01 - a, x01 - b, y00 - a, x00 - b);
            overlaps[k] = fmax(overlap, 0.0f);
            whole += overlaps[k];
        }
        const float per = at.z / whole;
        for (int k = 0; k < 16; ++k) w[k] += per * overlaps[k] * rest[k];
#if COVERS
        for (int k = 0; k < 16; ++k) of_cover[k] += overlaps[k] / whole * (1.0f - parts[k]);
#endif
    }
#if COVERS
    for (int p = 0; m == 0 && p < COVERS; ++p) {  // by the first grid
        load(cover + (size_t)p * source_rows * source_cols, is_inside, from, sx, values);
        out[((size_t)(maps * PLANES + p) * rows + y) * cols + x] = total_of(values, of_cover);
    }
    load(cover, is_inside, from, sx, values);
#pragma unroll
    for (int k = 0; k < 4; ++k) vstore4(vload4(k, w) * values[k], k, w);
#endif
#pragma unroll
    for (int p = 0; p < PLANES; ++p) {
        load(planes + (size_t)(m * PLANES + p) * source_rows * source_cols, is_inside, from, sx, values);
        out[((size_t)(m * PLANES + p) * rows + y) * cols + x] = total_of(values, w);
    }
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
