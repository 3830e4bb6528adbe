// `widen` interpolates the nodes along rows, once for each row of nodes and each row phase of the mosaic; `shade` then
// blends two such lines, whose columns have the right channels already. Places between nodes are counted in integers:
// node m of n lies at pixel m size / (n - 1), pixel i at i + 1/2.
inline int node_before(const int i, const int nodes, const int size, float *fraction)
{
    const int place = (2 * i + 1) * (nodes - 1), before = place / (2 * size);
    *fraction = (float)(place - before * 2 * size) / (float)(2 * size);
    return before;
}

__kernel void widen(
    // in:
    __global const float *restrict gains,  // [channels][ny][nx]
    __global const int *restrict cfa,      // [period_y][period_x]
    // out:
    __global float *restrict lines,        // [period_y][ny][cols]
    // sizes:
    const int period_y, const int period_x, const int ny, const int nx, const int cols)
{
    const int x = get_global_id(0), j = get_global_id(1), phase = get_global_id(2);
    GUARD(x >= cols || j >= ny || phase >= period_y)
    float t;
    const int i = node_before(x, nx, cols, &t);
    __global const float *nodes = gains + (cfa[phase * period_x + x % period_x] * ny + j) * nx + i;
    lines[(size_t)(phase * ny + j) * cols + x] = (1.0f - t) * nodes[0] + t * nodes[1];
}

__kernel void shade(
    // in:
    __global const ushort *restrict raw,   // [rows][cols]
    __global const float *restrict lines,  // [period_y][ny][cols]
    // out:
    __global ushort *restrict out,         // [rows][cols]
    // params:
    const float black_level, const float scale, const float new_black,
    // sizes:
    const int period_y, const int ny, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    float t;
    const int j = node_before(y, ny, rows, &t);
    const size_t pixel = (size_t)y * cols + x;
    __global const float *line = lines + (size_t)(y % period_y * ny + j) * cols;
    const float gain = (1.0f - t) * line[x] + t * line[cols + x];
    const float value = new_black + gain * (((float)raw[pixel] - black_level) * scale);
    out[pixel] = (ushort)(int)(fmin(fmax(value, 0.0f), 65535.0f) + 0.5f);
}
