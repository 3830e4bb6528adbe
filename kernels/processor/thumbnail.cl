// CHANNELS and RUN come from the host: RUN columns per work-item, 1 on a GPU, where neighbours then read neighbours; on a
// CPU so many that LLVM vectorises the loop over them and their sums stay in the nearest cache.
__kernel void columns(
    // in:
    __global const float *restrict camera,   // [CHANNELS][height][width]
    __global const float *restrict ceiling,  // [CHANNELS]
    // out:
    __global float *restrict sums,           // [CHANNELS + 1][rows][width], last the number of pixels
    // sizes:
    const int height, const int width, const int rows, const int run)
{
    const int i = get_global_id(1), first = get_global_id(0) * run;
    GUARD(i >= rows || first >= width)
    const int begin = (long)i * height / rows, end = (long)(i + 1) * height / rows, length = min(RUN, width - first);
    const long pixels = (long)height * width;
    float total[CHANNELS + 1][RUN];
    for (int c = 0; c <= CHANNELS; ++c)
        for (int x = 0; x < length; ++x) total[c][x] = 0.0f;
    for (int y = begin; y < end; ++y) {
        __global const float *restrict from = camera + (long)y * width + first;
        for (int x = 0; x < length; ++x) {
            int below = 1;  // not for NaN
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) below &= from[c * pixels + x] < ceiling[c];
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) total[c][x] += below ? from[c * pixels + x] : 0.0f;
            total[CHANNELS][x] += below ? 1.0f : 0.0f;
        }
    }
    for (int c = 0; c <= CHANNELS; ++c)
        for (int x = 0; x < length; ++x) sums[((long)c * rows + i) * width + first + x] = total[c][x];
}

__kernel void blocks(
    // in:
    __global const float *restrict sums,
    // out:
    __global float *restrict out,  // [CHANNELS][rows][cols]
    // sizes:
    const int width, const int rows, const int cols)
{
    const int i = get_global_id(1), j = get_global_id(0);
    GUARD(i >= rows || j >= cols)
    const int begin = (long)j * width / cols, end = (long)(j + 1) * width / cols;
    float count = 0.0f;
    for (int x = begin; x < end; ++x) count += sums[((long)CHANNELS * rows + i) * width + x];
    for (int c = 0; c < CHANNELS; ++c) {
        float total = 0.0f;
        for (int x = begin; x < end; ++x) total += sums[((long)c * rows + i) * width + x];
        out[((long)c * rows + i) * cols + j] = count > 0.0f ? total / count : NAN;
    }
}
