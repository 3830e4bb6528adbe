// The transforms are elsewhere (common/fft.py); these kernels weight and sum, and crop, all memory-bound.

#ifdef SIZE  // the host builds the rest without it
// SIZE spectra go into CHANNELS sums at once: each spectrum and table is read once per batch.
__kernel void accumulate(
    // in:
    __global const float2 *restrict spectra,  // [SIZE][period_y][pitch]
    __global const float *restrict tables,    // [1 or CHANNELS][count][period_y / 2 + 1][half]
    __constant float *mix,                    // [CHANNELS][SIZE]
    // out:
    __global float2 *restrict sums,           // [CHANNELS][period_y][pitch]
    // params:
    const int is_first, const int first, const int count, const int own_tables,
    // sizes:
    const int period_y, const int half_x, const int pitch)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= half_x || y >= period_y)
    const size_t at = (size_t)y * pitch + x, plane = (size_t)period_y * pitch;
    const size_t quarter = (size_t)(period_y / 2 + 1) * half_x, fold = (size_t)min(y, period_y - y) * half_x + x;
    float2 total[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) total[c] = is_first ? (float2)(0.0f, 0.0f) : sums[c * plane + at];
#pragma unroll
    for (int k = 0; k < SIZE; ++k) {
        const float2 value = spectra[k * plane + at];
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c)
            total[c] += mix[c * SIZE + k] * tables[(own_tables * c * count + first + k) * quarter + fold] * value;
    }
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) sums[c * plane + at] = total[c];
}

// The same with tables of complex values for every row.
__kernel void accumulate_complex(
    // in:
    __global const float2 *restrict spectra,  // [SIZE][period_y][pitch]
    __global const float2 *restrict tables,   // [1 or CHANNELS][count][period_y][half]
    __constant float *mix,                    // [CHANNELS][SIZE]
    // out:
    __global float2 *restrict sums,           // [CHANNELS][period_y][pitch]
    // params:
    const int is_first, const int first, const int count, const int own_tables,
    // sizes:
    const int period_y, const int half_x, const int pitch)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= half_x || y >= period_y)
    const size_t at = (size_t)y * pitch + x, plane = (size_t)period_y * pitch;
    const size_t table = (size_t)period_y * half_x, place = (size_t)y * half_x + x;
    float2 total[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) total[c] = is_first ? (float2)(0.0f, 0.0f) : sums[c * plane + at];
#pragma unroll
    for (int k = 0; k < SIZE; ++k) {
        const float2 value = spectra[k * plane + at];
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            const float2 transfer = mix[c * SIZE + k] * tables[(own_tables * c * count + first + k) * table + place];
            total[c] += (float2)(transfer.x * value.x - transfer.y * value.y,
                                 transfer.x * value.y + transfer.y * value.x);
        }
    }
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) sums[c * plane + at] = total[c];
}
#endif

__kernel void crop(
    // in:
    __global const float *restrict blurred,
    __global const float *base,
    // out:
    __global float *out,  // may be `base` if that is not added
    // params:
    const int add_base, const int before_y, const int before_x,
    // sizes:
    const int channels, const int rows, const int cols, const int period_y, const int period_x)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    GUARD(x >= cols || y >= rows || c >= channels)
    const size_t at = ((size_t)c * rows + y) * cols + x;
    const float value = blurred[((size_t)c * period_y + y + before_y) * period_x + x + before_x];
    out[at] = add_base ? base[at] + value : value;
}
