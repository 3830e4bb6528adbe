#include "border.clh"

// Writes the planes and the pixels around them. On a CPU a work-item makes a row, and copies the frame's part of it in
// whole vectors, twice as fast as pixel by pixel.
__kernel void extend(
    // in:
    __global const float *restrict planes,  // [][rows][cols]
    // out:
    __global float *restrict extended,      // [count][period_y][period_x], the frame's corner at (before_y, before_x)
    // params:
    const int border, const int first, const int before_y, const int before_x,
    // sizes:
    const int count, const int rows, const int cols, const int period_y, const int period_x)
{
#ifdef GPU
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= period_x || y >= period_y || k >= count)
    const int begin = x, end = x + 1;
#else
    const int y = get_global_id(0), k = get_global_id(1), begin = 0, end = period_x;
#endif
    const int v = y - before_y;
    const int dark = border == 0 && (v < 0 || v >= rows);
    __global const float *source = planes + ((size_t)(first + k) * rows + inside(v, rows, border)) * cols - before_x;
    __global float *target = extended + ((size_t)k * period_y + y) * period_x;
    for (int i = begin; i < end; ++i) {
#ifndef GPU
        const int stop = min(before_x + cols, end);
        if (i >= before_x && !dark)
            for (; i + 8 <= stop; i += 8) vstore8(vload8(0, source + i), 0, target + i);
        if (i >= end) continue;
#endif
        const int out = dark || (border == 0 && (i < before_x || i >= before_x + cols));
        target[i] = out ? 0.0f : source[before_x + inside(i - before_x, cols, border)];
    }
}
