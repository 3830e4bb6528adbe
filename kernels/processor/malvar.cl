// A work-item makes `run` pairs of one row (bayer.clh); inner pairs have plain indices, so LLVM vectorises their loop,
// and only the pairs at the ends mirror. All sums are whole numbers, exact in any order; so are sums of two of them if
// balance is 1.
#include "bayer.clh"

// A colour from the sum of its neighbours, 16 of their 16ths, and the Laplacian of the pixel's own colour in 16ths,
// which `share` brings to the wanted colour's part of white.
inline float value(const int neighbours, const int laplacian, const float share, const float black_level,
                   const float scale)
{
    return (((float)neighbours + share * (float)laplacian) * 0.0625f - black_level) * scale;
}

// At a pixel of the row's own colour; far: its four neighbours of the same colour.
#define MEASURED(here) value(16 * (here), 0, 0.0f, black_level, scale)
#define GREEN_AT_OWN(here, cross, far) value(4 * (cross), 8 * (here) - 2 * (far), of_own, black_level, scale)
#define OTHER_AT_OWN(here, corners, far) value(4 * (corners), 12 * (here) - 3 * (far), of_own / of_other, black_level, scale)
// At a green pixel: the colour of the two neighbours `near` along one axis. along, across: green neighbours at distance
// 2 on that axis and on the other; corners: the four diagonal ones, green too; of_it: that colour's balance.
#define AT_GREEN(here, near, along, across, corners, of_it) \
    value(8 * (near), 10 * (here) - 2 * ((along) + (corners)) + (across), 1.0f / of_it, black_level, scale)

// Columns: a .. f are x - 2 .. x + 3; c is the own colour's pixel, d the green one.
__attribute__((always_inline)) inline void pair(
    __global const ushort *restrict uu, __global const ushort *restrict u, __global const ushort *restrict h,
    __global const ushort *restrict w, __global const ushort *restrict ww,
    const long a, const long b, const long c, const long d, const long e, const long f,
    const bool store_own, const bool store_green, const float black_level, const float scale,
    const float of_own, const float of_other,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
    const int up = u[d], down = w[d], left = h[b], here = h[c], right = h[d], next = h[e];
    if (store_own) {
        const int far = h[a] + next + uu[c] + ww[c];
        own[c] = MEASURED(here);
        green[c] = GREEN_AT_OWN(here, left + right + u[c] + w[c], far);
        other[c] = OTHER_AT_OWN(here, u[b] + up + w[b] + down, far);
    }
    if (store_green) {
        const int corners = u[c] + u[e] + w[c] + w[e], along = left + h[f], across = uu[d] + ww[d];
        own[d] = AT_GREEN(right, here + next, along, across, corners, of_own);
        green[d] = MEASURED(right);
        other[d] = AT_GREEN(right, up + down, across, along, corners, of_other);
    }
}

#ifdef GPU
#define COLUMN(i) (is_end ? mirror(x + (i), cols) : x + (i))

