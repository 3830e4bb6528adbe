// A work-item does `run` pairs of one row (bayer.clh); inner pairs have plain indices, so LLVM vectorises their loop,
// and only the pairs at the ends mirror. All sums are whole numbers: exact in any order.
#include "bayer.clh"

// At a pixel of the row's own colour: 16 times green, and 16 times the colour that this row does not sample.
// far: its four neighbours of the same colour; cross: the four adjacent; corners: the four diagonal ones.
inline int green_at_own(const int here, const int cross, const int far) { return 8 * here + 4 * cross - 2 * far; }

inline int other_at_own(const int here, const int corners, const int far) { return 12 * here + 4 * corners - 3 * far; }

// At a green pixel: 16 times the colour of the two neighbours `near` along one axis. along, across: green neighbours at
// distance 2 on that axis and on the other; corners: the four diagonal ones, green too.
inline int colour_at_green(const int here, const int near, const int along, const int across, const int corners)
{
    return 10 * here + 8 * near - 2 * (along + corners) + across;
}

inline float value(const int sixteenfold, const float black_level, const float scale)
{
    return ((float)sixteenfold * 0.0625f - black_level) * scale;
}

// Columns: a .. f are x - 2 .. x + 3; c is the own colour's pixel, d the green one.
__attribute__((always_inline)) inline void pair(
    __global const ushort *restrict uu, __global const ushort *restrict u, __global const ushort *restrict h,
    __global const ushort *restrict w, __global const ushort *restrict ww,
    const long a, const long b, const long c, const long d, const long e, const long f,
    const bool store_own, const bool store_green, const float black_level, const float scale,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
    const int up = u[d], down = w[d], left = h[b], here = h[c], right = h[d], next = h[e];
    if (store_own) {
        const int far = h[a] + next + uu[c] + ww[c];
        own[c] = value(16 * here, black_level, scale);
        green[c] = value(green_at_own(here, left + right + u[c] + w[c], far), black_level, scale);
        other[c] = value(other_at_own(here, u[b] + up + w[b] + down, far), black_level, scale);
    }
    if (store_green) {
        const int corners = u[c] + u[e] + w[c] + w[e], along = left + h[f], across = uu[d] + ww[d];
        own[d] = value(colour_at_green(right, here + next, along, across, corners), black_level, scale);
        green[d] = value(16 * right, black_level, scale);
        other[d] = value(colour_at_green(right, up + down, across, along, corners), black_level, scale);
    }
}

#ifdef GPU
// Columns x and x + 1, x even, by one load and one store each: for even widths, where all rows are aligned alike.
inline void two(
    __global const ushort *restrict uu, __global const ushort *restrict u, __global const ushort *restrict h,
    __global const ushort *restrict w, __global const ushort *restrict ww, const int x, const int first, const int cols,
    const float black_level, const float scale,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
#define TWO(row, at) convert_int2(*(__global const ushort2 *)((row) + (at)))
    // what is mirrored at x = -2 and -1 lies at 2 and 1, and likewise at the other end
    const bool starts = x == 0, ends = x + 2 == cols;
    const int2 here = TWO(h, x), around = TWO(uu, x) + TWO(ww, x), above = TWO(u, x), below = TWO(w, x);
    int2 before = starts ? (int2)(h[mirror(-2, cols)], here.y) : TWO(h, x - 2);
    int2 after = ends ? (int2)(here.x, h[mirror(x + 3, cols)]) : TWO(h, x + 2);
    const int above_b = starts ? above.y : u[x - 1], above_e = ends ? above.x : u[x + 2];
    const int below_b = starts ? below.y : w[x - 1], below_e = ends ? below.x : w[x + 2];
    const int near_x = above_b + below_b, near_y = above_e + below_e;  // diagonal beyond the first and the second column
    const int2 sides = above + below;
    // with first = 1 the own colour is in the second column: the row is read from its other end
    const int c = first ? here.y : here.x, d = first ? here.x : here.y;
    const int b = first ? after.x : before.y, e = first ? before.y : after.x;
    const int far = (first ? before.y + after.y : before.x + after.x);
    const int along = first ? before.x + after.x : before.y + after.y;
    const int vertical_c = first ? sides.y : sides.x, vertical_d = first ? sides.x : sides.y;
    const int beyond_c = first ? near_y : near_x, beyond_d = first ? near_x : near_y;
    const int around_c = first ? around.y : around.x, across = first ? around.x : around.y;
    const float own_c = value(16 * c, black_level, scale), green_d = value(16 * d, black_level, scale);
    const float green_c = value(green_at_own(c, b + d + vertical_c, far + around_c), black_level, scale);
    const float other_c = value(other_at_own(c, beyond_c + vertical_d, far + around_c), black_level, scale);
    const int corners = vertical_c + beyond_d;
    const float own_d = value(colour_at_green(d, c + e, along, across, corners), black_level, scale);
    const float other_d = value(colour_at_green(d, vertical_d, across, along, corners), black_level, scale);
#define STORE_TWO(plane, at_c, at_d) \
    *(__global float2 *)((plane) + x) = first ? (float2)(at_d, at_c) : (float2)(at_c, at_d)
    STORE_TWO(own, own_c, own_d);
    STORE_TWO(green, green_c, green_d);
    STORE_TWO(other, other_c, other_d);
}
#endif

__kernel void malvar(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    // out:
    __global float *restrict rgb,         // [3][rows][cols]
    // params:
    const float black_level, const float scale,
    const int red_row, const int red_col,
    // sizes:
    const int run, const int rows, const int cols)
{
    const int y = get_global_id(1);
    long q = get_global_id(0) * run;
    if (y >= rows) return;
    const bool red = is_red_row(y, red_row);
    const int first = first_own(y, red_row, red_col);
    const size_t pixels = (size_t)rows * cols;
    __global const ushort *h = raw + (size_t)y * cols;
    __global const ushort *u = raw + (size_t)mirror(y - 1, rows) * cols, *uu = raw + (size_t)mirror(y - 2, rows) * cols;
    __global const ushort *w = raw + (size_t)mirror(y + 1, rows) * cols, *ww = raw + (size_t)mirror(y + 2, rows) * cols;
    __global float *green = rgb + pixels + (size_t)y * cols;
    __global float *own = red ? green - pixels : green + pixels;
    __global float *other = red ? green + pixels : green - pixels;

#ifdef GPU
    if (cols % 2 == 0) {
        if (2 * q < cols)
            two(uu, u, h, w, ww, 2 * q, first, cols, black_level, scale, own, green, other);
        return;
    }
#endif
    const long end = min(q + run, (cols + first + 1L) / 2);
    const long inner_end = min(end, max(1L, (cols - 2L + first) / 2));  // below it x + 3 < cols
    while (q < end) {
        if (q > first)  // here x - 2 >= 0
            for (; q < inner_end; ++q) {
                const long x = 2 * q - first;
                pair(uu, u, h, w, ww, x - 2, x - 1, x, x + 1, x + 2, x + 3, true, true, black_level, scale, own, green,
                     other);
            }
        if (q < end) {
            const long x = 2 * q - first;
            pair(uu, u, h, w, ww, mirror(x - 2, cols), mirror(x - 1, cols), mirror(x, cols), mirror(x + 1, cols),
                 mirror(x + 2, cols), mirror(x + 3, cols), x >= 0, x + 1 < cols, black_level, scale, own, green, other);
            ++q;
        }
    }
}
