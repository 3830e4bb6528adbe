// One pixel per work-item, bands unrolled: neighbouring items form the vector, every band is read once.
// BANDS and PLANES come from the host.
#define SUM_UP(LOAD) \
    const int i = get_global_id(0); \
    GUARD(i >= pixels) \
    float sum[PLANES]; \
    _Pragma("unroll") for (int p = 0; p < PLANES; ++p) sum[p] = 0.0f; \
    _Pragma("unroll") for (int b = 0; b < BANDS; ++b) { \
        const float value = LOAD(content, (size_t)b * pixels + i); \
        _Pragma("unroll") for (int p = 0; p < PLANES; ++p) sum[p] += weights[p * BANDS + b] * value; \
    } \
    _Pragma("unroll") for (int p = 0; p < PLANES; ++p) planes[(size_t)p * pixels + i] = sum[p];

#define FROM_FLOAT(content, at) content[at]
#define FROM_HALF(content, at) vload_half(at, content)  // core OpenCL: no extension is needed to load it

__kernel void integrate(
    // in:
    __global const float *restrict content,  // [BANDS][pixels]
    __constant float *weights,               // [PLANES][BANDS]
    // out:
    __global float *restrict planes,         // [PLANES][pixels]
    // sizes:
    const int pixels)
{
    SUM_UP(FROM_FLOAT)
}

__kernel void integrate_half(
    // in:
    __global const half *restrict content,   // [BANDS][pixels]
    __constant float *weights,               // [PLANES][BANDS]
    // out:
    __global float *restrict planes,         // [PLANES][pixels]
    // sizes:
    const int pixels)
{
    SUM_UP(FROM_HALF)
}
