// A work-item makes `run` columns, WIDTH at a time, of ROWS rows, as in bilinear.cl. The separate stages do the same
// operations in the same order, so the codes are the same. From the host: WIDTH (1, 4 or 8), ROWS, ELECTRONS, and the
// defines of codes.clh.
#include "bilinear.clh"
#include "codes.clh"

__kernel void develop(
    // in:
    __global const Sample *restrict raw,     // [rows][cols]
    __global const float *restrict matrix,   // [3][3]
    __global const float *restrict ceiling,  // [3]
    __global const uint *restrict entries,   // of the table
    // out:
    __global uchar *restrict out,            // [rows][cols][3]
    // params:
    const float gain, const float offset, const float most,
    const float black_level, const float scale, const int red_row, const int red_col,
    const float bottom, const float top, const int shift,
    // sizes:
    const int run, const int rows, const int cols)
{
    const Mosaic mosaic = {raw, rows, cols, gain, offset, most};
    const Codes table = {entries, bottom, top, shift};
    const int begin = get_global_id(0) * run, end = min(begin + run, cols), first_row = get_global_id(1) * ROWS;
    GUARD(first_row >= rows)
    for (int x = begin; x < end; x += WIDTH) {
        Line up = line(mosaic, first_row - 1, x), here = line(mosaic, first_row, x);
#pragma unroll
        for (int y = first_row; y < first_row + ROWS; ++y) {
            const Line down = line(mosaic, y + 1, x);
            if (y < rows) {  // an early end of the loop would keep it from being unrolled
                const bool is_red = is_red_row(y, red_row);
                const Colors colors = interpolated(up, here, down, x, first_own(y, red_row, red_col), black_level,
                                                   scale);
                const real camera[3] = {is_red ? colors.own : colors.other, colors.green,
                                        is_red ? colors.other : colors.own};
                real red = 0.0f, green = 0.0f, blue = 0.0f;
#pragma unroll
                for (int c = 0; c < 3; ++c) {
                    const real clipped = camera[c] > ceiling[c] ? (real)ceiling[c] : camera[c];
                    red += matrix[c] * clipped;
                    green += matrix[3 + c] * clipped;
                    blue += matrix[6 + c] * clipped;
                }
                __global uchar *to = out + 3 * ((size_t)y * cols + x);
#if WIDTH == 4
                store_codes(codes(table, red), codes(table, green), codes(table, blue), to);
#else
#if WIDTH == 8
                if (x + WIDTH <= end) {
                    store_codes(codes(table, red.lo), codes(table, green.lo), codes(table, blue.lo), to);
                    store_codes(codes(table, red.hi), codes(table, green.hi), codes(table, blue.hi), to + 12);
                } else
#endif
                    for (int lane = 0; lane < min(WIDTH, end - x); ++lane) {
                        to[3 * lane] = code(table, ((float *)&red)[lane]);
                        to[3 * lane + 1] = code(table, ((float *)&green)[lane]);
                        to[3 * lane + 2] = code(table, ((float *)&blue)[lane]);
                    }
#endif
            }
            up = here;
            here = down;
        }
    }
}
