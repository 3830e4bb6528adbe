// All steps work on scratch planes of encoded samples with a mirrored margin; no step needs to check borders.
// A scratch row is its even columns, then its odd ones ("halves"): the sites of one colour are neighbours in memory.
// Every step computes WIDTH neighbouring sites of one half.
// On CPUs a work-item walks down a strip and runs each step as soon as the rows that it needs are there, on scratch of
// few rows (a ring, rows & MASK) that stays in the cache: one pass over the picture.
// GPUs make three passes over tiles: codes and differences, green, red and blue. Values that only one pass needs stay in
// local memory and are computed again at the seams of tiles; a work-item makes a run of rows and loads neighbours once.
// All sums are symmetric in left and right, up and down, and rows and columns; no contraction: a mirrored mosaic then
// gives the mirrored picture bit for bit.
#pragma OPENCL FP_CONTRACT OFF
#include "bayer.clh"
#include "lanes.clh"

#define PLANE __global float *restrict
#if WIDTH == 8
#define TILE PLANE
#define SLOPES_IN PLANE square, PLANE product
#define SLOPES square, product
typedef float8 __attribute__((aligned(4))) unaligned;  // PoCL's vload8 makes eight loads
#define NEAR(from) (*(__global const unaligned *)(from))
#define PUT(values, to) *(__global unaligned *)(to) = (values)
#else
#define TILE __local float *
#define TILE_PAIRS (PAIRS + 4)  // a tile and its surroundings
#define SLOPES_IN __local float2 *slopes
#define SLOPES slopes
#define NEAR(from) (from)[0]
#define PUT(values, to) (to)[0] = (values)
#endif
#define SQUARE(x) ((x) * (x))
#define MARGIN (WIDTH == 1 ? 16 : 14)  // a pixel of the picture needs 14 around it; 16 aligns a GPU's vectors
#define PLANES 9   // of scratch on a CPU
#define MASK (WIDTH == 1 ? -1 : NOISY ? 31 : 15)
// Thresholds are fractions of the full scale.
#define EDGE (5.0f / 255.0f)   // smaller changes of a difference are not edges
#define STEEP 1e4f             // steeper is as good as that, and its powers do not overflow
#define DARK (10.0f / 255.0f)  // added to a level before a difference is compared with it
#define ALIKE (2.0f / 255.0f)  // pairs that differ by less agree equally well
#define COLORED 0.3f           // difference over level where taps are half long, half short
#define KEPT_REACH 3.0f        // variances of noise within which measured samples are drawn to their neighbours
#define GREEN_REACH 3.5f       // and green found at red and blue
#define KEPT_FOUND 0.34f       // of the noise's variance: in red and blue found elsewhere, on flat fields
#define KEPT_GREEN 0.45f       // and in green before it is drawn

typedef struct {
    float black_level, scale, offset;      // code = root or identity of (DN - black_level) scale + offset
    float variance, shot;                  // of a code: variance + shot * code
    float red, blue;                       // factors of their codes; green's is 1
    float longest, shortest;               // share of the long taps for similar and for different colours
    float prior;                           // mean square bend below which gains stay 1
    int red_row, red_col, half_, rows, cols;
    int corner;                            // of a tile: its first site is at -corner of a plane
    __global const float *loss;            // what squares of mean roots lack, see levels.py
} Mosaic;

// Offset of the pixel i columns right of column 2 q + e, from the start of its row + q.
#define COLUMN(e, i) ((i) & 1 ? ((e) ? 1 : half_) + ((i) - 1) / 2 : ((e) ? half_ : 0) + (i) / 2)
#define ROW(plane, j) ((plane) + (((y + (j)) & MASK) * (2 * half_) + q))  // 32 bits: addresses cost the same as sums
#define AT(plane, j, i) NEAR(ROW(plane, j) + COLUMN(e, i))
// The pixel i steps along and j across, for both axes.
#define ALONG(plane, i, j) (vertical ? AT(plane, i, j) : AT(plane, j, i))
// The same for planes with only red and blue sites: in local memory without the other half of the row.
#if WIDTH == 1
#define OWN(plane, j, i) (plane)[(y + (j)) * TILE_PAIRS + q - m.corner + ((i) & 1 ? e + ((i) - 1) / 2 : (i) / 2)]
#else
#define OWN AT
#endif
#define OWN_ALONG(plane, i, j) (vertical ? OWN(plane, i, j) : OWN(plane, j, i))

