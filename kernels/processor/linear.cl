// One pixel per work-item.
__kernel void linear(
    // in:
    __global const ushort *restrict raw,
    // out:
    __global float *restrict grey,
    // params:
    const float black_level, const float scale,
    // sizes:
    const int count)
{
    const int i = get_global_id(0);
    GUARD(i >= count)
    grey[i] = ((float)raw[i] - black_level) * scale;
}
