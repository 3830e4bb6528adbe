// One pixel per work-item goes through all lights; most are out of reach or need a few loads.
__kernel void splat(
    // in:
    __global const float *restrict mosaic, __global const int *restrict cfa,
    __global const int4 *restrict places,     // row, column, kernel, reach
    __global const float *restrict strength,
    __global const float *restrict cores,     // [kernels][channels][core][core]
    __global const float *restrict profiles,  // [kernels][channels][length]
    __global const float2 *restrict centres,  // [kernels], (row, column)
    __global const float *restrict streaks,   // [kernels][channels][count][samples]
    __global const float2 *restrict lines,    // [count], (y, x)
    __global const float *restrict corners,   // [kernels][channels]
    // out:
    __global float *restrict out,
    // params:
    const float per_pixel, const float spread_y, const float spread_x, const float fine, const float width,
    const int parts_y, const int parts_x,
    // sizes:
    const int rows, const int cols, const int period_y, const int period_x, const int lights, const int channels,
    const int core, const int length, const int count, const int samples)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int channel = cfa[y % period_y * period_x + x % period_x];
    const float corner_y = -0.5f * (parts_y - 1), corner_x = -0.5f * (parts_x - 1);
    const float share = 1.0f / (parts_y * parts_x), last = 0.5f * (samples - 1);
    const int half_core = core / 2;
    float sum = 0.0f;
    for (int h = 0; h < lights; ++h) {
        const int4 place = places[h];
        const int dy = y - place.x, dx = x - place.y, away = max(abs(dy), abs(dx));
        if (away > place.w) continue;
        const int table = place.z * channels + channel;
        if (away <= half_core) {
            sum += strength[h] * cores[((size_t)table * core + dy + half_core) * core + dx + half_core];
            continue;
        }
        __global const float *profile = profiles + (size_t)table * length;
        const float cy = dy - centres[place.z].x, cx = dx - centres[place.z].y;
        float far = 0.0f;
        for (int i = 0; i < parts_y; ++i)
            for (int j = 0; j < parts_x; ++j) {
                const float v = fabs(cy) + spread_y * (corner_y + i), u = fabs(cx) + spread_x * (corner_x + j);
                const float radius = sqrt(v * v + u * u) * per_pixel;
                const int at = min((int)radius, length - 2);
                const float left = profile[at];
                far += left + fmin(radius - at, 1.0f) * (profile[at + 1] - left);
            }
        if (!count) {
            sum += strength[h] * share * far;
        } else {
            const float square = cy * cy + cx * cx;
            far *= share;
            float first = 0.0f, before = 0.0f, both = 0.0f;
            for (int k = 0; k < count; ++k) {
                __global const float *streak = streaks + ((size_t)table * count + k) * samples;
                const float2 n = lines[k];
                const float along = cy * n.x + cx * n.y, across = cy * n.y - cx * n.x;
                const float off = fabs(across) * fine, ratio = off > last ? last / off : 1.0f;
                const float at = clamp(across * fine + last, 0.0f, 2.0f * last);
                const int i = min((int)at, samples - 2);
                const float value = streak[i] + (at - i) * (streak[i + 1] - streak[i]);
                far += along * along / (square * square) * value * (ratio * ratio);
                const float slant = along * across / (across * across + width * width);
                if (k == 0)
                    first = slant;
                else
                    both += before * slant;
                before = slant;
            }
            if (count > 1) far += corners[table] * (both + before * first) / (square * square);
            sum += strength[h] * fmax(far, 0.0f);
        }
    }
    out[y * cols + x] = mosaic[y * cols + x] + sum;
}
