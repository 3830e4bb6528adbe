// One pixel of one plane per work-item; memory-bound.
__kernel void falloff(
    // in:
    __global const float *restrict planes,  // [planes][rows][cols]
    __global const float *restrict gains,   // [planes or 1][rows][cols]
    // out:
    __global float *restrict out,
    // params:
    const int own,
    // sizes:
    const int count, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    const size_t frame = (size_t)rows * cols, at = (size_t)y * cols + x;
    out[p * frame + at] = gains[own * p * frame + at] * planes[p * frame + at];
}
