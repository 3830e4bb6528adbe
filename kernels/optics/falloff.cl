// One pixel of one plane per work-item; memory-bound.
__kernel void falloff(
    // in:
    __global const float *restrict planes,  // [planes][rows][cols]
    __global const float *restrict gains,   // [planes or 1][rows][cols]
    __global const float *base,             // [planes][rows][cols]
    // out:
    __global float *out,                    // may be `base` if that is not added
    // params:
    const int own, const int add_base,
    // sizes:
    const int count, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    const size_t frame = (size_t)rows * cols, at = (size_t)y * cols + x;
    const float value = gains[own * p * frame + at] * planes[p * frame + at];
    out[p * frame + at] = add_base ? base[p * frame + at] + value : value;
}
