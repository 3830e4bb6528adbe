// The transforms are elsewhere (common/fft.py); these kernels cut into tiles and weigh, add up, put together: all
// memory-bound. `spread` adds highlights by direct sums.

#include "border.clh"

__kernel void weigh(
    // in:
    __global const float *restrict planes, __global const float *restrict coefficients,
    __global const int *restrict edges_y, __global const int *restrict edges_x,
    __global const int2 *restrict pairs,  // number of the tile, number of the term
    __global const int *restrict lights,  // number of each plane
    // out:
    __global float *restrict weighted,    // [lights][count][period_y][period_x]
    // params:
    const float threshold, const int begin, const int border,
    // sizes:
    const int rows, const int cols, const int tiles_x, const int count, const int size, const int period_y,
    const int period_x)
{
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= period_x || y >= period_y || k >= size)
    const int2 pair = pairs[begin + k % count];
    const int ty = pair.x / tiles_x, tx = pair.x % tiles_x, plane = lights[k / count];
    const int v = edges_y[ty] + y, u = edges_x[tx] + x;
    const int in_tile = v < edges_y[ty + 1] && u < edges_x[tx + 1];
    const int cy = clamp(v, 0, rows - 1), cx = clamp(u, 0, cols - 1);
    const float value = planes[((size_t)plane * rows + inside(v, rows, border)) * cols + inside(u, cols, border)];
    const float weight = coefficients[((size_t)pair.y * rows + cy) * cols + cx];
    const int kept = in_tile && value <= threshold && (border != 0 || (cy == v && cx == u));
    weighted[((size_t)k * period_y + y) * period_x + x] = kept ? weight * value : 0.0f;
}

__kernel void combine(
    // in:
    __global const float2 *restrict tables,   // [kernels][own][period_y][half]
    __global const float *restrict weights,   // [pairs][kernels]
    // out:
    __global float2 *restrict combined,       // [size / own][own][period_y][half]
    // params:
    const int begin,
    // sizes:
    const int kernels, const int own, const int size, const int period_y, const int half_x)
{
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= half_x || y >= period_y || k >= size)
    const size_t frame = (size_t)period_y * half_x, at = (size_t)y * half_x + x;
    float2 total = (float2)(0.0f, 0.0f);
    for (int j = 0; j < kernels; ++j)
        total += weights[(size_t)(begin + k / own) * kernels + j] * tables[((size_t)j * own + k % own) * frame + at];
    combined[k * frame + at] = total;
}

#ifdef CHANNELS
__kernel void accumulate(
    // in:
    __global const float2 *restrict spectra,  // [lights][pairs][period_y][pitch]
    __global const float2 *restrict tables,   // [kernels or pairs][own][period_y][half]
    __global const int *restrict kernel_of,   // number of each pair's kernel, if tables are of kernels
    __global const int *restrict ends,        // first pair of each tile
    __global const int *restrict light_of,    // number of each plane's light
    __global const float *restrict mix,       // [CHANNELS][planes]
    // out:
    __global float2 *restrict sums,           // [CHANNELS][tiles][period_y][pitch]
    // params:
    const int first, const int are_summed,
    // sizes:
    const int pairs, const int planes, const int tiles, const int period_y, const int half_x, const int pitch,
    const int own)
{
    const int x = get_global_id(0), y = get_global_id(1), t = get_global_id(2);
    GUARD(x >= half_x || y >= period_y || t >= tiles)
    const size_t at = (size_t)y * pitch + x, frame = (size_t)period_y * pitch;
    const int begin = ends[first], from = ends[first + t], to = ends[first + t + 1];
    float2 total[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) total[c] = (float2)(0.0f, 0.0f);
    for (int p = 0; p < planes; ++p) {
        const size_t of_light = (size_t)light_of[p] * pairs;
        float re = 0.0f, im = 0.0f;
        for (int k = from; k < to; ++k) {
            const float2 value = spectra[(of_light + k - begin) * frame + at];
            const size_t kernel_at = (size_t)(are_summed ? k - begin : kernel_of[k]) * own + min(p, own - 1);
            const float2 table = tables[(kernel_at * period_y + y) * half_x + x];
            re += table.x * value.x - table.y * value.y;
            im += table.x * value.y + table.y * value.x;
        }
        for (int c = 0; c < CHANNELS; ++c) total[c] += mix[c * planes + p] * (float2)(re, im);
    }
    for (int c = 0; c < CHANNELS; ++c) sums[(size_t)(c * tiles + t) * frame + at] = total[c];
}
#endif

__kernel void keep(
    // in:
    __global const float *restrict blurred,  // [channels][size][period_y][period_x]
    // out:
    __global float *restrict padded,         // [channels][tiles][period_y][period_x]
    // params:
    const int first,
    // sizes:
    const int channels, const int size, const int tiles, const int period_y, const int period_x)
{
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= period_x || y >= period_y || k >= channels * size)
    const size_t frame = (size_t)period_y * period_x, at = (size_t)y * period_x + x;
    padded[((size_t)(k / size) * tiles + first + k % size) * frame + at] = blurred[k * frame + at];
}

__kernel void assemble(
    // in:
    __global const float *restrict padded, __global const int *restrict edges_y, __global const int *restrict edges_x,
    __global const int2 *restrict cover_y, __global const int2 *restrict cover_x,  // first and last tile in reach
    __global const int *restrict slots,  // place of each tile in padded, or -1
    __global const float *base,
    // out:
    __global float *out,  // may be `base` if that is not added
    // params:
    const int reach_y, const int reach_x, const int add_base,
    // sizes:
    const int channels, const int rows, const int cols, const int filled, const int tiles_x, const int period_y,
    const int period_x)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    GUARD(x >= cols || y >= rows || c >= channels)
    float total = 0.0f;
    for (int i = cover_y[y].x; i <= cover_y[y].y; ++i)
        for (int j = cover_x[x].x; j <= cover_x[x].y; ++j) {
            const int slot = slots[i * tiles_x + j];
            if (slot < 0) continue;
            const size_t tile = (size_t)c * filled + slot;
            total += padded[(tile * period_y + y - edges_y[i] + reach_y) * period_x + x - edges_x[j] + reach_x];
        }
    const size_t at = ((size_t)c * rows + y) * cols + x;
    out[at] = add_base ? base[at] + total : total;
}

__kernel void spread(
    // in:
    __global const int2 *restrict places,    // row, column
    __global const float *restrict kernels,  // [places][channels][m][n]
    __global const int2 *restrict corners,   // of the 32 x 32 squares that are in reach of any
    __global const int *restrict starts, __global const int *restrict listed,  // the places in reach of each square
    // out:
    __global float *restrict out,
    // sizes:
    const int channels, const int rows, const int cols, const int m, const int n, const int squares)
{
    const int dx = get_global_id(0), dy = get_global_id(1), c = get_global_id(2), bin = dy / 32;
    GUARD(dx >= 32 || bin >= squares || c >= channels)
    const int y = corners[bin].x + dy % 32, x = corners[bin].y + dx;
    float total = 0.0f;
    for (int i = starts[bin]; i < starts[bin + 1]; ++i) {
        const int k = listed[i], a = y - places[k].x + m / 2, b = x - places[k].y + n / 2;
        if (a >= 0 && a < m && b >= 0 && b < n) total += kernels[((size_t)(k * channels + c) * m + a) * n + b];
    }
    if (y < rows && x < cols) out[((size_t)c * rows + y) * cols + x] += total;
}
