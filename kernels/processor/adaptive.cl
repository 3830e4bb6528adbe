// Two passes, each over pairs of one row (bayer.clh), `run` of them per work-item. `green` finds green at the row's own
// (red or blue) pixels and writes the colour difference, sample - green, to a plane half as wide: entry q of row y
// belongs to x = 2 q - first(y). `colors` reads that plane around it; green itself is the sample less the difference.
// Inner pairs have plain indices, so LLVM vectorises their loops; the pairs at the ends mirror.
// No contraction: a mirrored mosaic then gives the mirrored picture bit for bit.
#pragma OPENCL FP_CONTRACT OFF
#include "bayer.clh"

// ROOT, 0 or 1, comes from the host: a branch, even one that never changes, keeps LLVM from pairing loads and stores.
inline float encode(const float x) { return ROOT ? copysign(sqrt(fabs(x)), x) : x; }

inline float decode(const float y) { return ROOT ? y * fabs(y) : y; }

// Mean of (p, q) and (r, s) with weights 1 / (|p - q| + limit), 1 / (|r - s| + limit).
inline float blend(const float p, const float q, const float r, const float s, const float limit)
{
    const float first = fabs(r - s) + limit, second = fabs(p - q) + limit;
    return 0.5f * ((p + q) * first + (r + s) * second) / (first + second);
}

inline float sample(const ushort number, const float black_level)
{
    return encode((float)number - black_level);
}

// The colour difference at column c; a .. f are columns x - 2 .. x + 2.
__attribute__((always_inline)) inline float own_minus_green(
    __global const ushort *restrict uu, __global const ushort *restrict u, __global const ushort *restrict h,
    __global const ushort *restrict d, __global const ushort *restrict dd,
    const long a, const long b, const long c, const long e, const long f,
    const float factor, const float black_level, const float limit)
{
#define SAMPLE(row, column) sample(row[column], black_level)
#define OWN(row, column) (factor * SAMPLE(row, column))
    const float here = OWN(h, c), left = SAMPLE(h, b), right = SAMPLE(h, e), up = SAMPLE(u, c), down = SAMPLE(d, c);
    const float bend_h = 2.0f * here - (OWN(h, a) + OWN(h, f));
    const float bend_v = 2.0f * here - (OWN(uu, c) + OWN(dd, c));
#undef OWN
#undef SAMPLE
    const float slope_h = fabs(left - right) + fabs(bend_h), slope_v = fabs(up - down) + fabs(bend_v);
    const float weight_h = slope_v * slope_v + limit * limit, weight_v = slope_h * slope_h + limit * limit;
    const float green_h = 0.5f * (left + right) + 0.25f * bend_h, green_v = 0.5f * (up + down) + 0.25f * bend_v;
    return here - (weight_h * green_h + weight_v * green_v) / (weight_h + weight_v);
}

__kernel void green(
    // in:
    __global const ushort *restrict raw,   // [rows][cols]
    // out:
    __global float *restrict difference,   // [rows][cols / 2 + 1]
    // params:
    const float black_level, const float limit, const float red, const float blue,  // factors of their codes
    const int red_row, const int red_col,
    // sizes:
    const int run, const int rows, const int cols)
{
    const int y = get_global_id(1);
    long q = get_global_id(0) * run;
    if (y >= rows) return;
    const int first = first_own(y, red_row, red_col);
    const float factor = is_red_row(y, red_row) ? red : blue;
    __global const ushort *h = raw + (size_t)y * cols;
    __global const ushort *u = raw + (size_t)mirror(y - 1, rows) * cols, *uu = raw + (size_t)mirror(y - 2, rows) * cols;
    __global const ushort *d = raw + (size_t)mirror(y + 1, rows) * cols, *dd = raw + (size_t)mirror(y + 2, rows) * cols;
    __global float *out = difference + (size_t)y * (cols / 2 + 1);

    const long end = min(q + run, (cols + first + 1L) / 2);
    const long inner_end = min(end, (cols - 1L + first) / 2);  // below it x + 2 < cols
    while (q < end) {
        if (q > first)  // here x - 2 >= 0
            for (; q < inner_end; ++q) {
                const long x = 2 * q - first;
                out[q] = own_minus_green(uu, u, h, d, dd, x - 2, x - 1, x, x + 1, x + 2, factor, black_level, limit);
            }
        if (q < end) {
            const long x = 2 * q - first;
            out[q] = own_minus_green(uu, u, h, d, dd, mirror(x - 2, cols), mirror(x - 1, cols), mirror(x, cols),
                                     mirror(x + 1, cols), mirror(x + 2, cols), factor, black_level, limit);
            ++q;
        }
    }
}

