// A work-item does `run` pairs of one row (bayer.clh). The loop over the inner pairs has plain indices, so LLVM
// vectorises it; only the pairs at the ends mirror. Rows are mirrored once per item.
#include "bayer.clh"

__attribute__((always_inline)) inline void pair(
    __global const ushort *restrict up, __global const ushort *restrict here, __global const ushort *restrict down,
    const long a, const long b, const long c, const long d,  // columns x - 1, x, x + 1, x + 2
    const bool store_own, const bool store_green, const float black_level, const float scale,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
    // whole numbers: exact, and cheaper to widen than to convert one by one
    if (store_own) {
        own[b] = ((float)here[b] - black_level) * scale;
        green[b] = (0.25f * (float)(here[a] + here[c] + up[b] + down[b]) - black_level) * scale;
        other[b] = (0.25f * (float)(up[a] + up[c] + down[a] + down[c]) - black_level) * scale;
    }
    if (store_green) {
        own[c] = (0.5f * (float)(here[b] + here[d]) - black_level) * scale;
        green[c] = ((float)here[c] - black_level) * scale;
        other[c] = (0.5f * (float)(up[c] + down[c]) - black_level) * scale;
    }
}

__kernel void bilinear(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    // out:
    __global float *restrict rgb,         // [3][rows][cols]
    // params:
    const float black_level, const float scale,
    const int red_row, const int red_col,
    // sizes:
    const int run, const int rows, const int cols)
{
    const int y = get_global_id(1);
    long q = get_global_id(0) * run;
    if (y >= rows) return;
    const bool red = is_red_row(y, red_row);
    const int first = first_own(y, red_row, red_col);
    const size_t pixels = (size_t)rows * cols;
    __global const ushort *here = raw + (size_t)y * cols;
    __global const ushort *up = raw + (size_t)mirror(y - 1, rows) * cols;
    __global const ushort *down = raw + (size_t)mirror(y + 1, rows) * cols;
    __global float *green = rgb + pixels + (size_t)y * cols;
    __global float *own = red ? green - pixels : green + pixels;
    __global float *other = red ? green + pixels : green - pixels;

    const long end = min(q + run, (cols + first + 1L) / 2);
    const long inner_end = min(end, max(1L, (cols - 1L + first) / 2));  // below it x + 2 < cols
    while (q < end) {
        if (q > 0)  // here x - 1 >= 0
            for (; q < inner_end; ++q) {
                const long x = 2 * q - first;
                pair(up, here, down, x - 1, x, x + 1, x + 2, true, true, black_level, scale, own, green, other);
            }
        if (q < end) {
            const long x = 2 * q - first;
            pair(up, here, down, mirror(x - 1, cols), mirror(x, cols), mirror(x + 1, cols), mirror(x + 2, cols),
                 x >= 0, x + 1 < cols, black_level, scale, own, green, other);
            ++q;
        }
    }
}