// A GPU's correctly rounded quotient takes a dozen instructions; its own, and its root, err by about 2 ulp: 3 roundings
// more each, 21 along the longest chain (6 quotients, a root), next to 48 and within the 96 that the cases allow.
#if WIDTH == 1
#define QUOTIENT(a, b) native_divide(a, b)
#define ROOT_OF native_sqrt
#else
#define QUOTIENT(a, b) ((a) / (b))
#define ROOT_OF sqrt
#endif

INLINE real encode(const real x)
{
#if ROOT
    return copysign(ROOT_OF(fabs(x)), x);
#else
    return x;
#endif
}

INLINE real decode(const real code, const Mosaic m)
{
#if ROOT
    return code * fabs(code) - m.offset;
#else
    return code;
#endif
}

// Factors of the codes of a row's red or blue pixels, and of those that it has not.
INLINE float own_factor(const int y, const Mosaic m) { return is_red_row(y - MARGIN, m.red_row) ? m.red : m.blue; }

INLINE float other_factor(const int y, const Mosaic m) { return is_red_row(y - MARGIN, m.red_row) ? m.blue : m.red; }

INLINE real noise_of(const real level, const float factor, const Mosaic m)
{
    return factor * (factor * m.variance + m.shot * fmax(level, 0.0f));
}

// What the square of a mean root lacks, for means that keep none of the noise's variance.
INLINE real lost(const real square, const Mosaic m)
{
    const real near = fmin(QUOTIENT(m.loss[1], m.loss[0] + fabs(square)), 1.0f);
    return (((m.loss[2] * near + m.loss[3]) * near + m.loss[4]) * near + m.loss[5]) * near + m.loss[6];
}

// A value found from the codes of others: a mean that keeps a part of the noise.
INLINE real decode_found(const real code, const Mosaic m)
{
#if ROOT && NOISY
    return decode(code, m) + (1.0f - KEPT_FOUND) * lost(code * code, m);
#else
    return decode(code, m);
#endif
}

// Means are means of signals, a code's signed square, and are encoded again: this keeps them.
INLINE real signal_of(const real code) { return ROOT ? code * fabs(code) : code; }

// `value` drawn towards `mean` (signals), the more the less they differ by more than noise; `kept` is the share that
// stays. Returns a code.
INLINE real draw(const real value, const real mean, const float factor, const float kept, const float reach,
                 const Mosaic m)
{
    const real change = value - mean;
#if ROOT
    const float noise = factor * factor * m.variance;
    const real level = fmax(0.2f * (4.0f * mean + value), noise);
    const real photons = QUOTIENT(fmax(level - factor * factor * m.offset, 0.0f), fmax(level - 1.5f * noise, 1e-20f));
    const real power = photons * (2.0f / 3.0f);  // noise has no skew where differences are taken between values and roots
    const real apart = (1.0f - power) * QUOTIENT(change, 2.0f * ROOT_OF(level)) + power * (encode(value) - encode(mean));
#else
    const real noise = noise_of(mean, factor, m), apart = change;
#endif
    const real square = apart * apart;
    return encode(mean + change * QUOTIENT(square + kept * noise, square + reach * noise + 1e-20f));
}

// Mean of (p, q) and (r, s) with weights 1 / (|p - q| + limit), 1 / (|r - s| + limit).
INLINE real blend(const real p, const real q, const real r, const real s, const real limit)
{
    const real first = fabs(r - s) + limit, second = fabs(p - q) + limit;
    return QUOTIENT(0.5f * ((p + q) * first + (r + s) * second), first + second);
}

INLINE real encoded(const real number, const float factor, const Mosaic m)
{
    return encode((number - m.black_level) * m.scale + m.offset) * factor;
}

