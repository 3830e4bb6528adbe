// WIDTH pixels of a row per work-item: 1 on GPUs, 8 lanes on CPUs. FRAMES comes from the host: the values of a frame
// then stay in registers. Sums of digital numbers are whole numbers below 2^24, exact in float32.
#pragma OPENCL FP_CONTRACT OFF
#include "lanes.clh"

#define POSITIVE(value) ((value) > 0.0f ? (value) : (real)0.0f)  // fmax() of vectors is slow on PoCL

// The neighbour `step` away, the opposite one if it is outside, or the pixel itself if both are.
INLINE int neighbour(const int i, const int step, const int n)
{
    const int there = i + step, opposite = i - step;
    if (there >= 0 && there < n) return there;
    return opposite >= 0 && opposite < n ? opposite : i;
}

INLINE word numbers(__global const ushort *restrict row, const int x, const int step, const bool inside, const int cols)
{
#if WIDTH == 1
    return row[inside ? x + step : neighbour(x, step, cols)];
#else
    if (inside) return TO_WORD(vload8(0, row + x + step));
    word found;
    for (int lane = 0; lane < WIDTH; ++lane)
        ((uint *)&found)[lane] = row[neighbour(min(x + lane, cols - 1), step, cols)];
    return found;
#endif
}

INLINE void pixels(
    __global const ushort *restrict raw, __global const float *restrict table, __global float *restrict out,
    const float margin, const float scale, const int photon, const int period_y, const int period_x, const bool inside,
    const int x, const int y, const int rows, const int cols)
{
    const int up = neighbour(y, -period_y, rows), down = neighbour(y, period_y, rows);
    real own[FRAMES];
    integer used[FRAMES];
    real electrons = 0.0f, seconds = 0.0f;
#pragma unroll
    for (int i = 0; i < FRAMES; ++i) {
        __global const ushort *frame = raw + (size_t)i * rows * cols;
        __global const ushort *here = frame + (size_t)y * cols;
        __global const ushort *above = frame + (size_t)up * cols, *below = frame + (size_t)down * cols;
        const float dark = table[i], per_number = table[FRAMES + i], time = table[2 * FRAMES + i];
        const float floor_ = table[3 * FRAMES + i], ceiling = table[4 * FRAMES + i], full = table[5 * FRAMES + i];
        const real number = TO_REAL(numbers(here, x, 0, inside, cols));
        const word around = numbers(here, x, -period_x, inside, cols) + numbers(here, x, period_x, inside, cols)
            + numbers(above, x, -period_x, inside, cols) + numbers(above, x, 0, inside, cols)
            + numbers(above, x, period_x, inside, cols) + numbers(below, x, -period_x, inside, cols)
            + numbers(below, x, 0, inside, cols) + numbers(below, x, period_x, inside, cols);
        const real mean = (0.125f * TO_REAL(around) - dark) * per_number;
        const real light = photon ? POSITIVE(mean) : (real)0.0f;
        const real left = POSITIVE(full - mean);  // to a full well; squared, a root is saved
        const integer holds = (mean <= full) & (margin * margin * (light + floor_) <= left * left);
        const integer plausible = i == 0 ? (integer)-1 : holds;
        electrons += plausible ? mean : (real)0.0f;
        seconds += plausible ? (real)time : (real)0.0f;
        own[i] = (number - dark) * per_number;
        used[i] = i == 0 ? (integer)-1 : plausible & (number < ceiling);
    }
    const real rate = photon ? POSITIVE(electrons / seconds) : (real)0.0f;
    real total = 0.0f, weight = 0.0f;
#pragma unroll
    for (int i = 0; i < FRAMES; ++i) {
        const float time = table[2 * FRAMES + i], floor_ = table[3 * FRAMES + i];
        const real share = used[i] ? time / (rate * time + floor_) : (real)0.0f;
        total += share * own[i];
        weight += share * time;
    }
    const real merged = total / weight * scale;
    STORE(float, merged, out + (size_t)y * cols + x, inside ? WIDTH : min(WIDTH, cols - x))
}

__kernel void merge(
    // in:
    __global const ushort *restrict raw,   // [FRAMES][rows][cols]
    __global const float *restrict table,  // [6][FRAMES] dark, 1 / gain, time, floor, ceiling, full
    // out:
    __global float *restrict out,          // [rows][cols]
    // params:
    const float margin, const float scale, const int photon, const int period_y, const int period_x,
    // sizes:
    const int run, const int rows, const int cols)
{
    const int y = get_global_id(1), first = get_global_id(0) * run;
    if (y >= rows || first >= cols) return;
    for (int x = first; x < min(first + run, cols); x += WIDTH) {
        if (x >= period_x && x + WIDTH - 1 + period_x < cols)
            pixels(raw, table, out, margin, scale, photon, period_y, period_x, true, x, y, rows, cols);
        else
            pixels(raw, table, out, margin, scale, photon, period_y, period_x, false, x, y, rows, cols);
    }
}
