// One pixel per work-item, which reads its channels side by side and writes each to its plane. CHANNELS: from the host.
// The curve is global memory: neighbours have other codes, and constant memory gives one address at a time.
#define DECODE \
    const int x = get_global_id(0), y = get_global_id(1); \
    GUARD(y >= rows || x >= cols) \
    const size_t pixel = (size_t)y * cols + x, pixels = (size_t)rows * cols; \
    _Pragma("unroll") for (int c = 0; c < CHANNELS; ++c) out[c * pixels + pixel] = curve[codes[pixel * CHANNELS + c]];

__kernel void decode_bytes(
    // in:
    __global const uchar *restrict codes,   // [rows][cols][CHANNELS]
    __global const float *restrict curve,   // [256]
    // out:
    __global float *restrict out,           // [CHANNELS][rows][cols]
    // sizes:
    const int rows, const int cols)
{
    DECODE
}

__kernel void decode_words(
    // in:
    __global const ushort *restrict codes,  // [rows][cols][CHANNELS]
    __global const float *restrict curve,   // [65536]
    // out:
    __global float *restrict out,           // [CHANNELS][rows][cols]
    // sizes:
    const int rows, const int cols)
{
    DECODE
}
