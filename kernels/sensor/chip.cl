// What one chip is expected to collect. From the host: RESPONSE, DARK, 0 or 1.
#pragma OPENCL FP_CONTRACT OFF

__kernel void chip(
    // in:
    __global const float *restrict mean,      // [pixels]
    __global const float *restrict response,  // [pixels], if RESPONSE
    __global const float *restrict dark,      // [pixels], if DARK
    // out:
    __global float *restrict out,             // [pixels]
    // sizes and numbers:
    const int pixels, const float scale, const float dark_time)
{
    const int i = get_global_id(0);
    GUARD(i >= pixels)
    float expected = scale * mean[i];
    expected = expected > 1e30f ? 1e30f : expected;
#if RESPONSE
    expected = expected * response[i];
#endif
    expected = expected < 0.0f ? 0.0f : expected;
#if DARK
    expected = expected + dark_time * dark[i];
#endif
    out[i] = expected;
}
