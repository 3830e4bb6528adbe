// One pixel per work-item goes through all lights; most are out of reach or need a few loads.
__kernel void splat(
    // in:
    __global const float *restrict mosaic, __global const int *restrict cfa,
    __global const int4 *restrict places,     // row, column, kernel, reach
    __global const float *restrict strength,
    __global const float *restrict cores,     // [kernels][channels][core][core]
    __global const float *restrict profiles,  // [kernels][channels][length]
    // out:
    __global float *restrict out,
    // params:
    const float per_pixel, const float spread, const int parts,
    // sizes:
    const int rows, const int cols, const int period_y, const int period_x, const int lights, const int channels,
    const int core, const int length)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int channel = cfa[y % period_y * period_x + x % period_x];
    const float corner = -0.5f * (parts - 1), share = 1.0f / (parts * parts);
    float sum = 0.0f;
    for (int h = 0; h < lights; ++h) {
        const int4 place = places[h];
        const int dy = abs(y - place.x), dx = abs(x - place.y);
        if (max(dy, dx) > place.w) continue;
        const int table = place.z * channels + channel;
        if (max(dy, dx) < core) {
            sum += strength[h] * cores[((size_t)table * core + dy) * core + dx];
            continue;
        }
        __global const float *profile = profiles + (size_t)table * length;
        float far = 0.0f;
        for (int i = 0; i < parts; ++i)
            for (int j = 0; j < parts; ++j) {
                const float v = dy + spread * (corner + i), u = dx + spread * (corner + j);
                const float radius = sqrt(v * v + u * u) * per_pixel;
                const int at = min((int)radius, length - 2);
                const float left = profile[at];
                far += left + fmin(radius - at, 1.0f) * (profile[at + 1] - left);
            }
        sum += strength[h] * share * far;
    }
    out[y * cols + x] = mosaic[y * cols + x] + sum;
}
