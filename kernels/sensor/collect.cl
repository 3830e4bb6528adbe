// Electrons of a rate at a pixel: with the fall-off of the lens, not below 0; NaN stays.
inline float electrons(const float rate, const int y, const int x, const float slope, const int rows, const int cols,
                       const float exposure_time)
{
    const float u = (x - 0.5f * (cols - 1)) * slope, v = (y - 0.5f * (rows - 1)) * slope;
    const float secant2 = 1.0f + (u * u + v * v);  // 1 / cos^2
    return exposure_time * (rate < 0.0f ? 0.0f : rate) / (secant2 * secant2);
}

// One pixel per work-item reads only its own channel. PERIOD_Y and PERIOD_X come from the host.
#ifdef PERIOD_X
__kernel void collect(
    // in:
    __global const float *restrict rates,  // [channels][rows][cols]
    __global const int *restrict cfa,      // [PERIOD_Y][PERIOD_X]
    // out:
    __global float *restrict mean,
    // params:
    const float slope,
    // sizes:
    const int rows, const int cols,
    // numbers by name:
    const float exposure_time)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int channel = cfa[y % PERIOD_Y * PERIOD_X + x % PERIOD_X];
    const float rate = rates[((size_t)channel * rows + y) * cols + x];
    mean[y * cols + x] = electrons(rate, y, x, slope, rows, cols, exposure_time);
}
#else
__kernel void collect_all(
    // in:
    __global const float *restrict rates,  // [channels][rows][cols]
    // out:
    __global float *restrict mean,         // [channels][rows][cols]
    // params:
    const float slope,
    // sizes:
    const int rows, const int cols,
    // numbers by name:
    const float exposure_time)
{
    const int x = get_global_id(0), y = get_global_id(1), channel = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    const size_t at = ((size_t)channel * rows + y) * cols + x;
    mean[at] = electrons(rates[at], y, x, slope, rows, cols, exposure_time);
}
#endif
