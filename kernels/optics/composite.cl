// One pixel of one channel per work-item; memory-bound. ENTRIES comes from the host and unrolls the loop.
__kernel void composite(
    // in:
    __global const float *restrict lights,  // [ENTRIES][channels][pixels]
    __global const float *restrict alphas,  // [ENTRIES][channels or 1][pixels]
    __constant float *ends,                 // [ENTRIES] 1 at the end of a layer, 0 else
    // out:
    __global float *restrict out,           // [channels][pixels]
    // params:
    const int own,
    // sizes:
    const int channels, const int pixels)
{
    const int i = get_global_id(0), c = get_global_id(1);
    GUARD(i >= pixels || c >= channels)
    const size_t at = (size_t)c * pixels + i, covered = (size_t)(own * c) * pixels + i;
    const size_t step = (size_t)channels * pixels, stride = (size_t)(own ? channels : 1) * pixels;
    float sum = 0.0f, through = 1.0f, light = 0.0f, alpha = 0.0f;
#pragma unroll
    for (int e = 0; e < ENTRIES; ++e) {
        light += lights[e * step + at];
        alpha += alphas[e * stride + covered];
        sum += ends[e] * through * light;
        through *= 1.0f - ends[e] * clamp(alpha, 0.0f, 1.0f);
        light *= 1.0f - ends[e];
        alpha *= 1.0f - ends[e];
    }
    out[at] = sum + (alpha > 0.0f ? through * light / alpha : 0.0f);
}