// Columns: b = x (own colour), e = x + 1 (green). Entries of the difference: k, l at x, x + 2 in the rows of this row's
// colour (uu, h, dd); m, n, o at x - 1, x + 1, x + 3 in the rows of the other (u, d).
__attribute__((always_inline)) inline void pair(
    __global const ushort *restrict measured, __global const float *restrict uu, __global const float *restrict u,
    __global const float *restrict h, __global const float *restrict d, __global const float *restrict dd,
    const long b, const long e, const long k, const long l, const long m, const long n, const long o,
    const bool store_own, const bool store_green, const float scale, const float black_level, const float limit,
    const float of_own, const float of_other,
    __global float *restrict own, __global float *restrict green, __global float *restrict other)
{
    const float own_b = (float)measured[b] - black_level, green_e = (float)measured[e] - black_level;
    const float other_b = blend(u[m], d[n], u[n], d[m], limit), other_right = blend(u[n], d[o], u[o], d[n], limit);
    const float own_up = blend(uu[k], h[l], uu[l], h[k], limit), own_down = blend(h[k], dd[l], h[l], dd[k], limit);
    const float own_e = blend(h[k], h[l], own_up, own_down, limit);
    const float other_e = blend(other_b, other_right, u[n], d[n], limit);
    const float code_b = of_own * encode(own_b) - h[k], code_e = encode(green_e);
    const float own_part = 1.0f / of_own, other_part = 1.0f / of_other;
    if (store_own) {
        own[b] = own_b * scale;
        green[b] = decode(code_b) * scale;
        other[b] = decode((code_b + other_b) * other_part) * scale;
    }
    if (store_green) {
        own[e] = decode((code_e + own_e) * own_part) * scale;
        green[e] = green_e * scale;
        other[e] = decode((code_e + other_e) * other_part) * scale;
    }
}

__kernel void colors(
    // in:
    __global const ushort *restrict raw,         // [rows][cols]
    __global const float *restrict difference,   // [rows][cols / 2 + 1]
    // out:
    __global float *restrict rgb,                // [3][rows][cols]
    // params:
    const float scale, const float black_level, const float limit, const float of_red, const float of_blue,
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
    const int pairs = cols / 2 + 1;
    __global const ushort *measured = raw + (size_t)y * cols;
    __global const float *h = difference + (size_t)y * pairs;
    __global const float *u = difference + (size_t)mirror(y - 1, rows) * pairs;
    __global const float *d = difference + (size_t)mirror(y + 1, rows) * pairs;
    __global const float *uu = difference + (size_t)mirror(y - 2, rows) * pairs;
    __global const float *dd = difference + (size_t)mirror(y + 2, rows) * pairs;
    __global float *green = rgb + pixels + (size_t)y * cols;
    __global float *own = red ? green - pixels : green + pixels;
    __global float *other = red ? green + pixels : green - pixels;

    const long end = min(q + run, (cols + first + 1L) / 2);
    const long inner_end = min(end, (cols - 2L + first) / 2);  // below it x + 3 < cols
    while (q < end) {
        if (q > 0)  // here x - 1 >= 0
            for (; q < inner_end; ++q) {
                const long x = 2 * q - first, m = q - first;
                pair(measured, uu, u, h, d, dd, x, x + 1, q, q + 1, m, m + 1, m + 2, true, true,
                     scale, black_level, limit, of_own, of_other, own, green, other);
            }
        if (q < end) {
            const long x = 2 * q - first, b = mirror(x, cols), e = mirror(x + 1, cols);
            pair(measured, uu, u, h, d, dd, b, e, (b + first) / 2, (mirror(x + 2, cols) + first) / 2,
                 (mirror(x - 1, cols) + 1 - first) / 2, (e + 1 - first) / 2, (mirror(x + 3, cols) + 1 - first) / 2,
                 x >= 0, x + 1 < cols, scale, black_level, limit, of_own, of_other, own, green, other);
            ++q;
        }
    }
}
