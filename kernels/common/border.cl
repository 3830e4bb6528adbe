// What lies outside the frame, written out so that a transform can go over it.
#include "border.clh"

__kernel void extend(
    // in:
    __global const float *restrict planes,
    // out:
    __global float *restrict extended,
    // params:
    const int first, const int border, const int before_y, const int before_x,
    // sizes:
    const int rows, const int cols, const int size, const int period_y, const int period_x)
{
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= period_x || y >= period_y || k >= size)
    const int v = y - before_y, u = x - before_x;
    const int inside = u >= 0 && u < cols && v >= 0 && v < rows;
    const int sy = border == 2 ? reflected(v, rows) : clamp(v, 0, rows - 1);
    const int sx = border == 2 ? reflected(u, cols) : clamp(u, 0, cols - 1);
    const float value = planes[((size_t)(first + k) * rows + sy) * cols + sx];
    extended[((size_t)k * period_y + y) * period_x + x] = inside || border != 0 ? value : 0.0f;
}
