// Everything happens on scratch planes of encoded samples with a margin of mirrored ones, so no step asks for borders.
// A scratch row is its even columns, then its odd ones ("halves"): the sites of one colour are neighbours in memory.
// Every step finds WIDTH neighbouring sites of one half. GPUs run the steps as kernels, one site per work-item, on
// whole planes; on CPUs a work-item walks down a strip and runs each step as soon as the rows that it needs are there,
// on scratch of a few rows (a ring, rows & MASK) that stays in the cache: one pass over the picture.
// All sums are symmetric in left and right, up and down, and rows and columns; no contraction: a mirrored mosaic then
// gives the mirrored picture bit for bit.
#pragma OPENCL FP_CONTRACT OFF
#include "bayer.clh"
#include "lanes.clh"

#define PLANE __global float *restrict
#if WIDTH == 8
typedef float8 __attribute__((aligned(4))) unaligned;  // PoCL's vload8 makes eight loads
#define NEAR(from) (*(__global const unaligned *)(from))
#define PUT(values, to) *(__global unaligned *)(to) = (values)
#else
#define NEAR(from) (from)[0]
#define PUT(values, to) (to)[0] = (values)
#endif
#define SQUARE(x) ((x) * (x))
#define MARGIN 14  // what a pixel of the picture needs around it
#define PLANES 9   // of scratch on a CPU
#define MASK (WIDTH == 1 ? -1 : NOISY ? 31 : 15)
// Thresholds are fractions of the full scale.
#define EDGE (5.0f / 255.0f)   // smaller changes of a difference are not edges
#define STEEP 1e4f             // steeper is as good as that, and its powers do not overflow
#define DARK (10.0f / 255.0f)  // added to a level before a difference is compared with it
#define ALIKE (2.0f / 255.0f)  // pairs that differ by less agree equally well
#define COLORED 0.3f           // difference over level where taps are half long, half short
#define KEPT_REACH 3.0f        // variances of noise within which measured samples are drawn to their neighbours

typedef struct {
    float black_level, scale, offset;      // code = root or identity of (DN - black_level) scale + offset
    float variance, shot;                  // of a code: variance + shot * code
    float longest, shortest;               // share of the long taps where the colours are alike, and are not
    float prior;                           // mean square bend below which gains stay 1
    int red_row, red_col, half_, rows, cols;
} Mosaic;

// Offset of the pixel i columns right of column 2 q + e, from the start of its row + q.
#define COLUMN(e, i) ((i) & 1 ? ((e) ? 0 : half_) + ((i) + ((e) ? 1 : -1)) / 2 : ((e) ? half_ : 0) + (i) / 2)
#define ROW(plane, j) ((plane) + (size_t)((y + (j)) & MASK) * (2 * half_) + q)
#define AT(plane, j, i) NEAR(ROW(plane, j) + COLUMN(e, i))
// The pixel i steps along and j across, for both axes.
#define ALONG(plane, i, j) (vertical ? AT(plane, i, j) : AT(plane, j, i))

INLINE real encode(const real x)
{
#if ROOT
    return copysign(sqrt(fabs(x)), x);
#else
    return x;
#endif
}

INLINE real decode(const real code, const Mosaic m)
{
#if ROOT
    return code * fabs(code) - (m.offset - 0.75f * m.variance);  // most of the noise's share of the square is gone
#else
    return code;
#endif
}

INLINE real noise_of(const real level, const Mosaic m) { return m.variance + m.shot * fmax(level, 0.0f); }

// `value` drawn towards `smooth`, the more the less their difference exceeds the noise; `kept` is the share that stays.
INLINE real draw(const real value, const real smooth, const real noise, const float kept, const float reach)
{
    const real change = value - smooth, square = change * change;
    return smooth + change * (square + kept * noise) / (square + reach * noise + 1e-20f);
}

// Mean of (p, q) and (r, s) with weights 1 / (|p - q| + limit), 1 / (|r - s| + limit).
INLINE real blend(const real p, const real q, const real r, const real s, const real limit)
{
    const real first = fabs(r - s) + limit, second = fabs(p - q) + limit;
    return 0.5f * ((p + q) * first + (r + s) * second) / (first + second);
}

