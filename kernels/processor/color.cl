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

// Of three channels and their roots. TERMS is 6, up to square roots, or 13, up to cube roots.
#define ADD(f, term)                                                                               \
    {                                                                                              \
        const float added = (term);                                                                \
        red += matrix[f] * added;                                                                  \
        green += matrix[TERMS + f] * added;                                                        \
        blue += matrix[2 * TERMS + f] * added;                                                     \
    }

__kernel void root_color(
    // in:
    __global const float *restrict camera,   // [3][pixels]
    __global const float *restrict matrix,   // [3][TERMS]
    __global const float *restrict ceiling,  // [3]
    // out:
    __global float *restrict rgb,            // [3][pixels]
    // sizes:
    const int run, const int pixels)
{
    const long begin = (long)get_global_id(0) * run, end = min(begin + run, (long)pixels);
    for (long i = begin; i < end; ++i) {
        float red = 0.0f, green = 0.0f, blue = 0.0f, square[3], cube[3];
        for (int c = 0; c < 3; ++c) {
            const float value = camera[c * (long)pixels + i];
            const float clipped = value > ceiling[c] ? ceiling[c] : value;  // NaN stays
            const float above = clipped < 0.0f ? 0.0f : clipped;
            ADD(c, clipped)
            square[c] = sqrt(above);
            cube[c] = TERMS > 6 ? cbrt(above) : 0.0f;
        }
        ADD(3, square[0] * square[1])
        ADD(4, square[1] * square[2])
        ADD(5, square[0] * square[2])
#if TERMS > 6
        ADD(6, cube[0] * cube[1] * cube[1])
        ADD(7, cube[1] * cube[2] * cube[2])
        ADD(8, cube[0] * cube[2] * cube[2])
        ADD(9, cube[0] * cube[0] * cube[1])
        ADD(10, cube[1] * cube[1] * cube[2])
        ADD(11, cube[0] * cube[0] * cube[2])
        ADD(12, cube[0] * cube[1] * cube[2])
#endif
        rgb[i] = red;
        rgb[pixels + i] = green;
        rgb[2L * pixels + i] = blue;
    }
}
