// A work-item makes `run` columns, WIDTH at a time, of ROWS rows: one column or four on GPUs, where neighbouring items
// then load and store neighbouring values. From the host: WIDTH (1, 4 or 8), ROWS.
#include "bilinear.clh"

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
    const Mosaic mosaic = {raw, rows, cols, 0.0f, 0.0f, 0.0f};
    const int begin = get_global_id(0) * run, end = min(begin + run, cols), top = get_global_id(1) * ROWS;
    GUARD(top >= rows)
    const size_t pixels = (size_t)rows * cols;
    for (int x = begin; x < end; x += WIDTH) {
        Line up = line(mosaic, top - 1, x), here = line(mosaic, top, x);
#pragma unroll
        for (int y = top; y < top + ROWS; ++y) {
            const Line down = line(mosaic, y + 1, x);
            if (y < rows) {  // an early end of the loop would keep it from being unrolled
                const bool red = is_red_row(y, red_row);
                const Colors colors = interpolated(up, here, down, x, first_own(y, red_row, red_col), black_level,
                                                   scale);
                const int lanes = min(WIDTH, end - x);
                __global float *to = rgb + (size_t)y * cols + x;
                STORE(float, colors.own, to + (red ? 0 : 2 * pixels), lanes)
                STORE(float, colors.green, to + pixels, lanes)
                STORE(float, colors.other, to + (red ? 2 * pixels : 0), lanes)
            }
            up = here;
            here = down;
        }
    }
}