INLINE void encode_row(__global const ushort *restrict raw, PLANE code, const int y, const int q, const Mosaic m)
{
    const int half_ = m.half_, x = 2 * q - MARGIN;
    __global const ushort *row = raw + (size_t)mirror(y - MARGIN, m.rows) * m.cols;
#if WIDTH == 8
    if (x >= 0 && x + 16 <= m.cols) {
        const ushort8 first = vload8(0, row + x), second = vload8(1, row + x);
        const real even = convert_float8((ushort8)(first.even, second.even));
        const real odd = convert_float8((ushort8)(first.odd, second.odd));
        PUT(encode((even - m.black_level) * m.scale + m.offset), ROW(code, 0));
        PUT(encode((odd - m.black_level) * m.scale + m.offset), ROW(code, 0) + half_);
        return;
    }
#endif
    real even = 0.0f, odd = 0.0f;
    for (int lane = 0; lane < WIDTH; ++lane) {
        ((float *)&even)[lane] = row[mirror(x + 2 * lane, m.cols)];
        ((float *)&odd)[lane] = row[mirror(x + 2 * lane + 1, m.cols)];
    }
    PUT(encode((even - m.black_level) * m.scale + m.offset), ROW(code, 0));
    PUT(encode((odd - m.black_level) * m.scale + m.offset), ROW(code, 0) + half_);
}

// Interpolated other colour of the row (column) minus the own one, with the regressed gain of the Laplacian.
INLINE real difference(PLANE code, const int y, const int q, const int e, const int vertical, const Mosaic m)
{
    const int half_ = m.half_;
#define C(i) ALONG(code, i, 0)
#define OWN_BEND(i) (2.0f * C(i) - (C(i - 2) + C(i + 2)))
#define OTHER_BEND(i) (0.5f * ((C(i - 1) + C(i + 1)) - (C(i - 3) + C(i + 3))))
    const real before = OTHER_BEND(-1), after = OTHER_BEND(1), sides = C(-1) + C(1);
    real damping = 2.0f * m.prior;
#if NOISY
    damping += 10.0f * noise_of(0.5f * sides, m);
#endif
    const real gain = clamp((OWN_BEND(-1) * before + OWN_BEND(1) * after + 2.0f * m.prior) /
                            (before * before + after * after + damping), 0.0f, 1.0f);
    return 0.5f * sides + 0.25f * gain * OWN_BEND(0) - C(0);
#undef C
#undef OWN_BEND
#undef OTHER_BEND
}

// How a difference changes along its axis, over three lines. CPUs keep it in a plane, GPUs find it anew.
#define STEP_OVER(i, j) fabs(ALONG(d, i - 1, j) - ALONG(d, i + 1, j))
#define STEPS(i) ((STEP_OVER(i, -1) + STEP_OVER(i, 1)) + STEP_OVER(i, 0))
INLINE real step_at(PLANE d, const int y, const int q, const int e, const int half_, const int vertical)
{
    return STEPS(0);
}

// One axis's estimates of green - own by short and long taps, for weights that share the denominator `scale`.
INLINE void taps(PLANE d, PLANE steps, const int y, const int step_y, const int q, const int e, const int half_,
                 const int vertical, real *short_sum, real *long_sum, real *weight, real *scale)
{
#if WIDTH == 1
#define STEP(i) STEPS(i)
#else
#define STEP(i) NEAR((steps) + (size_t)((step_y + (vertical ? (i) : 0)) & MASK) * (2 * half_) + q \
                     + (vertical ? COLUMN(e, 0) : COLUMN(e, i)))
#endif
#define D(i) ALONG(d, i, 0)
    const real middle = STEP(0);
    const real before = EDGE + (((middle + STEP(-1)) + STEP(-2)) + STEP(-3));
    const real after = EDGE + (((middle + STEP(1)) + STEP(2)) + STEP(3));
    const real flat_before = SQUARE(fmin(before, STEEP)), flat_after = SQUARE(fmin(after, STEEP));
    const real here = D(0), last = D(-1), next = D(1);  // signs alternate with the colour
    const real long_before = ((here - last) + D(-2)) + (D(-4) - D(-3));
    const real long_after = ((here - next) + D(2)) + (D(4) - D(3));
    *short_sum = flat_after * (0.6f * here - 0.4f * last) + flat_before * (0.6f * here - 0.4f * next);
    *long_sum = 0.2f * (flat_after * long_before + flat_before * long_after);
    *weight = flat_before + flat_after;
    *scale = flat_before * flat_after;
