// One pixel per work-item reads only its own channel. PERIOD_Y and PERIOD_X come from the host.
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
    const float u = (x - 0.5f * (cols - 1)) * slope, v = (y - 0.5f * (rows - 1)) * slope;
    const float secant2 = 1.0f + (u * u + v * v);  // 1 / cos^2
    const int channel = cfa[y % PERIOD_Y * PERIOD_X + x % PERIOD_X];
    const float rate = rates[((size_t)channel * rows + y) * cols + x];
    mean[y * cols + x] = exposure_time * (rate < 0.0f ? 0.0f : rate) / (secant2 * secant2);  // NaN stays
}
