// `limited` of distort.cl on CPUs: a work-item has a row, 8 pixels of it in the lanes of vectors. Neighbours that show
// neighbouring samples, but for one sample that is shown twice or left out, read whole vectors. The others, those next
// to the border, and samples that are spread by area are done one by one.
#define CELLS_IN_LANES
#include "distort.clh"

// Weights of the four samples of each lane at s in 0 .. 1, as `keys`.
#define KEYS(w, s)                                               \
    const float8 r_##w = 1.0f - s;                               \
    const float8 w[4] = {                                        \
        0.5f * (-s * r_##w * r_##w),                             \
        0.5f * (2.0f - s * s * (5.0f - 3.0f * s)),               \
        0.5f * (2.0f - r_##w * r_##w * (5.0f - 3.0f * r_##w)),   \
        0.5f * (-r_##w * s * s)};

// Values of 8 pixels' centres from x on, as `place`.
void place8(__global const float *restrict line, const int x, const int nx, const int cols, float8 *v, float8 *u,
            float8 *flux)
{
    const int8 at = (2 * (x + (int8)(0, 1, 2, 3, 4, 5, 6, 7)) + 1) * (nx - 1);
    const int8 first = clamp(convert_int8(convert_float8(at) * (0.5f / cols)) - 1, 0, nx - 4);
    const float8 s = convert_float8(at - first * (2 * cols)) * (0.5f / cols);
    const float8 s1 = s - 1.0f, s2 = s - 2.0f, s3 = s - 3.0f;
    const float8 w[4] = {(float8)(0.0f), s * s2 * s3 * 0.5f, s * s1 * s3 * -0.5f, s * s1 * s2 * (1.0f / 6.0f)};
    float8 sums[3] = {(float8)(0.0f), (float8)(0.0f), (float8)(0.0f)};  // of differences, as in `place`
    if (first.s0 == first.s7) {
        __global const float *from = line + first.s0 * 3;
#pragma unroll
        for (int b = 1; b < 4; ++b)
            for (int c = 0; c < 3; ++c) sums[c] += w[b] * (from[3 * b + c] - from[c]);
        *v = from[0] + sums[0];
        *u = from[1] + sums[1];
        *flux = from[2] + sums[2];
        return;
    }
    int of[8];
    vstore8(first * 3, 0, of);
    float8 here[3];
#pragma unroll
    for (int b = 0; b < 4; ++b) {
        float values[3][8];
#pragma unroll
        for (int lane = 0; lane < 8; ++lane)
            for (int c = 0; c < 3; ++c) values[c][lane] = line[of[lane] + 3 * b + c];
        for (int c = 0; c < 3; ++c) {
            if (b) sums[c] += w[b] * (vload8(0, values[c]) - here[c]);
            else here[c] = vload8(0, values[c]);
        }
    }
    *v = here[0] + sums[0];
    *u = here[1] + sums[1];
    *flux = here[2] + sums[2];
}

__kernel void limited(
    // in:
    __global const float *restrict planes, __global const float *restrict lines, __global const float *restrict share,
    // out:
    __global float *restrict out,   // [maps PLANES][rows][cols]
    // params:
    const int top, const int left,  // first of the pixels that are computed
    // sizes:
    const int source_rows, const int source_cols, const int nx, const int maps, const int rows, const int cols,
    const int wide)
{
    const int y = top + get_global_id(1), m = get_global_id(2), end = left + wide;
    const int8 lanes = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    __global const float *line = lines + ((size_t)m * (2 * rows + 1) + 2 * y) * nx * 3, *middle = line + 3 * nx;
    for (int x = left; x < end; x += 8) {
        int ones = x + 8 <= end ? 0 : 255 >> (x + 8 - end);  // bits of the lanes that are done one by one
        if (!ones) {
            float8 v, u, flux;
            place8(middle, x, nx, cols, &v, &u, &flux);
            const float8 floor_y = floor(v), floor_x = floor(u);
            const int8 down = convert_int8(floor_y), across = convert_int8(floor_x);
            const int right = min(min(min(across.s0, across.s1), min(across.s2, across.s3)),
                                  min(min(across.s4, across.s5), min(across.s6, across.s7)));
            const int8 second = across - right;  // 1 if it begins a sample later than `from`
            const int first_y = y + down.s0 - 1, first_x = x + right - 1;
            if (any(down != down.s0) || any(second > 1) || first_y < 0 || first_x < 0 || first_y + 4 > source_rows ||
                first_x + 12 > source_cols)
                ones = 255;
            else {
                const size_t from = (size_t)first_y * source_cols + first_x;
                const float8 fraction_y = v - floor_y, fraction_x = u - floor_x;
                KEYS(wy, fraction_y)
                KEYS(wx, fraction_x)
                const int8 is_second = second == 1;
                float8 least[5];
#pragma unroll
                for (int k = 0; k < 5; ++k) {
                    __global const float *at = share + from + k;
                    least[k] = fmin(fmin(vload8(0, at), vload8(0, at + source_cols)),
                                    fmin(vload8(0, at + 2 * source_cols), vload8(0, at + 3 * source_cols)));
                }
                const float8 inner = fmin(fmin(least[1], least[2]), least[3]);
                const int8 spread = fmin(inner, select(least[0], least[4], is_second)) < 1.0f;
                if (any(spread)) {
                    int bits[8];
                    vstore8(spread, 0, bits);
                    for (int lane = 0; lane < 8; ++lane) ones |= bits[lane] ? 1 << lane : 0;
                }
#pragma unroll
                for (int p = 0; p < PLANES; ++p) {
                    const size_t plane = m * PLANES + p;
                    __global const float *at = planes + plane * source_rows * source_cols + from;
                    float8 sums[5];
#pragma unroll
                    for (int k = 0; k < 5; ++k)
                        sums[k] = wy[0] * vload8(0, at + k) + wy[1] * vload8(0, at + source_cols + k) +
                                  wy[2] * vload8(0, at + 2 * source_cols + k) + wy[3] * vload8(0, at + 3 * source_cols + k);
                    float8 total = wx[0] * select(sums[0], sums[1], is_second);
#pragma unroll
                    for (int k = 1; k < 4; ++k) total += wx[k] * select(sums[k], sums[k + 1], is_second);
                    vstore8(flux * total, 0, out + (plane * rows + y) * cols + x);
                }
            }
        }
        for (int lane = 0; ones >> lane; ++lane)
            if (ones >> lane & 1) {
                const float3 at = place(middle, 2 * (x + lane) + 1, nx, cols);
                pixel(planes, line, share, planes, out, at, x + lane, y, m, source_rows, source_cols, nx, maps, rows, cols);
            }
    }
}
