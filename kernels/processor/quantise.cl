// One pixel per work-item. Adding 2^23 rounds to a whole number, halves to even; rint() does, too, but it keeps PoCL
// from vectorising. A comparison with NaN is false.
#pragma OPENCL FP_CONTRACT OFF

__kernel void quantise(
    // in:
    __global const float *restrict raw,
    // out:
    __global ushort *restrict numbers,
    // params:
    const float black_level, const float scale, const float light, const float black, const float white,
    // sizes:
    const int count)
{
    const int i = get_global_id(0);
    GUARD(i >= count)
    const float wanted = (raw[i] - black_level) * scale / light + black;
    const float cut = wanted > 0.0f ? (wanted < white ? wanted : white) : 0.0f;
    numbers[i] = (ushort)(cut + 8388608.0f - 8388608.0f);
}