#if WIDTH > 1
INLINE void encode_row(__global const ushort *restrict raw, PLANE code, const int y, const int q, const Mosaic m)
{
    const int half_ = m.half_, x = 2 * q - MARGIN;
    const bool is_odd = first_own(y - MARGIN, m.red_row, m.red_col);
    const float at_even = is_odd ? 1.0f : own_factor(y, m), at_odd = is_odd ? own_factor(y, m) : 1.0f;
    __global const ushort *row = raw + (size_t)mirror(y - MARGIN, m.rows) * m.cols;
    if (x >= 0 && x + 16 <= m.cols) {
        const ushort8 first = vload8(0, row + x), second = vload8(1, row + x);
        const real even = convert_float8((ushort8)(first.even, second.even));
        const real odd = convert_float8((ushort8)(first.odd, second.odd));
        PUT(encoded(even, at_even, m), ROW(code, 0));
        PUT(encoded(odd, at_odd, m), ROW(code, 0) + half_);
        return;
    }
    real even = 0.0f, odd = 0.0f;
    for (int lane = 0; lane < WIDTH; ++lane) {
        ((float *)&even)[lane] = row[mirror(x + 2 * lane, m.cols)];
        ((float *)&odd)[lane] = row[mirror(x + 2 * lane + 1, m.cols)];
    }
    PUT(encoded(even, at_even, m), ROW(code, 0));
    PUT(encoded(odd, at_odd, m), ROW(code, 0) + half_);
}
#endif

// Interpolated other colour of the row (column) minus the own one, with the regressed gain of the Laplacian.
// factor: of the other colour's codes.
INLINE real difference(TILE code, const int y, const int q, const int e, const int half_, const int vertical,
                       const float factor, const Mosaic m)
{
#define C(i) ALONG(code, i, 0)
#define OWN_BEND(i) (2.0f * C(i) - (C(i - 2) + C(i + 2)))
#define OTHER_BEND(i) (0.5f * ((C(i - 1) + C(i + 1)) - (C(i - 3) + C(i + 3))))
    const real before = OTHER_BEND(-1), after = OTHER_BEND(1), sides = C(-1) + C(1);
    real damping = 2.0f * m.prior;
#if NOISY
    damping += 10.0f * noise_of(0.5f * sides, factor, m);
#endif
    const real gain = clamp(QUOTIENT(OWN_BEND(-1) * before + OWN_BEND(1) * after + 2.0f * m.prior,
                                     before * before + after * after + damping), 0.0f, 1.0f);
    return 0.5f * sides + 0.25f * gain * OWN_BEND(0) - C(0);
#undef C
#undef OWN_BEND
#undef OTHER_BEND
}

// Change of a difference along its axis, over three lines. CPUs keep it in a plane, GPUs compute it again.
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
    const real before = EDGE + ((STEP(0) + STEP(-1)) + (STEP(-2) + STEP(-3)));
    const real after = EDGE + ((STEP(0) + STEP(1)) + (STEP(2) + STEP(3)));
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
    const real share = QUOTIENT(1.0f, weight_h * scale_v + weight_v * scale_h);
    const real short_taps = (short_h * scale_v + short_v * scale_h) * share;
    const real long_taps = (long_h * scale_v + long_v * scale_h) * share;
    const real here = AT(code, 0, 0);
    const real axial = (AT(code, -1, 0) + AT(code, 1, 0)) + (AT(code, 0, -1) + AT(code, 0, 1));
    const real diagonal = (AT(code, -1, -1) + AT(code, 1, 1)) + (AT(code, -1, 1) + AT(code, 1, -1));
    const real level = 0.25f * here + 0.125f * axial + 0.0625f * diagonal;
    const real alike = SQUARE(COLORED * (fmax(level, 0.0f) + DARK)), apart = SQUARE(long_taps);
    const real alpha = QUOTIENT(m.longest * alike + m.shortest * apart, alike + apart);
    const real green = here + (short_taps + alpha * (long_taps - short_taps));
#if NOISY
#define SIGNAL(j, i) signal_of(AT(code, j, i))
    const real mean = 0.25f * ((SIGNAL(-1, 0) + SIGNAL(1, 0)) + (SIGNAL(0, -1) + SIGNAL(0, 1)));
