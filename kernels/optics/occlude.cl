#include "border.clh"

// every device rounds to the same samples
#pragma OPENCL FP_CONTRACT OFF

__kernel void begin(
    // in:
    __global const float *restrict base,
    // out:
    __global float *restrict out,
    // params:
    const int change,
    // sizes:
    const int channels, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    GUARD(x >= cols || y >= rows || c >= channels)
    const size_t at = ((size_t)c * rows + y) * cols + x;
    out[at] = change ? 0.0f : base[at];
}

// One place in AT_ONCE channels per work-item, all points of the pupil; gathers from a neighbourhood. A CPU takes all
// channels, whose rays are the same; a GPU takes one, and has more work-items. AT_ONCE, SHEETS and BENDS come from the
// host and unroll the loops. MAPS: whether the layers' light is displaced.
__kernel void occlude(
    // in:
    __global const float *restrict base,    // [channels][rows][cols]
    __global const float *restrict lights,  // [layers][channels][high][wide]
    __global const float *restrict alphas,  // [layers][high][wide]
    __global const int *restrict places,    // [count][2]
    __global const int *restrict members,   // [SHEETS][count]
    __global const float *restrict radii,   // [SHEETS][count]
    __global const float *restrict points,  // [points_][3]
    __global const float *restrict weights, // [BENDS][count]
    __global const float *restrict bends,   // [BENDS][points_][2]
    __global const float *restrict maps,    // [9][count], see occlude.py
    // out:
    __global float *restrict out,           // [channels][rows][cols]
    // params:
    const int margin, const int change,
    // sizes:
    const int points_, const int count, const int rows, const int cols, const int channels, const int high,
    const int wide)
{
    const int e = get_global_id(0), first = get_global_id(1) * AT_ONCE;
    GUARD(e >= count || first >= channels)
    const int y = places[2 * e] + margin, x = places[2 * e + 1] + margin;
    float mean_light[SHEETS][AT_ONCE], mean_alpha[SHEETS], radius[SHEETS], there[SHEETS];
    size_t light[SHEETS], alpha[SHEETS];
#pragma unroll
    for (int s = 0; s < SHEETS; ++s) {
        const int k = members[s * count + e];
        there[s] = k < 0 ? 0.0f : 1.0f;
        radius[s] = radii[s * count + e];
        alpha[s] = (size_t)max(k, 0) * high * wide;
        light[s] = ((size_t)max(k, 0) * channels + first) * high * wide;
        mean_alpha[s] = 0.0f;
#pragma unroll
        for (int c = 0; c < AT_ONCE; ++c) mean_light[s][c] = 0.0f;
    }
    float bent[BENDS + 1];
#pragma unroll
    for (int k = 0; k < BENDS; ++k) bent[k] = weights[k * count + e];
    float map[9];
#pragma unroll
    for (int k = 0; k < 9; ++k) map[k] = MAPS ? maps[k * count + e] : 0.0f;
    float exact[AT_ONCE];
#pragma unroll
    for (int c = 0; c < AT_ONCE; ++c) exact[c] = 0.0f;
    for (int m = 0; m < points_; ++m) {
        const float v = points[3 * m], u = points[3 * m + 1], share = points[3 * m + 2];
        float through = 1.0f, down = 0.0f, across = 0.0f;
#pragma unroll
        for (int k = 0; k < BENDS; ++k) {
            down += bent[k] * bends[2 * (k * points_ + m)];
            across += bent[k] * bends[2 * (k * points_ + m) + 1];
        }
#pragma unroll
        for (int s = 0; s < SHEETS; ++s) {
            if (there[s] == 0.0f) continue;
            float seen_y = BENDS ? radius[s] * v + down : radius[s] * v;
            float seen_x = BENDS ? radius[s] * u + across : radius[s] * u;
            float flux = there[s];
            if (MAPS) {
                const float to_y = map[0] + (map[2] * seen_y + map[3] * seen_x);
                const float to_x = map[1] + (map[4] * seen_y + map[5] * seen_x);
                flux *= map[6] + (map[7] * seen_y + map[8] * seen_x);
                seen_y = to_y;
                seen_x = to_x;
            }
            const int i = y + (int)floor(seen_y + 0.5f), j = x + (int)floor(seen_x + 0.5f);
            const int at = inside(i, high, BORDER) * wide + inside(j, wide, BORDER);
            const int dark = BORDER == 0 && (i < 0 || i >= high || j < 0 || j >= wide);
            const float covered = there[s] * alphas[alpha[s] + at];
#pragma unroll
            for (int c = 0; c < AT_ONCE; ++c) {
                const float own = dark ? 0.0f : flux * lights[light[s] + (size_t)c * high * wide + at];
                exact[c] += share * (through * own);
                mean_light[s][c] += share * own;
            }
            through *= 1.0f - covered;
            mean_alpha[s] += share * covered;
        }
    }
#pragma unroll
    for (int c = 0; c < AT_ONCE; ++c) {
        float product = 0.0f, before = 1.0f;
#pragma unroll
        for (int s = 0; s < SHEETS; ++s) {
            product += before * mean_light[s][c];
            before *= 1.0f - mean_alpha[s];
        }
        const size_t target = ((size_t)(first + c) * rows + y - margin) * cols + x - margin;
        const float before_it = base[target];
        out[target] = fmax(before_it + (exact[c] - product), 0.0f) - (change ? before_it : 0.0f);
    }
}