#undef D
#undef STEP
}

// Green at red and blue sites.
INLINE real green_at(PLANE code, PLANE dh, PLANE dv, PLANE steps_h, PLANE steps_v, const int y, const int q,
                     const int e, const Mosaic m)
{
    const int half_ = m.half_;
    real short_h, short_v, long_h, long_v, weight_h, weight_v, scale_h, scale_v;
    taps(dh, steps_h, y, 0, q, e, half_, 0, &short_h, &long_h, &weight_h, &scale_h);
    taps(dv, steps_v, y, y, q, e, half_, 1, &short_v, &long_v, &weight_v, &scale_v);
    const real share = 1.0f / (weight_h * scale_v + weight_v * scale_h);
    const real short_taps = (short_h * scale_v + short_v * scale_h) * share;
    const real long_taps = (long_h * scale_v + long_v * scale_h) * share;
    const real here = AT(code, 0, 0);
    const real axial = (AT(code, -1, 0) + AT(code, 1, 0)) + (AT(code, 0, -1) + AT(code, 0, 1));
    const real diagonal = (AT(code, -1, -1) + AT(code, 1, 1)) + (AT(code, -1, 1) + AT(code, 1, -1));
    const real level = 0.25f * here + 0.125f * axial + 0.0625f * diagonal;
    const real alike = SQUARE(COLORED * (fmax(level, 0.0f) + DARK)), apart = SQUARE(long_taps);
    const real alpha = (m.longest * alike + m.shortest * apart) / (alike + apart);
    const real green = here + (short_taps + alpha * (long_taps - short_taps));
#if NOISY
    return draw(green, 0.25f * axial, noise_of(0.25f * axial, m), 0.0f, 4.0f);
#else
    return green;
#endif
}

// Green at green sites.
INLINE real green_there(PLANE code, const int y, const int q, const int e, const Mosaic m)
{
    const int half_ = m.half_;
    const real here = AT(code, 0, 0);
#if NOISY
    const real mean = 0.25f * ((AT(code, -1, -1) + AT(code, 1, 1)) + (AT(code, -1, 1) + AT(code, 1, -1)));
    return draw(here, mean, noise_of(mean, m), 0.2f, KEPT_REACH);
#else
    return here;
#endif
}

// Of the Laplacians of green and of the own colour, at red and blue sites: green's square, and the product.
INLINE void slopes_at(PLANE code, PLANE green, PLANE square, PLANE product, const int y, const int q, const int e,
                      const Mosaic m)
{
    const int half_ = m.half_;
#define ROW_BEND(p) (2.0f * AT(p, 0, 0) - (AT(p, 0, -2) + AT(p, 0, 2)))
#define COLUMN_BEND(p) (2.0f * AT(p, 0, 0) - (AT(p, -2, 0) + AT(p, 2, 0)))
    const real green_h = ROW_BEND(green), green_v = COLUMN_BEND(green);
    PUT(SQUARE(green_h) + SQUARE(green_v), ROW(square, 0) + COLUMN(e, 0));
    PUT(green_h * ROW_BEND(code) + green_v * COLUMN_BEND(code), ROW(product, 0) + COLUMN(e, 0));
#undef ROW_BEND
#undef COLUMN_BEND
}

INLINE real gain_of(const real product, const real square, const float sites, const real level, const Mosaic m)
{
    real damping = sites * m.prior;
#if NOISY
    damping += 5.0f * sites * noise_of(level, m);
#endif
    return clamp((product + sites * m.prior) / (square + damping), 0.0f, 1.0f);
}

INLINE real limit_of(const real level, const Mosaic m)
{
#if NOISY
    return ALIKE + 2.0f * sqrt(noise_of(level, m));
#else
    return ALIKE;
#endif
}

