// A work-item does `run` pixels, one on GPUs. CHANNELS comes from the host and the loops over it unroll, so on CPUs LLVM
// vectorises the loop over the pixels.
__kernel void color(
    // in:
    __global const float *restrict camera,   // [CHANNELS][pixels]
    __global const float *restrict matrix,   // [3][CHANNELS]
    __global const float *restrict ceiling,  // [CHANNELS]
    // out:
    __global float *restrict rgb,            // [3][pixels]
    // sizes:
    const int run, const int pixels)
{
    const long begin = (long)get_global_id(0) * run, end = min(begin + run, (long)pixels);
    for (long i = begin; i < end; ++i) {
        float red = 0.0f, green = 0.0f, blue = 0.0f;
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            const float value = camera[c * (long)pixels + i];
            const float clipped = value > ceiling[c] ? ceiling[c] : value;  // NaN stays
            red += matrix[c] * clipped;
            green += matrix[CHANNELS + c] * clipped;
            blue += matrix[2 * CHANNELS + c] * clipped;
        }
        rgb[i] = red;
        rgb[pixels + i] = green;
        rgb[2L * pixels + i] = blue;
    }
}
