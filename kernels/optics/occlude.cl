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

// One place in EACH channels per work-item, all points of the pupil; gathers from a neighbourhood. SHEETS and BENDS come
// from the host and unroll the loops. MAPS: whether the layers' light is displaced; SLOPES: whether displacements and
// radii change from place to place. TOGETHER points have a sum of their own, to keep sums short.
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
    __global const float *restrict slopes,  // [BENDS + SHEETS][2][count]
    // out:
    __global float *restrict out,           // [channels][rows][cols]
    // params:
    const int margin, const int change,
    // sizes:
    const int points_, const int count, const int rows, const int cols, const int channels, const int high,
    const int wide)
{
    const int e = get_global_id(0), c = get_global_id(1) * EACH;
    GUARD(e >= count || c >= channels)
    const int y = places[2 * e] + margin, x = places[2 * e + 1] + margin;
    float mean_light[SHEETS * EACH], mean_alpha[SHEETS], radius[SHEETS], there[SHEETS];
    size_t light[SHEETS], alpha[SHEETS];
#pragma unroll
    for (int s = 0; s < SHEETS; ++s) {
        const int k = members[s * count + e];
        there[s] = k < 0 ? 0.0f : 1.0f;
        radius[s] = radii[s * count + e];
        alpha[s] = (size_t)max(k, 0) * high * wide;
        light[s] = ((size_t)max(k, 0) * channels + c) * high * wide;
        mean_alpha[s] = 0.0f;
#pragma unroll
        for (int n = 0; n < EACH; ++n) mean_light[s * EACH + n] = 0.0f;
    }
    float bent[BENDS + 1];
#pragma unroll
    for (int k = 0; k < BENDS; ++k) bent[k] = weights[k * count + e];
    float map[9];
#pragma unroll
    for (int k = 0; k < 9; ++k) map[k] = MAPS ? maps[k * count + e] : 0.0f;
    float slope_y[BENDS + SHEETS], slope_x[BENDS + SHEETS];
#pragma unroll
    for (int k = 0; k < BENDS + SHEETS; ++k) {
        slope_y[k] = SLOPES ? slopes[2 * k * count + e] : 0.0f;
        slope_x[k] = SLOPES ? slopes[(2 * k + 1) * count + e] : 0.0f;
    }
    float exact[EACH], whole = 0.0f;
#pragma unroll
    for (int n = 0; n < EACH; ++n) exact[n] = 0.0f;
    for (int first = 0; first < points_; first += TOGETHER) {
        float some_light[SHEETS * EACH], some_alpha[SHEETS], some[EACH], some_whole = 0.0f;
#pragma unroll
        for (int k = 0; k < SHEETS * EACH; ++k) some_light[k] = 0.0f;
#pragma unroll
        for (int s = 0; s < SHEETS; ++s) some_alpha[s] = 0.0f;
#pragma unroll
        for (int n = 0; n < EACH; ++n) some[n] = 0.0f;
        for (int m = first; m < min(first + TOGETHER, points_); ++m) {
            const float v = points[3 * m], u = points[3 * m + 1], share = points[3 * m + 2];
            float through = 1.0f, down = 0.0f, across = 0.0f, spread = 1.0f;
            // derivatives of the displacement, of rows along columns: yx
            float yy = 0.0f, yx = 0.0f, xy = 0.0f, xx = 0.0f;
#pragma unroll
            for (int k = 0; k < BENDS; ++k) {
                down += bent[k] * bends[2 * (k * points_ + m)];
                across += bent[k] * bends[2 * (k * points_ + m) + 1];
                if (SLOPES) {
                    yy += slope_y[k] * bends[2 * (k * points_ + m)];
                    yx += slope_x[k] * bends[2 * (k * points_ + m)];
                    xy += slope_y[k] * bends[2 * (k * points_ + m) + 1];
                    xx += slope_x[k] * bends[2 * (k * points_ + m) + 1];
                }
            }
            if (SLOPES) spread = 1.0f / ((1.0f - yy) * (1.0f - xx) - yx * xy);
            some_whole += share * spread;
#pragma unroll
            for (int s = 0; s < SHEETS; ++s) {
                if (there[s] == 0.0f) continue;
                float seen_y = BENDS ? radius[s] * v + down : radius[s] * v;
                float seen_x = BENDS ? radius[s] * u + across : radius[s] * u;
                float flux = there[s] * spread;
                if (SLOPES) {  // the place x + t that is seen has the displacement: t = d + d' t
                    const float tilt_y = slope_y[BENDS + s], tilt_x = slope_x[BENDS + s];
                    const float a = 1.0f - (yy + v * tilt_y), b = yx + v * tilt_x;
                    const float c_ = xy + u * tilt_y, d = 1.0f - (xx + u * tilt_x);
                    const float scale = 1.0f / (a * d - b * c_), to_y = (d * seen_y + b * seen_x) * scale;
                    seen_x = (c_ * seen_y + a * seen_x) * scale;
                    seen_y = to_y;
                }
                if (MAPS) {
                    const float to_y = map[0] + (map[2] * seen_y + map[3] * seen_x);
                    const float to_x = map[1] + (map[4] * seen_y + map[5] * seen_x);
                    flux *= map[6] + (map[7] * seen_y + map[8] * seen_x);
                    seen_y = to_y;
                    seen_x = to_x;
                }
                const int i = y + (int)floor(seen_y + 0.5f), j = x + (int)floor(seen_x + 0.5f);
                const int at = inside(i, high, BORDER) * wide + inside(j, wide, BORDER);
                if (BORDER == 0 && (i < 0 || i >= high || j < 0 || j >= wide)) flux = 0.0f;
                const float covered = there[s] * alphas[alpha[s] + at];
#pragma unroll
                for (int n = 0; n < EACH; ++n) {
                    const float own = flux * lights[light[s] + (size_t)n * high * wide + at];
                    some[n] += share * (through * own);
                    some_light[s * EACH + n] += share * own;
                }
                through *= 1.0f - covered;
                some_alpha[s] += SLOPES ? share * spread * covered : share * covered;
            }
        }
        whole += some_whole;
#pragma unroll
        for (int k = 0; k < SHEETS * EACH; ++k) mean_light[k] += some_light[k];
#pragma unroll
        for (int s = 0; s < SHEETS; ++s) mean_alpha[s] += some_alpha[s];
#pragma unroll
        for (int n = 0; n < EACH; ++n) exact[n] += some[n];
    }
#pragma unroll
    for (int n = 0; n < EACH; ++n) {
        float product = 0.0f, before = 1.0f;
#pragma unroll
        for (int s = 0; s < SHEETS; ++s) {
            product += before * mean_light[s * EACH + n];
            before *= 1.0f - (SLOPES ? mean_alpha[s] / whole : mean_alpha[s]);
        }
        const size_t target = ((size_t)(c + n) * rows + y - margin) * cols + x - margin;
        const float before_it = base[target];
        out[target] = fmax(before_it + (exact[n] - product), 0.0f) - (change ? before_it : 0.0f);
    }
}
