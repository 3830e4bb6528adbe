// A work-item does `run` pixels, one on GPUs: three table look-ups and exact comparisons each (srgb.py).
inline uchar code(const float linear, __global const uint *restrict table)
{
    const float value = 4096.0f * (linear > 0.0f ? (linear < 1.0f ? linear : 1.0f) : 0.0f);  // NaN is black
    const int bin = (int)value;
    const uint entry = table[bin];
    return (uchar)((entry & 255u) + ((uint)(int)((value - (float)bin) * 16777216.0f) >= entry >> 8));
}

__kernel void srgb(
    // in:
    __global const float *restrict rgb,   // [3][pixels]
    __global const uint *restrict table,  // [4097]
    // out:
    __global uchar *restrict codes,       // [pixels][3]
    // sizes:
    const int run, const int pixels)
{
    const long begin = (long)get_global_id(0) * run, end = min(begin + run, (long)pixels);
    for (long i = begin; i < end; ++i) {
        codes[3 * i] = code(rgb[i], table);
        codes[3 * i + 1] = code(rgb[pixels + i], table);
        codes[3 * i + 2] = code(rgb[2L * pixels + i], table);
    }
}