// Columns x .. x + 3, x a multiple of 4, by wide loads and stores, for widths that are a multiple of 4, which align all
// rows. first: a literal at each call; no pixel needs to check its colour.
__attribute__((always_inline)) inline void four(
    __global const ushort *restrict uu, __global const ushort *restrict u, __global const ushort *restrict h,
    __global const ushort *restrict w, __global const ushort *restrict ww, const int x, const int first, const int cols,
    const float black_level, const float scale, const float of_own, const float of_other,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
    const bool is_end = x == 0 || x + 4 == cols;
    const ushort4 u4 = *(__global const ushort4 *)(u + x), h4 = *(__global const ushort4 *)(h + x);
    const ushort4 w4 = *(__global const ushort4 *)(w + x);
    const ushort4 uu4 = *(__global const ushort4 *)(uu + x), ww4 = *(__global const ushort4 *)(ww + x);
    const int here[] = {h[COLUMN(-2)], h[COLUMN(-1)], h4.x, h4.y, h4.z, h4.w, h[COLUMN(4)], h[COLUMN(5)]};
    const int near[] = {u[COLUMN(-1)] + w[COLUMN(-1)], u4.x + w4.x, u4.y + w4.y, u4.z + w4.z, u4.w + w4.w,
                        u[COLUMN(4)] + w[COLUMN(4)]};
    const int beyond[] = {uu4.x + ww4.x, uu4.y + ww4.y, uu4.z + ww4.z, uu4.w + ww4.w};
    float values[3][4];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
        const int centre = here[i + 2], beside = here[i + 1] + here[i + 3], along = here[i] + here[i + 4];
        const int corners = near[i] + near[i + 2];
        if (i % 2 == first) {
            values[0][i] = MEASURED(centre);
            values[1][i] = GREEN_AT_OWN(centre, beside + near[i + 1], along + beyond[i]);
            values[2][i] = OTHER_AT_OWN(centre, corners, along + beyond[i]);
        } else {
            values[0][i] = AT_GREEN(centre, beside, along, beyond[i], corners, of_own);
            values[1][i] = MEASURED(centre);
            values[2][i] = AT_GREEN(centre, near[i + 1], beyond[i], along, corners, of_other);
        }
    }
#define STORE(plane, v) *(__global float4 *)((plane) + x) = (float4)(v[0], v[1], v[2], v[3])
    STORE(own, values[0]);
    STORE(green, values[1]);
    STORE(other, values[2]);
}
#endif

__kernel void malvar(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    // out:
    __global float *restrict rgb,         // [3][rows][cols]
    // params:
    const float black_level, const float scale, const float of_red, const float of_blue,
    const int red_row, const int red_col,
    // sizes:
    const int run, const int rows, const int cols)
{
    const int y = get_global_id(1);
    long q = get_global_id(0) * run;
    if (y >= rows) return;
    const bool red = is_red_row(y, red_row);
    const float of_own = red ? of_red : of_blue, of_other = red ? of_blue : of_red;
    const int first = first_own(y, red_row, red_col);
    const size_t pixels = (size_t)rows * cols;
    __global const ushort *h = raw + (size_t)y * cols;
    __global const ushort *u = raw + (size_t)mirror(y - 1, rows) * cols, *uu = raw + (size_t)mirror(y - 2, rows) * cols;
    __global const ushort *w = raw + (size_t)mirror(y + 1, rows) * cols, *ww = raw + (size_t)mirror(y + 2, rows) * cols;
    __global float *green = rgb + pixels + (size_t)y * cols;
    __global float *own = red ? green - pixels : green + pixels;
    __global float *other = red ? green + pixels : green - pixels;

#ifdef GPU
    if (cols % 4 == 0) {
        if (4 * q >= cols) return;
        if (first)
            four(uu, u, h, w, ww, 4 * q, 1, cols, black_level, scale, of_own, of_other, own, green, other);
        else
            four(uu, u, h, w, ww, 4 * q, 0, cols, black_level, scale, of_own, of_other, own, green, other);
        return;
    }
#endif
    const long end = min(q + run, (cols + first + 1L) / 2);
    const long inner_end = min(end, max(1L, (cols - 2L + first) / 2));  // below it x + 3 < cols
    while (q < end) {
        if (q > first)  // here x - 2 >= 0
            for (; q < inner_end; ++q) {
                const long x = 2 * q - first;
                pair(uu, u, h, w, ww, x - 2, x - 1, x, x + 1, x + 2, x + 3, true, true, black_level, scale, of_own, of_other, own, green,
                     other);
            }
        if (q < end) {
            const long x = 2 * q - first;
            pair(uu, u, h, w, ww, mirror(x - 2, cols), mirror(x - 1, cols), mirror(x, cols), mirror(x + 1, cols),
                 mirror(x + 2, cols), mirror(x + 3, cols), x >= 0, x + 1 < cols, black_level, scale, of_own, of_other, own, green, other);
            ++q;
        }
    }
}
