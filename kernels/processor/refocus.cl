// A work-item makes LINES rows: a GPU's of one column, with its sums in registers; a CPU's whole rows, 8 columns at once,
// view by view, with its sums in the result, which stays in the nearest cache. Each row of a view is interpolated along
// the columns once, for the four rows of the result that need it.
// From the host: CPU (0 or 1), WIDTH (8 on CPUs), LINES, MOMENTS (1: mean, 2: variance too).
#include "lanes.clh"

#define FARTHEST 1e6f  // [pixel] of a displacement

#if WIDTH == 8
#define NEIGHBOURS(from) vload8(0, from)
#else
#define NEIGHBOURS(from) (*(from))
#endif

// Weights of the samples at -1, 0, 1, 2 at 0 <= s < 1, after Keys.
INLINE void keys(const float s, float *weights)
{
    const float r = 1.0f - s;
    weights[0] = -0.5f * s * r * r;
    weights[1] = 1.0f - s * s * (2.5f - 1.5f * s);
    weights[2] = 1.0f - r * r * (2.5f - 1.5f * r);
    weights[3] = -0.5f * s * s * r;
}

// LINES rows of a plane, from the place (top, left) of the first of 4 x 4 taps on. The edges continue.
INLINE void interpolate(__global const float *restrict plane, const int top, const int left, const float *wy,
                        const float *wx, const int rows, const int cols, real *values)
{
    const bool inside = left >= 0 && left + WIDTH + 3 <= cols;
#pragma unroll
    for (int r = 0; r < LINES; ++r) values[r] = 0.0f;
#pragma unroll
    for (int line = 0; line < LINES + 3; ++line) {
        __global const float *from = plane + (size_t)clamp(top + line, 0, rows - 1) * cols;
        real along;
        if (inside) {
            from += left;
            along = wx[0] * NEIGHBOURS(from) + wx[1] * NEIGHBOURS(from + 1) + wx[2] * NEIGHBOURS(from + 2)
                + wx[3] * NEIGHBOURS(from + 3);
        } else {
            float taps[WIDTH + 3];
            for (int b = 0; b < WIDTH + 3; ++b) taps[b] = from[clamp(left + b, 0, cols - 1)];
            along = wx[0] * NEIGHBOURS(taps) + wx[1] * NEIGHBOURS(taps + 1) + wx[2] * NEIGHBOURS(taps + 2)
                + wx[3] * NEIGHBOURS(taps + 3);
        }
#pragma unroll
        for (int a = 0; a < 4; ++a)
            if (line - a >= 0 && line - a < LINES) values[line - a] += wy[a] * along;
    }
}

__kernel void refocus(
    // in:
    __global const float *restrict views,    // [count][planes][rows][cols]
    __global const float *restrict places,   // [count][2]
    __global const float *restrict weights,  // [count]
    __global const float *restrict slopes,   // [pictures]
    // out:
    __global float *restrict out,            // [pictures][MOMENTS planes][rows][cols]
    // sizes:
    const int pictures, const int moments, const int count, const int planes, const int rows, const int cols)
{
    const int column = get_global_id(0), y = LINES * get_global_id(1), plane = get_global_id(2);
    GUARD(column >= cols || y >= rows || plane >= pictures * planes)
    const int p = plane % planes, tall = min(LINES, rows - y);
    const float slope = slopes[plane / planes];
    const size_t size = (size_t)rows * cols, moment = planes * size;
    __global float *to = out + (plane / planes * MOMENTS * planes + p) * size + (size_t)y * cols;
    // differences to one view keep the digits of a variance that is small
    __global const float *middle = views + ((size_t)(count / 2) * planes + p) * size + (size_t)y * cols;
    real values[LINES];
    float wy[4], wx[4], total = 0.0f;
#if CPU
    for (int i = 0; i < tall * cols; ++i) to[i] = 0.0f;
    if (MOMENTS == 2)
        for (int i = 0; i < tall * cols; ++i) to[moment + i] = 0.0f;
#else
    float sums[LINES], squares[LINES], offsets[LINES];
#pragma unroll
    for (int r = 0; r < LINES; ++r) {
        sums[r] = squares[r] = 0.0f;
        offsets[r] = MOMENTS == 2 && r < tall ? middle[(size_t)r * cols + column] : 0.0f;
    }
#endif
    for (int v = 0; v < count; ++v) {
        const float weight = weights[v];
        if (weight == 0.0f) continue;
        total += weight;
        const float down = clamp(slope * places[2 * v], -FARTHEST, FARTHEST);
        const float right = clamp(slope * places[2 * v + 1], -FARTHEST, FARTHEST);
        const float whole_y = floor(down), whole_x = floor(right);
        keys(down - whole_y, wy);
        keys(right - whole_x, wx);
        __global const float *view = views + ((size_t)v * planes + p) * size;
        const int top = y + (int)whole_y - 1, left = (int)whole_x - 1;
#if CPU
        for (int x = 0; x < cols; x += WIDTH) {
            const int lanes = min(WIDTH, cols - x);
            interpolate(view, top, left + x, wy, wx, rows, cols, values);
            for (int r = 0; r < tall; ++r) {
                const size_t at = (size_t)r * cols + x;
                real value = values[r];
                if (MOMENTS == 2) {
                    value -= load(middle + at, lanes);
                    const real square = load(to + moment + at, lanes) + weight * value * value;
                    STORE(float, square, to + moment + at, lanes)
                }
                const real sum = load(to + at, lanes) + weight * value;
                STORE(float, sum, to + at, lanes)
            }
        }
#else
        interpolate(view, top, left + column, wy, wx, rows, cols, values);
#pragma unroll
        for (int r = 0; r < LINES; ++r) {
            const float value = values[r] - offsets[r];
            sums[r] += weight * value;
            if (MOMENTS == 2) squares[r] += weight * value * value;
        }
#endif
    }
#if CPU
    for (int i = 0; i < tall * cols; ++i) {
        const float mean = to[i] / total;
        if (MOMENTS == 2) {
            to[moment + i] = max(to[moment + i] / total - mean * mean, 0.0f);
            to[i] = middle[i] + mean;
        } else
            to[i] = mean;
    }
#else
    for (int r = 0; r < tall; ++r) {
        const size_t at = (size_t)r * cols + column;
        const float mean = sums[r] / total;
        to[at] = offsets[r] + mean;
        if (MOMENTS == 2) to[moment + at] = max(squares[r] / total - mean * mean, 0.0f);
    }
#endif
}
