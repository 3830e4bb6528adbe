// PLANES planes of a map share its places and weights.
#include "nodes.clh"

inline void weigh(const float t, float *weights)  // Keys's cubic at -1 - t, -t, 1 - t, 2 - t
{
    weights[0] = ((-0.5f * t + 1.0f) * t - 0.5f) * t;
    weights[1] = (1.5f * t - 2.5f) * t * t + 1.0f;
    weights[2] = ((-1.5f * t + 2.0f) * t + 0.5f) * t;
    weights[3] = (0.5f * t - 0.5f) * t * t;
}

__kernel void rectify(
    // in:
    __global const float *restrict planes,  // [maps][PLANES][rows][cols]
    __global const float *restrict nodes,   // [maps 2][ny][nx], down and across
    // out:
    __global float *restrict out,           // [maps][PLANES][rows][cols]
    // sizes:
    const int rows, const int cols, const int ny, const int nx)
{
    const int x = get_global_id(0), y = get_global_id(1), map = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    const float down = (y + 0.5f) * (ny - 1) / rows, across = (x + 0.5f) * (nx - 1) / cols;
    __global const float *offsets = nodes + 2L * map * ny * nx;
    const float moved_y = between(offsets, ny, nx, down, across);
    const float moved_x = between(offsets + (long)ny * nx, ny, nx, down, across);
    const float low_y = floor(moved_y), low_x = floor(moved_x);
    float weights_y[4], weights_x[4];
    weigh(moved_y - low_y, weights_y);
    weigh(moved_x - low_x, weights_x);
    const int first_y = y + (int)low_y - 1, first_x = x + (int)low_x - 1;
    const bool is_inside = first_x >= 0 && first_x <= cols - 4;  // four neighbours in memory
    int col[4];
#pragma unroll
    for (int b = 0; b < 4; ++b) col[b] = clamp(first_x + b, 0, cols - 1);
    const long pixels = (long)rows * cols, first = (long)map * PLANES * pixels;
#pragma unroll
    for (int p = 0; p < PLANES; ++p) {
        float4 down_columns = 0.0f;
#pragma unroll
        for (int a = 0; a < 4; ++a) {
            __global const float *line =
                planes + first + p * pixels + (long)clamp(first_y + a, 0, rows - 1) * cols;
            float4 four;
            if (is_inside) four = vload4(0, line + first_x);
            else four = (float4)(line[col[0]], line[col[1]], line[col[2]], line[col[3]]);
            down_columns += weights_y[a] * four;
        }
        out[first + p * pixels + (long)y * cols + x] =
            weights_x[0] * down_columns.x + weights_x[1] * down_columns.y + weights_x[2] * down_columns.z +
            weights_x[3] * down_columns.w;
    }
}
