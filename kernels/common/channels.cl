// Pixels of CHANNELS values from as many planes.
__kernel void put_last(
    // in:
    __global const float *restrict planes,  // [CHANNELS][count]
    // out:
    __global float *restrict pixels,        // [count][CHANNELS]
    // sizes:
    const int count)
{
    const int i = get_global_id(0);
    GUARD(i >= count)
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) pixels[(size_t)i * CHANNELS + c] = planes[(size_t)c * count + i];
}
