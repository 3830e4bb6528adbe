// `limited` of distort.cl on CPUs: a work-item has a row, 8 pixels of it in the lanes of vectors. Neighbours that show
// neighbouring samples, but for one sample that is shown twice or left out, read whole vectors. The others, and those
// next to the border, are done one by one.
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

// Values at half_x and at the same places of the next 7 pixels, as `place`.
void place8(__global const float *restrict line, const int half_x, const int nx, const int cols, float8 *v, float8 *u,
            float8 *flux)
{
    const int8 at = (half_x + (int8)(0, 2, 4, 6, 8, 10, 12, 14)) * (nx - 1);
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

// Whole numbers from the least value on up to the greatest one, within 0 .. 4: x <= number < y.
int2 cells_between(const float8 least, const float8 greatest)
{
    const float4 low = fmin(least.lo, least.hi), high = fmax(greatest.lo, greatest.hi);
    return clamp((int2)((int)floor(fmin(fmin(low.x, low.y), fmin(low.z, low.w))),
                        (int)ceil(fmax(fmax(high.x, high.y), fmax(high.z, high.w)))), 0, 4);
}

// Weights of the 4 x 4 samples of each lane, as in `pixel`: cubic of each sample's share, the rest of it by area.
// share: from the first sample on. wy, wx: of the cubic. floor_y, floor_x: whole parts of the centres' places.
void weigh8(__global const float *restrict share, const int source_cols, __global const float *restrict line, const int x,
            const int nx, const int cols, const float8 *wy, const float8 *wx, const float8 floor_y, const float8 floor_x,
            const float8 flux, const int8 is_second, float8 *weights)
{
    float8 ys[4], xs[4];  // corners from the first sample: upper left, lower left, lower right, upper right
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int is_low = k == 1 || k == 2, is_right = k > 1;
        float8 v, u, unused;
        place8(line + (is_low ? 6 * nx : 0), 2 * (x + is_right), nx, cols, &v, &u, &unused);
        ys[k] = v - floor_y + (1.0f + is_low);
        xs[k] = u - floor_x + (1.0f + is_right);
    }
    const int2 rows = cells_between(fmin(fmin(ys[0], ys[1]), fmin(ys[2], ys[3])), fmax(fmax(ys[0], ys[1]), fmax(ys[2], ys[3])));
    const int2 columns = cells_between(fmin(fmin(xs[0], xs[1]), fmin(xs[2], xs[3])), fmax(fmax(xs[0], xs[1]), fmax(xs[2], xs[3])));
    float8 whole = (float8)(0.0f);
#pragma unroll
    for (int k = 0; k < 16; ++k) weights[k] = (float8)(0.0f);
    for (int a = rows.x; a < rows.y; ++a)
        for (int b = columns.x; b < columns.y; ++b) {
            float8 overlap = (float8)(0.0f);
#pragma unroll
            for (int k = 0; k < 4; ++k) overlap += below8(ys[k], xs[k], ys[(k + 1) % 4], xs[(k + 1) % 4], a, b);
            overlap = fmax(overlap, 0.0f);
            weights[4 * a + b] = overlap;
            whole += overlap;
        }
    const float8 per = flux / whole;
#pragma unroll
    for (int a = 0; a < 4; ++a)
#pragma unroll
        for (int b = 0; b < 4; ++b) {
            __global const float *at = share + a * source_cols + b;
            const float8 part = select(vload8(0, at), vload8(0, at + 1), is_second);
            weights[4 * a + b] = flux * wy[a] * wx[b] * part + per * weights[4 * a + b] * (1.0f - part);
        }
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
            place8(middle, 2 * x + 1, nx, cols, &v, &u, &flux);
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
                const int is_mixed = any(spread);
                float8 weights[16];
                if (is_mixed)
                    weigh8(share + from, source_cols, line, x, nx, cols, wy, wx, floor_y, floor_x, flux, is_second, weights);
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
                    total *= flux;
                    if (is_mixed) {
                        float8 mixed = (float8)(0.0f);
#pragma unroll
                        for (int k = 0; k < 16; ++k) {
                            __global const float *sample = at + k / 4 * source_cols + k % 4;
                            mixed += weights[k] * select(vload8(0, sample), vload8(0, sample + 1), is_second);
                        }
                        total = select(total, mixed, spread);
                    }
                    vstore8(total, 0, out + (plane * rows + y) * cols + x);
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