#if ROOT
    const real value = signal_of(green) + (1.0f - KEPT_GREEN) * lost(green * green, m);
#else
    const real value = green;
#endif
    return draw(value, mean, 1.0f, 0.0f, GREEN_REACH, m);
#else
    return green;
#endif
}

// Green at green sites.
INLINE real green_there(PLANE code, const int y, const int q, const int e, const Mosaic m)
{
    const int half_ = m.half_;
#if NOISY
    const real mean = 0.25f * ((SIGNAL(-1, -1) + SIGNAL(1, 1)) + (SIGNAL(-1, 1) + SIGNAL(1, -1)));
    return draw(SIGNAL(0, 0), mean, 1.0f, 0.2f, KEPT_REACH, m);
#else
    return AT(code, 0, 0);
#endif
}

// Of the Laplacians of green and of the own colour, at red and blue sites: green's square, and the product.
INLINE void slopes_at(PLANE code, PLANE green, SLOPES_IN, const int y, const int q, const int e, const Mosaic m)
{
    const int half_ = m.half_;
#define ROW_BEND(p) (2.0f * AT(p, 0, 0) - (AT(p, 0, -2) + AT(p, 0, 2)))
#define COLUMN_BEND(p) (2.0f * AT(p, 0, 0) - (AT(p, -2, 0) + AT(p, 2, 0)))
    const real green_h = ROW_BEND(green), green_v = COLUMN_BEND(green);
    const real squares = SQUARE(green_h) + SQUARE(green_v);
    const real products = green_h * ROW_BEND(code) + green_v * COLUMN_BEND(code);
#if WIDTH == 1
    OWN(slopes, 0, 0) = (float2)(squares, products);
#else
    PUT(squares, &OWN(square, 0, 0));
    PUT(products, &OWN(product, 0, 0));
#endif
#undef ROW_BEND
#undef COLUMN_BEND
}

INLINE real gain_of(const real product, const real square, const float sites, const real level, const Mosaic m)
{
    real damping = sites * m.prior;
#if NOISY
    damping += 5.0f * sites * noise_of(level, 1.0f, m);
#endif
    return clamp(QUOTIENT(product + sites * m.prior, square + damping), 0.0f, 1.0f);
}

// From the sums over the macro SITES.
#if WIDTH == 1
#define GAIN(sites, level) gain_over(SITES(slopes), sites, level, m)
INLINE real gain_over(const float2 sums, const float sites, const real level, const Mosaic m)
{
    return gain_of(sums.y, sums.x, sites, level, m);
}
#else
#define GAIN(sites, level) gain_of(SITES(product), SITES(square), sites, level, m)
#endif

INLINE real limit_of(const real level, const float factor, const Mosaic m)
{
#if NOISY
    return ALIKE + 2.0f * sqrt(noise_of(level, factor, m));
#else
    return ALIKE;
#endif
}

// At a red (blue) site the missing blue (red), from its four diagonal neighbours.
INLINE real diagonal_at(PLANE code, PLANE green, SLOPES_IN, const int y, const int q, const int e,
                        const Mosaic m)
{
    const int half_ = m.half_;
#define RING(p, j, i) ((OWN(p, -j, -i) + OWN(p, j, i)) + (OWN(p, -j, i) + OWN(p, j, -i)))
#define SITES(p) ((RING(p, 1, 1) + RING(p, 3, 3)) + (RING(p, 1, 3) + RING(p, 3, 1)))
    const real level = AT(green, 0, 0);
    const real gain = GAIN(16.0f, level);
#define REST(j, i) (AT(code, j, i) - gain * AT(green, j, i))
    return gain * level + blend(REST(-1, -1), REST(1, 1), REST(-1, 1), REST(1, -1),
                                limit_of(level, other_factor(y, m), m));
#undef RING
#undef SITES
#undef REST
}