// At a red (blue) site the missing blue (red), from its four diagonal neighbours.
INLINE real diagonal_at(PLANE code, PLANE green, PLANE square, PLANE product, const int y, const int q, const int e,
                        const Mosaic m)
{
    const int half_ = m.half_;
#define RING(p, j, i) ((AT(p, -j, -i) + AT(p, j, i)) + (AT(p, -j, i) + AT(p, j, -i)))
#define SITES(p) ((RING(p, 1, 1) + RING(p, 3, 3)) + (RING(p, 1, 3) + RING(p, 3, 1)))
    const real level = AT(green, 0, 0);
    const real gain = gain_of(SITES(product), SITES(square), 16.0f, level, m);
#define REST(j, i) (AT(code, j, i) - gain * AT(green, j, i))
    return gain * level + blend(REST(-1, -1), REST(1, 1), REST(-1, 1), REST(1, -1), limit_of(level, m));
#undef RING
#undef SITES
#undef REST
}

// At a green site the colour that is measured along one axis, and was found across it.
INLINE real axial_at(PLANE code, PLANE other, PLANE green, PLANE square, PLANE product, const int y, const int q,
                     const int e, const int vertical, const Mosaic m)
{
    const int half_ = m.half_;
#define LINE(p, j) ((ALONG(p, -3, j) + ALONG(p, 3, j)) + (ALONG(p, -1, j) + ALONG(p, 1, j)))
#define SITES(p) ((LINE(p, -2) + LINE(p, 2)) + LINE(p, 0))
    const real level = AT(green, 0, 0);
    const real gain = gain_of(SITES(product), SITES(square), 12.0f, level, m);
#define REST(p, i, j) (ALONG(p, i, j) - gain * ALONG(green, i, j))
    return gain * level + blend(REST(code, -1, 0), REST(code, 1, 0), REST(other, 0, -1), REST(other, 0, 1),
                                limit_of(level, m));
#undef LINE
#undef SITES
#undef REST
}

// A measured sample; under noise drawn towards the mean of the four nearest of its colour.
INLINE real measured(const real own, const real mean, const Mosaic m)
{
    return draw(own, mean, noise_of(mean, m), 0.2f, KEPT_REACH);
}

INLINE void put_pair(__global float *restrict out, const int x, const int cols, const real even, const real odd)
{
#if WIDTH == 8
    if (x >= 0 && x + 16 <= cols) {
        vstore8((float8)(even.s0, odd.s0, even.s1, odd.s1, even.s2, odd.s2, even.s3, odd.s3), 0, out + x);
        vstore8((float8)(even.s4, odd.s4, even.s5, odd.s5, even.s6, odd.s6, even.s7, odd.s7), 1, out + x);
        return;
    }
#endif
    for (int lane = 0; lane < WIDTH; ++lane) {
        if (x + 2 * lane < cols) out[x + 2 * lane] = ((float *)&even)[lane];
        if (x + 2 * lane + 1 < cols) out[x + 2 * lane + 1] = ((float *)&odd)[lane];
    }
}

