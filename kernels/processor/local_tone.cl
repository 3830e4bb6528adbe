// The light of blocks in stops, a guided filter on them, and the gain of each pixel. REACH comes from the host.
#include "nodes.clh"

__kernel void measure_blocks(
    // in:
    __global const float *restrict rgb,        // [3][rows][cols]
    __global const float *restrict luminance,  // [3]
    // out:
    __global float *restrict base,             // [ny][nx]
    // params:
    const float darkest,
    // sizes:
    const int size, const int rows, const int cols, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1);
    GUARD(i >= nx || j >= ny)
    const long pixels = (long)rows * cols;
    const int end_y = min((j + 1) * size, rows), end_x = min((i + 1) * size, cols);
    float sum = 0.0f;
    int count = 0;
    for (int y = j * size; y < end_y; ++y)
        for (int x = i * size; x < end_x; ++x) {
            const long at = (long)y * cols + x;
            const float light =
                luminance[0] * rgb[at] + luminance[1] * rgb[pixels + at] + luminance[2] * rgb[2 * pixels + at];
            const bool is_finite = fabs(light) <= FLT_MAX;  // NaN compares false
            sum += is_finite ? light : 0.0f;
            count += is_finite;
        }
    base[(long)j * nx + i] = log2(fmax(sum / max(count, 1), 0.0f) + darkest);
}

__kernel void add_rows(
    // in:
    __global const float *restrict base,  // [ny][nx]
    // out:
    __global float *restrict lines,       // [2][ny][nx], means of values and squares
    // sizes:
    const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1);
    GUARD(i >= nx || j >= ny)
    const int first = max(i - REACH, 0), last = min(i + REACH, nx - 1);
    float sum = 0.0f, squares = 0.0f;
    for (int x = first; x <= last; ++x) {
        const float value = base[(long)j * nx + x];
        sum += value;
        squares += value * value;
    }
    const long block = (long)j * nx + i, count = last - first + 1;
    lines[block] = sum / count;
    lines[(long)ny * nx + block] = squares / count;
}

__kernel void fit(
    // in:
    __global const float *restrict lines,  // [2][ny][nx]
    // out:
    __global float *restrict fitted,       // [2][ny][nx], slope and offset
    // params:
    const float edge,
    // sizes:
    const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1);
    GUARD(i >= nx || j >= ny)
    const int first = max(j - REACH, 0), last = min(j + REACH, ny - 1);
    const long blocks = (long)ny * nx, block = (long)j * nx + i;
    float sum = 0.0f, squares = 0.0f;
    for (int y = first; y <= last; ++y) {
        sum += lines[(long)y * nx + i];
        squares += lines[blocks + (long)y * nx + i];
    }
    const float mean = sum / (last - first + 1);
    const float variance = fmax(squares / (last - first + 1) - mean * mean, 0.0f);
    const float slope = variance / (variance + edge);
    fitted[block] = slope;
    fitted[blocks + block] = (1.0f - slope) * mean;
}

__kernel void mean_rows(
    // in:
    __global const float *restrict values,  // [planes][ny][nx]
    // out:
    __global float *restrict lines,         // [planes][ny][nx]
    // sizes:
    const int planes, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1), p = get_global_id(2);
    GUARD(i >= nx || j >= ny || p >= planes)
    const int first = max(i - REACH, 0), last = min(i + REACH, nx - 1);
    __global const float *line = values + ((long)p * ny + j) * nx;
    float sum = 0.0f;
    for (int x = first; x <= last; ++x) sum += line[x];
    lines[((long)p * ny + j) * nx + i] = sum / (last - first + 1);
}

__kernel void mean_columns(
    // in:
    __global const float *restrict lines,  // [planes][ny][nx]
    // out:
    __global float *restrict smooth,       // [planes][ny][nx]
    // sizes:
    const int planes, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1), p = get_global_id(2);
    GUARD(i >= nx || j >= ny || p >= planes)
    const int first = max(j - REACH, 0), last = min(j + REACH, ny - 1);
    __global const float *plane = lines + (long)p * ny * nx + i;
    float sum = 0.0f;
    for (int y = first; y <= last; ++y) sum += plane[(long)y * nx];
    smooth[((long)p * ny + j) * nx + i] = sum / (last - first + 1);
}

__kernel void lift(
    // in:
    __global const float *restrict rgb,        // [3][rows][cols]
    __global const float *restrict luminance,  // [3]
    __global const float *restrict smooth,     // [2][ny][nx]
    // out:
    __global float *restrict out,              // [3][rows][cols]
    // params:
    const float strength, const float per_shadow, const float dark, const float darkest,
    // sizes:
    const int size, const int rows, const int cols, const int ny, const int nx)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const long pixels = (long)rows * cols, at = (long)y * cols + x;
    const float red = rgb[at], green = rgb[pixels + at], blue = rgb[2 * pixels + at];
    const float light = luminance[0] * red + luminance[1] * green + luminance[2] * blue;
    const float down = (y + 0.5f) / size - 0.5f, across = (x + 0.5f) / size - 0.5f;
    const float slope = between(smooth, ny, nx, down, across);
    const float offset = between(smooth + (long)ny * nx, ny, nx, down, across);
    const float base = slope * log2(fmax(light, 0.0f) + darkest) + offset;
    const float around = fmax(exp2(base) - darkest, 0.0f), square = around * around;
    const float relative = around * per_shadow;
    const float seen = square + dark > 0.0f ? square / (square + dark) : 1.0f;
    const float found = 1.0f + strength / (1.0f + relative * relative) * seen;
    const float gain = fabs(light) <= FLT_MAX ? found : 1.0f;
    out[at] = gain * red;
    out[pixels + at] = gain * green;
    out[2 * pixels + at] = gain * blue;
}
