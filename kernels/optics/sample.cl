// One pixel along the axis that is reduced per work-item; TAPS comes from the host, unrolled: memory-bound.
__kernel void columns(
    // in:
    __global const float *restrict planes,   // [count][fine_rows][cols]
    __global const int *restrict start,      // [rows]
    __global const float *restrict weights,  // [TAPS][rows]
    // out:
    __global float *restrict out,            // [count][rows][cols]
    // sizes:
    const int count, const int fine_rows, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    __global const float *restrict from = planes + ((size_t)p * fine_rows + start[y]) * cols + x;
    float total = 0.0f;
#pragma unroll
    for (int t = 0; t < TAPS; ++t) total += weights[t * rows + y] * from[(size_t)t * cols];
    out[((size_t)p * rows + y) * cols + x] = total;
}

__kernel void rows(
    // in:
    __global const float *restrict planes,   // [count][rows][fine_cols]
    __global const int *restrict start,      // [cols]
    __global const float *restrict weights,  // [TAPS][cols]
    // out:
    __global float *restrict out,            // [count][rows][cols]
    // sizes:
    const int count, const int rows, const int fine_cols, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    __global const float *restrict from = planes + ((size_t)p * rows + y) * fine_cols + start[x];
    float total = 0.0f;
#pragma unroll
    for (int t = 0; t < TAPS; ++t) total += weights[t * cols + x] * from[t];
    out[((size_t)p * rows + y) * cols + x] = total;
}
