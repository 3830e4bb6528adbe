// A work-item does `run` pixels, one on GPUs.
inline float along(__global const float *row, const float *roots, const float light, const float s)
{
    const float l = light + s * (roots[0] - light), m = light + s * (roots[1] - light);
    const float n = light + s * (roots[2] - light);
    return row[0] * (l * l * l) + row[1] * (m * m * m) + row[2] * (n * n * n);
}

__kernel void gamut(
    // in:
    __global const float *restrict rgb,        // [3][pixels]
    __global const float *restrict to_lms,     // [3][3]
    __global const float *restrict back,       // [3][3]
    __global const float *restrict lightness,  // [3]
    // out:
    __global float *restrict out,              // [3][pixels]
    // params:
    const float bright,
    // sizes:
    const int steps, const int run, const int pixels)
{
    const int begin = get_global_id(0) * run, end = min(begin + run, pixels);
    const long size = pixels;
    for (int i = begin; i < end; ++i) {
        const float red = rgb[i], green = rgb[size + i], blue = rgb[2 * size + i];
        float most = fmax(fmax(red, green), blue), least = fmin(fmin(red, green), blue);
        out[i] = red;
        out[size + i] = green;
        out[2 * size + i] = blue;
        // NaN compares false, and fmin and fmax leave it out
        if ((most <= 1.0f && least >= 0.0f) || !(fabs(red + green + blue) <= FLT_MAX)) continue;
        float roots[3], light = 0.0f;
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            roots[k] = cbrt(to_lms[3 * k] * red + to_lms[3 * k + 1] * green + to_lms[3 * k + 2] * blue);
            light += lightness[k] * roots[k];
        }
        light = clamp(light, 0.0f, bright);
        float inside = 0.0f, outside = 1.0f;
        for (int step = 0; step < steps; ++step) {
            const float middle = 0.5f * (inside + outside);
            most = least = along(back, roots, light, middle);
#pragma unroll
            for (int k = 1; k < 3; ++k) {
                const float found = along(back + 3 * k, roots, light, middle);
                most = fmax(most, found);
                least = fmin(least, found);
            }
            const bool is_inside = most <= 1.0f && least >= 0.0f;
            inside = is_inside ? middle : inside;
            outside = is_inside ? outside : middle;
        }
#pragma unroll
        for (int k = 0; k < 3; ++k)
            out[k * size + i] = clamp(along(back + 3 * k, roots, light, inside), 0.0f, 1.0f);
    }
}