// The picture at WIDTH pairs of columns; `own` is the half (0 or 1) of the row's red or blue sites.
INLINE void colors_at(__global const ushort *restrict raw, PLANE code, PLANE green, PLANE square, PLANE product,
                      PLANE other, __global float *restrict rgb, const int y, const int q, const int own,
                      const Mosaic m)
{
    const int half_ = m.half_, row = y - MARGIN, x = 2 * q - MARGIN;
    const size_t pixels = (size_t)m.rows * m.cols;
    __global float *middle = rgb + pixels + (size_t)row * m.cols;
    __global float *first = is_red_row(row, m.red_row) ? middle - pixels : middle + pixels;
    __global float *last = is_red_row(row, m.red_row) ? middle + pixels : middle - pixels;
    real own_here, green_there, other_there, own_there;
    const real green_here = decode(NEAR(ROW(green, 0) + (own ? half_ : 0)), m);
    const real other_here = decode(NEAR(ROW(other, 0) + (own ? half_ : 0)), m);
    {
        const int e = 1 - own;
        own_there = decode(axial_at(code, other, green, square, product, y, q, e, 0, m), m);
        other_there = decode(axial_at(code, other, green, square, product, y, q, e, 1, m), m);
    }
#if NOISY
    {
        const int e = own;
        const real mean = 0.25f * ((AT(code, -2, 0) + AT(code, 2, 0)) + (AT(code, 0, -2) + AT(code, 0, 2)));
        own_here = decode(measured(AT(code, 0, 0), mean, m), m);
    }
    green_there = decode(NEAR(ROW(green, 0) + (own ? 0 : half_)), m);
#else
    __global const ushort *numbers = raw + (size_t)row * m.cols;  // exactly what was measured, not a squared root
    real even = 0.0f, odd = 0.0f;
#if WIDTH == 8
    if (x + 16 <= m.cols) {
        const ushort8 left = vload8(0, numbers + x), right = vload8(1, numbers + x);
        even = convert_float8((ushort8)(left.even, right.even));
        odd = convert_float8((ushort8)(left.odd, right.odd));
    } else
#endif
        for (int lane = 0; lane < WIDTH; ++lane) {
            if (x + 2 * lane < m.cols) ((float *)&even)[lane] = numbers[x + 2 * lane];
            if (x + 2 * lane + 1 < m.cols) ((float *)&odd)[lane] = numbers[x + 2 * lane + 1];
        }
    even = (even - m.black_level) * m.scale;
    odd = (odd - m.black_level) * m.scale;
    own_here = own ? odd : even;
    green_there = own ? even : odd;
#endif
    put_pair(first, x, m.cols, own ? own_there : own_here, own ? own_here : own_there);
    put_pair(middle, x, m.cols, own ? green_there : green_here, own ? green_here : green_there);
    put_pair(last, x, m.cols, own ? other_there : other_here, own ? other_here : other_there);
}

#define PARAMS                                                                                        \
    const float black_level, const float scale, const float offset, const float variance,             \
    const float shot, const float longest, const float shortest, const float prior,                   \
    const int red_row, const int red_col, const int half_, const int rows, const int cols
#define MOSAIC                                                                               \
    const Mosaic m = {black_level, scale, offset, variance, shot, longest, shortest, \
                      prior, red_row, red_col, half_, rows, cols}
#define FIRST(y) first_own((y) - MARGIN, red_row, red_col)

#if WIDTH == 1
#define SITE(low, count_rows, count)                                            \
    const int y = (int)get_global_id(1) + (low), q = (int)get_global_id(0) + (low) / 2; \
    GUARD(y >= (low) + (count_rows) || q >= (low) / 2 + (count))                \
    MOSAIC

__kernel void encode_all(__global const ushort *restrict raw, PLANE code, const int low, PARAMS)
{
    SITE(low, rows + 2 * (MARGIN - low), (cols + 1) / 2 + MARGIN - low);
    encode_row(raw, code, y, q, m);
}

__kernel void differences(PLANE code, PLANE dh, PLANE dv, const int low, PARAMS)
{
    SITE(low, rows + 2 * (MARGIN - low), (cols + 1) / 2 + MARGIN - low);
    const size_t at = (size_t)y * (2 * half_) + q;
    dh[at] = difference(code, y, q, 0, 0, m);
    dv[at] = difference(code, y, q, 0, 1, m);
    dh[at + half_] = difference(code, y, q, 1, 0, m);
    dv[at + half_] = difference(code, y, q, 1, 1, m);
}

__kernel void greens(PLANE code, PLANE dh, PLANE dv, PLANE green, const int low, PARAMS)
{
    SITE(low, rows + 2 * (MARGIN - low), (cols + 1) / 2 + MARGIN - low);
    const int e = FIRST(y);
    PLANE row = green + (size_t)y * (2 * half_) + q;
    row[e ? half_ : 0] = green_at(code, dh, dv, 0, 0, y, q, e, m);
    row[e ? 0 : half_] = green_there(code, y, q, 1 - e, m);
}

__kernel void slopes(PLANE code, PLANE green, PLANE square, PLANE product, const int low, PARAMS)
{
    SITE(low, rows + 2 * (MARGIN - low), (cols + 1) / 2 + MARGIN - low);
    slopes_at(code, green, square, product, y, q, FIRST(y), m);
}

__kernel void diagonals(PLANE code, PLANE green, PLANE square, PLANE product, PLANE other, const int low, PARAMS)
{
    SITE(low, rows + 2 * (MARGIN - low), (cols + 1) / 2 + MARGIN - low);
    const int e = FIRST(y);
    other[(size_t)y * (2 * half_) + q + (e ? half_ : 0)] =
        diagonal_at(code, green, square, product, y, q, e, m);
}

