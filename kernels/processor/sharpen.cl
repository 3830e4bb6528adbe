// `measure_light` makes the luminance with repeated edges; `sharpen` blurs it and adds what the blur has lost. REACH comes
// from the host: the loops over the taps unroll, and on CPUs work-items along a row become vectors.
__kernel void measure_light(
    // in:
    __global const float *restrict rgb,        // [3][rows][cols]
    __global const float *restrict luminance,  // [3]
    // out:
    __global float *restrict light,            // [rows + 2 REACH][cols + 2 REACH]
    // sizes:
    const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), width = cols + 2 * REACH;
    GUARD(x >= width || y >= rows + 2 * REACH)
    const long pixels = (long)rows * cols;
    const long i = (long)clamp(y - REACH, 0, rows - 1) * cols + clamp(x - REACH, 0, cols - 1);
    light[(long)y * width + x] =
        luminance[0] * rgb[i] + luminance[1] * rgb[pixels + i] + luminance[2] * rgb[2 * pixels + i];
}

__kernel void sharpen(
    // in:
    __global const float *restrict rgb,    // [3][rows][cols]
    __global const float *restrict light,  // [rows + 2 REACH][cols + 2 REACH]
    __global const float *restrict taps,   // [2 REACH + 1][2 REACH + 1]
    __global const float *restrict noise,  // [2]
    // out:
    __global float *restrict out,          // [3][rows][cols]
    // params:
    const float strength,
    // sizes:
    const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), width = cols + 2 * REACH;
    GUARD(x >= cols || y >= rows)
    const long pixels = (long)rows * cols, i = (long)y * cols + x;
    __global const float *around = light + (long)y * width + x;
    float blurred = 0.0f;
#pragma unroll
    for (int v = 0; v <= 2 * REACH; ++v)
#pragma unroll
        for (int u = 0; u <= 2 * REACH; ++u)
            blurred += taps[v * (2 * REACH + 1) + u] * around[(long)v * width + u];
    const float detail = around[(long)REACH * width + REACH] - blurred;
    const float threshold = noise[0] * fmax(blurred, 0.0f) + noise[1];
    const float part = threshold > 0.0f ? 1.0f / (1.0f + threshold / (detail * detail)) : 1.0f;
    const float added = fabs(detail) <= FLT_MAX ? strength * (detail * part) : 0.0f;  // NaN compares false
    out[i] = rgb[i] + added;
    out[pixels + i] = rgb[pixels + i] + added;
    out[2 * pixels + i] = rgb[2 * pixels + i] + added;
}