// At a green site the colour that is measured along one axis, and was found across it.
INLINE real axial_at(PLANE code, TILE other, PLANE green, SLOPES_IN, const int y, const int q,
                     const int e, const int vertical, const Mosaic m)
{
    const int half_ = m.half_;
#define LINE(p, j) ((OWN_ALONG(p, -3, j) + OWN_ALONG(p, 3, j)) + (OWN_ALONG(p, -1, j) + OWN_ALONG(p, 1, j)))
#define SITES(p) ((LINE(p, -2) + LINE(p, 2)) + LINE(p, 0))
    const real level = AT(green, 0, 0);
    const real gain = GAIN(12.0f, level);
#define REST(p, i, j) (p - gain * ALONG(green, i, j))
    return gain * level + blend(REST(ALONG(code, -1, 0), -1, 0), REST(ALONG(code, 1, 0), 1, 0),
                                REST(OWN_ALONG(other, 0, -1), 0, -1), REST(OWN_ALONG(other, 0, 1), 0, 1),
                                limit_of(level, vertical ? other_factor(y, m) : own_factor(y, m), m));
#undef LINE
#undef SITES
#undef REST
}

INLINE void put_pair(__global float *restrict out, const int x, const int cols, const real even, const real odd)
{
#if WIDTH == 8
    if (x >= 0 && x + 16 <= cols) {
        vstore8((float8)(even.s0, odd.s0, even.s1, odd.s1, even.s2, odd.s2, even.s3, odd.s3), 0, out + x);
        vstore8((float8)(even.s4, odd.s4, even.s5, odd.s5, even.s6, odd.s6, even.s7, odd.s7), 1, out + x);
        return;
    }
#else
    if (!(cols & 1)) {
        if (x < cols) *(__global float2 *)(out + x) = (float2)(even, odd);
        return;
    }
#endif
    for (int lane = 0; lane < WIDTH; ++lane) {
        if (x + 2 * lane < cols) out[x + 2 * lane] = ((float *)&even)[lane];
        if (x + 2 * lane + 1 < cols) out[x + 2 * lane + 1] = ((float *)&odd)[lane];
    }
}