__kernel void colors(__global const ushort *restrict raw, PLANE code, PLANE green, PLANE square, PLANE product,
                     PLANE other, __global float *restrict rgb, const int low, PARAMS)
{
    SITE(low, rows, (cols + 1) / 2);
    colors_at(raw, code, green, square, product, other, rgb, y, q, FIRST(y), m);
}

#else

#define ALONG_ROW(low) for (int q = (low) / 2; q < half_end - (low) / 2; q += WIDTH)

// Rows [strip * height, (strip + 1) * height) of the picture, one after the other.
__kernel void strip(__global const ushort *restrict raw, __global float *restrict scratch, __global float *restrict rgb,
                    const int height, const int plane, PARAMS)
{
    MOSAIC;
    const int half_end = (cols + 1) / 2 + MARGIN;
    PLANE code = scratch + (size_t)get_global_id(0) * PLANES * plane;
    PLANE dh = code + plane;
    PLANE dv = dh + plane;
    PLANE green = dv + plane;
    PLANE square = green + plane;
    PLANE product = square + plane;
    PLANE other = product + plane;
    PLANE steps_v = other + plane;
    PLANE steps_h = steps_v + plane;  // one row
    const int top = get_global_id(0) * height + MARGIN, bottom = min(top + height, rows + MARGIN);
    for (int line = top - 14; line < bottom + 14; ++line) {
        int y = line;
        ALONG_ROW(0) encode_row(raw, code, y, q, m);
        y = line - 4;
        if (y >= top - 10)
            ALONG_ROW(4) {
                PUT(difference(code, y, q, 0, 0, m), ROW(dh, 0));
                PUT(difference(code, y, q, 0, 1, m), ROW(dv, 0));
                PUT(difference(code, y, q, 1, 0, m), ROW(dh, 0) + half_);
                PUT(difference(code, y, q, 1, 1, m), ROW(dv, 0) + half_);
            }
        y = line - 5;
        if (y >= top - 9)
            ALONG_ROW(4) {
                PUT(step_at(dv, y, q, 0, half_, 1), ROW(steps_v, 0));
                PUT(step_at(dv, y, q, 1, half_, 1), ROW(steps_v, 0) + half_);
            }
        y = line - 8;
        if (y >= top - 6) {
            ALONG_ROW(4) {
                PUT(step_at(dh, y, q, 0, half_, 0), steps_h + q);
                PUT(step_at(dh, y, q, 1, half_, 0), steps_h + half_ + q);
            }
            if (FIRST(y)) {
                ALONG_ROW(8) {
                    PUT(green_at(code, dh, dv, steps_h, steps_v, y, q, 1, m), ROW(green, 0) + half_);
                    PUT(green_there(code, y, q, 0, m), ROW(green, 0));
                }
            } else {
                ALONG_ROW(8) {
                    PUT(green_at(code, dh, dv, steps_h, steps_v, y, q, 0, m), ROW(green, 0));
                    PUT(green_there(code, y, q, 1, m), ROW(green, 0) + half_);
                }
            }
        }
        y = line - 10;
        if (y >= top - 4) {
            if (FIRST(y)) {
                ALONG_ROW(10) slopes_at(code, green, square, product, y, q, 1, m);
            } else {
                ALONG_ROW(10) slopes_at(code, green, square, product, y, q, 0, m);
            }
        }
        y = line - 13;
        if (y >= top - 1) {
            if (FIRST(y)) {
                ALONG_ROW(12) PUT(diagonal_at(code, green, square, product, y, q, 1, m), ROW(other, 0) + half_);
            } else {
                ALONG_ROW(12) PUT(diagonal_at(code, green, square, product, y, q, 0, m), ROW(other, 0));
            }
        }
        y = line - 14;
        if (y >= top && y < bottom) {
            if (FIRST(y)) {
                ALONG_ROW(14) colors_at(raw, code, green, square, product, other, rgb, y, q, 1, m);
            } else {
                ALONG_ROW(14) colors_at(raw, code, green, square, product, other, rgb, y, q, 0, m);
            }
        }
    }
}
#endif
