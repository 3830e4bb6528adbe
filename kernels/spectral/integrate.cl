// One pixel per work-item, bands unrolled: neighbouring items form the vector, every band is read once.
// BANDS and PLANES come from the host.
__kernel void integrate(
    // in:
    __global const float *restrict content,  // [BANDS][pixels]
    __constant float *weights,               // [PLANES][BANDS]
    // out:
    __global float *restrict planes,         // [PLANES][pixels]
    // sizes:
    const int pixels)
{
    const int i = get_global_id(0);
    GUARD(i >= pixels)
    float sum[PLANES];
#pragma unroll
    for (int p = 0; p < PLANES; ++p) sum[p] = 0.0f;
#pragma unroll
    for (int b = 0; b < BANDS; ++b) {
        const float value = content[(size_t)b * pixels + i];
#pragma unroll
        for (int p = 0; p < PLANES; ++p) sum[p] += weights[p * BANDS + b] * value;
    }
#pragma unroll
    for (int p = 0; p < PLANES; ++p) planes[(size_t)p * pixels + i] = sum[p];
}