// The picture at WIDTH pairs of columns; `own` is the half (0 or 1) of the row's red or blue sites.
INLINE void colors_at(__global const ushort *restrict raw, PLANE code, PLANE green, SLOPES_IN,
                      TILE other, __global float *restrict rgb, const int y, const int q, const int own,
                      const Mosaic m)
{
#if WIDTH == 1
    const int row = min(y - MARGIN, m.rows - 1), x = y - MARGIN < m.rows ? 2 * q - MARGIN : m.cols;  // nothing beyond
#else
    const int row = y - MARGIN, x = 2 * q - MARGIN;
#endif
    const int half_ = m.half_;
    const size_t pixels = (size_t)m.rows * m.cols;
    __global float *middle = rgb + pixels + (size_t)row * m.cols;
    __global float *first = is_red_row(row, m.red_row) ? middle - pixels : middle + pixels;
    __global float *last = is_red_row(row, m.red_row) ? middle + pixels : middle - pixels;
    const float own_inverse = 1.0f / own_factor(y, m), other_inverse = 1.0f / other_factor(y, m);
    real own_here, green_there, other_there, own_there;
    const real green_here = decode(NEAR(ROW(green, 0) + (own ? half_ : 0)), m);
    real other_here;
    {
        const int e = own;
        other_here = decode_found(OWN(other, 0, 0) * other_inverse, m);
    }
    {
        const int e = 1 - own;
        own_there = decode_found(axial_at(code, other, green, SLOPES, y, q, e, 0, m) * own_inverse, m);
        other_there = decode_found(axial_at(code, other, green, SLOPES, y, q, e, 1, m) * other_inverse, m);
    }
#if NOISY
    {
        const int e = own;
        const real mean = 0.25f * ((SIGNAL(-2, 0) + SIGNAL(2, 0)) + (SIGNAL(0, -2) + SIGNAL(0, 2)));
        own_here = decode(draw(SIGNAL(0, 0), mean, own_factor(y, m), 0.2f, KEPT_REACH, m) * own_inverse, m);
    }
    green_there = decode(NEAR(ROW(green, 0) + (own ? 0 : half_)), m);
#else
    __global const ushort *numbers = raw + (size_t)row * m.cols;  // exactly the measured sample, not a squared root
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
    __global const float *restrict loss, const float black_level, const float scale, const float offset, \
    const float variance, const float shot, const float red, const float blue,                        \
    const float longest, const float shortest, const float prior,                                     \
    const int red_row, const int red_col, const int half_, const int rows, const int cols
#define MOSAIC(corner)                                                               \
    const Mosaic m = {black_level, scale, offset, variance, shot, red, blue, longest, shortest, \
                      prior, red_row, red_col, half_, rows, cols, corner, loss}
#define FIRST(y) first_own((y) - MARGIN, red_row, red_col)
// Of the other colour along a row (h) and a column (v), at even and odd columns: green's at red and blue.
#define FACTORS(y)                                                                                          \
    const float even_h = FIRST(y) ? own_factor(y, m) : 1.0f, odd_h = FIRST(y) ? 1.0f : own_factor(y, m);    \
    const float even_v = FIRST(y) ? other_factor(y, m) : 1.0f, odd_v = FIRST(y) ? 1.0f : other_factor(y, m);

#if WIDTH == 1
// A tile is HIGH rows of PAIRS pairs, a work-group GROUP work-items. Planes have room for whole tiles: only the picture
// asks for its end.
#define FIRST_ROW(low) (int)get_group_id(1) * HIGH + (low)
#define FIRST_PAIR(low) (int)get_group_id(0) * PAIRS + (low) / 2

// Codes, and differences along the rows (dh) and columns (dv).
__kernel void differences(__global const ushort *restrict raw, PLANE code, PLANE dh, PLANE dv, PARAMS)
{
    MOSAIC(0);
    __local float tile[(HIGH + 8) * 2 * TILE_PAIRS];
    const int first_y = FIRST_ROW(MARGIN - 10), first_q = FIRST_PAIR(0);
    for (int site = get_local_id(0); site < (HIGH + 8) * TILE_PAIRS; site += GROUP) {
        const int y = site / TILE_PAIRS, q = site % TILE_PAIRS, x = 2 * (first_q - 2 + q) - MARGIN;
        __global const ushort *row = raw + (size_t)mirror(first_y - 4 + y - MARGIN, rows) * cols;
        float even, odd;
        if (x >= 0 && x + 1 < cols && !(cols & 1)) {
            const ushort2 pair = *(__global const ushort2 *)(row + x);
            even = pair.x;
            odd = pair.y;
        } else {
            even = row[mirror(x, cols)];
            odd = row[mirror(x + 1, cols)];
        }
        const int row_y = first_y - 4 + y, is_odd = FIRST(row_y);
        tile[y * 2 * TILE_PAIRS + q] = encoded(even, is_odd ? 1.0f : own_factor(row_y, m), m);
        tile[y * 2 * TILE_PAIRS + q + TILE_PAIRS] = encoded(odd, is_odd ? own_factor(row_y, m) : 1.0f, m);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int run = get_local_id(0); run < HIGH / RUN * PAIRS; run += GROUP) {
        const int first = run / PAIRS * RUN, q = run % PAIRS + 2;
#pragma unroll
        for (int y = first + 4; y < first + 4 + RUN; ++y) {
            const size_t at = (size_t)(first_y + y - 4) * (2 * half_) + first_q + q - 2;
            code[at] = tile[y * 2 * TILE_PAIRS + q];
            FACTORS(first_y + y - 4)
            dh[at] = difference(tile, y, q, 0, TILE_PAIRS, 0, even_h, m);
            dv[at] = difference(tile, y, q, 0, TILE_PAIRS, 1, even_v, m);
            code[at + half_] = tile[y * 2 * TILE_PAIRS + q + TILE_PAIRS];
            dh[at + half_] = difference(tile, y, q, 1, TILE_PAIRS, 0, odd_h, m);
            dv[at + half_] = difference(tile, y, q, 1, TILE_PAIRS, 1, odd_v, m);
        }
    }
}

// Runs of every other row, which have their red and blue sites in the same half.
#define ROW_OF_RUN(n, run) ((n) / 2 * 2 * (run) + (n) % 2)

__kernel void greens(PLANE code, PLANE dh, PLANE dv, PLANE green, PARAMS)
{
    MOSAIC(0);
    const int first = ROW_OF_RUN((int)get_global_id(1), RUN) + MARGIN - 6, q = get_global_id(0), e = FIRST(first);
#pragma unroll
    for (int n = 0; n < RUN; ++n) {
        const int y = first + 2 * n;
        PLANE row = green + (size_t)y * (2 * half_) + q;
        row[e ? half_ : 0] = green_at(code, dh, dv, 0, 0, y, q, e, m);
        row[e ? 0 : half_] = green_there(code, y, q, 1 - e, m);
    }
}

// Do a step at all sites of a tile and `around` it; `run` rows per work-item.
#define EVERYWHERE(around, run, step)                                                                   \
    for (int n = get_local_id(0); n < (HIGH + 2 * (around)) / (run) * (PAIRS + ((around) + 1) / 2 * 2); \
         n += GROUP) {                                                                                  \
        const int wide = PAIRS + ((around) + 1) / 2 * 2, q = first_q - ((around) + 1) / 2 + n % wide;   \
        const int first = first_y - (around) + ROW_OF_RUN(n / wide, run), e = FIRST(first);             \
        _Pragma("unroll")                                                                               \
        for (int y = first; y < first + 2 * (run); y += 2) step;                                        \
    }

__kernel void colors(__global const ushort *restrict raw, PLANE code, PLANE green, __global float *restrict rgb, PARAMS)
{
    __local float2 slopes[(HIGH + 8) * TILE_PAIRS];
    __local float other[(HIGH + 8) * TILE_PAIRS];
    const int first_y = FIRST_ROW(MARGIN), first_q = FIRST_PAIR(MARGIN);
    MOSAIC((first_y - 4) * TILE_PAIRS + first_q - 2);
    EVERYWHERE(4, RUN, slopes_at(code, green, SLOPES, y, q, e, m))
    barrier(CLK_LOCAL_MEM_FENCE);
    EVERYWHERE(1, RUN_DIAGONALS, OWN(other, 0, 0) = diagonal_at(code, green, SLOPES, y, q, e, m))
    barrier(CLK_LOCAL_MEM_FENCE);
    EVERYWHERE(0, RUN, colors_at(raw, code, green, SLOPES, other, rgb, y, q, e, m))
}

#else

#define ALONG_ROW(low) for (int q = (low) / 2; q < half_end - (low) / 2; q += WIDTH)

// Rows [strip * height, (strip + 1) * height) of the picture, one after the other.
__kernel void strip(__global const ushort *restrict raw, __global float *restrict scratch, __global float *restrict rgb,
                    const int height, const int plane, PARAMS)
{
    MOSAIC(0);
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
        if (y >= top - 10) {
            FACTORS(y)
            ALONG_ROW(4) {
                PUT(difference(code, y, q, 0, half_, 0, even_h, m), ROW(dh, 0));
                PUT(difference(code, y, q, 0, half_, 1, even_v, m), ROW(dv, 0));
                PUT(difference(code, y, q, 1, half_, 0, odd_h, m), ROW(dh, 0) + half_);
                PUT(difference(code, y, q, 1, half_, 1, odd_v, m), ROW(dv, 0) + half_);
            }
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
                ALONG_ROW(10) slopes_at(code, green, SLOPES, y, q, 1, m);
            } else {
                ALONG_ROW(10) slopes_at(code, green, SLOPES, y, q, 0, m);
            }
        }
        y = line - 13;
        if (y >= top - 1) {
            if (FIRST(y)) {
                ALONG_ROW(12) PUT(diagonal_at(code, green, SLOPES, y, q, 1, m), ROW(other, 0) + half_);
            } else {
                ALONG_ROW(12) PUT(diagonal_at(code, green, SLOPES, y, q, 0, m), ROW(other, 0));
            }
        }
        y = line - 14;
        if (y >= top && y < bottom) {
            if (FIRST(y)) {
                ALONG_ROW(14) colors_at(raw, code, green, SLOPES, other, rgb, y, q, 1, m);
            } else {
                ALONG_ROW(14) colors_at(raw, code, green, SLOPES, other, rgb, y, q, 0, m);
            }
        }
    }
}
#endif
