// Tiles on CPUs: a work-item has one; every transform is of eight lines in the lanes of a vector, and all of it stays in
// a core's cache. Two real planes are the real and the imaginary part of one complex tile, and so are two outputs.
// From the host: SIDE of a tile, OVERLAP, PERIOD_Y and PERIOD_X of the mosaic, 1 of channels; OUTPUTS: the mosaic's
// phases, or the channels; OF, the channel of each; CHANNELS; PAIRS of planes at a time; BORDER; COLUMNS, ROWS, BACK_X
// and BACK_Y: LANES_PASSes along a column and a row, and back.
#include "border.clh"
#include "lanes_fft.clh"

#define GROUPS (SIDE / 8)
#define SMALL_Y (SIDE / PERIOD_Y)
#define SMALL_X (SIDE / PERIOD_X)
#define SMALL_GROUPS (SMALL_Y / 8)  // of the folded spectrum
#define VALID (SIDE - 2 * OVERLAP)
#define IMAGES (PERIOD_Y * PERIOD_X == 1 ? OUTPUTS : 1)
#define OUTPUT_PAIRS ((OUTPUTS + 1) / 2)

#define TO_A(e, re, im) ar[e] = re, ai[e] = im;
#define TO_B(e, re, im) br[e] = re, bi[e] = im;
#define FROM_A(e, re, im) re = ar[e], im = ai[e];
#define FROM_B(e, re, im) re = br[e], im = bi[e];

__kernel void weights(
    // in:
    __global const float *restrict tables,  // [1 or CHANNELS][count][SIDE / 2 + 1][SIDE / 2 + 1]
    __global const float *restrict mix,     // [CHANNELS][count]
    // out:
    __global float *restrict out,           // [SIDE / 2 + 1][GROUPS][even count][CHANNELS][8]
    // params:
    const int own_tables,
    // sizes:
    const int count)
{
    const int x = get_global_id(0), y = get_global_id(1), even = count + count % 2;
    for (int k = 0; k < even; ++k)
        for (int c = 0; c < CHANNELS; ++c) {
            const size_t table = (size_t)(own_tables * c * count + k) * (SIDE / 2 + 1);
            // halves: of the sums that separate two planes; the rest is the norm of transforms of this size
            out[(((x * GROUPS + y / 8) * even + k) * CHANNELS + c) * 8 + y % 8] =
                k < count ? mix[c * count + k] * tables[(table + min(y, SIDE - y)) * (SIDE / 2 + 1) + x]
                                * (0.5f / (SIDE * SIDE)) : 0.0f;
        }
}

// Eight neighbours of a plane's row that begin at x, or pixels in their place; columns: of the tile's place.
FFT_INLINE float8 light(__global const float *restrict row, const int is_dark, const int is_inside, const int x,
                        const int *columns)
{
    if (is_dark) return (float8)(0.0f);
    if (is_inside) return vload8(0, row + x);
    float8 values;
#pragma unroll
    for (int lane = 0; lane < 8; ++lane) ((float *)&values)[lane] = columns[lane] < 0 ? 0.0f : row[columns[lane]];
    return values;
}

FFT_INLINE float8 reversed(const float8 last, const float8 first)
{
    return (float8)(first.s0, last.s7, last.s6, last.s5, last.s4, last.s3, last.s2, last.s1);
}

__kernel void tiles(
    // in:
    __global const float *restrict planes,    // [count][rows][cols]
    __global const float *restrict weights,   // [SIDE / 2 + 1][GROUPS][even count][CHANNELS][8]
    __global const float2 *restrict roots,    // [SIDE]
    __global const float *restrict turns,     // [PERIOD_Y][2][SIDE]: of the rows of the mosaic
    // out:
    __global float *restrict out,             // [IMAGES][out_rows][out_cols]
    // params:
    const int margin,
    // sizes:
    const int count, const int rows, const int cols, const int out_rows, const int out_cols, const int across)
{
    const int of[OUTPUTS] = {OF};
    const int tile_y = get_global_id(0) / across * VALID, tile_x = get_global_id(0) % across * VALID;
    const int top = tile_y + margin - OVERLAP, left = tile_x + margin - OVERLAP, even = count + count % 2;
    float8 ar[SIDE], ai[SIDE], br[SIDE], bi[SIDE];
    float8 spectra_re[PAIRS][SIDE * GROUPS], spectra_im[PAIRS][SIDE * GROUPS];  // [x][groups of y]
    float8 folded_re[OUTPUT_PAIRS][SMALL_X * SMALL_GROUPS], folded_im[OUTPUT_PAIRS][SMALL_X * SMALL_GROUPS];
    float image[IMAGES][SIDE * SIDE];
    int lines[SIDE], columns[SIDE];
    for (int i = 0; i < SIDE; ++i) {
        lines[i] = inside_of(top + i, rows);
        columns[i] = inside_of(left + i, cols);
    }
    const int is_inside = left >= 0 && left + SIDE <= cols;
    for (int first = 0; first < count; first += 2 * PAIRS) {
        const int pairs = min(PAIRS, (count - first + 1) / 2);
        for (int p = 0; p < pairs; ++p) {
            const int k = first + 2 * p, is_alone = k + 1 == count;
            __global const float *one = planes + (size_t)k * rows * cols;
            __global const float *two = one + (is_alone ? 0 : (size_t)rows * cols);
            float8 *to_re = spectra_re[p], *to_im = spectra_im[p];
            for (int x = 0; x < SIDE; x += 8) {
#define LOAD(e, re, im)                                                                                            \
    {                                                                                                              \
        const size_t from = (size_t)max(lines[e], 0) * cols;                                                       \
        re = light(one + from, lines[e] < 0, is_inside, left + x, columns + x);                                    \
        im = light(two + from, is_alone || lines[e] < 0, is_inside, left + x, columns + x);                        \
    }
                COLUMNS
#undef LOAD
                for (int g = 0; g < GROUPS; ++g) {
                    transpose(br + 8 * g);
                    transpose(bi + 8 * g);
#pragma unroll
                    for (int j = 0; j < 8; ++j) {
                        to_re[(x + j) * GROUPS + g] = br[8 * g + j];
                        to_im[(x + j) * GROUPS + g] = bi[8 * g + j];
                    }
                }
            }
            for (int g = 0; g < GROUPS; ++g) {
#define LOAD(e, re, im) re = to_re[(e) * GROUPS + g], im = to_im[(e) * GROUPS + g];
#define SAVE(e, re, im) to_re[(e) * GROUPS + g] = re, to_im[(e) * GROUPS + g] = im;
                ROWS
#undef LOAD
#undef SAVE
            }
        }
        for (int x = 0; x < SMALL_X; ++x)
            for (int g = 0; g < SMALL_GROUPS; ++g) {
                float8 sums_re[OUTPUT_PAIRS], sums_im[OUTPUT_PAIRS];
#pragma unroll
                for (int o = 0; o < OUTPUT_PAIRS; ++o) {
                    sums_re[o] = first ? folded_re[o][x * SMALL_GROUPS + g] : 0.0f;
                    sums_im[o] = first ? folded_im[o][x * SMALL_GROUPS + g] : 0.0f;
                }
#pragma unroll
                for (int b = 0; b < PERIOD_X; ++b)
#pragma unroll
                    for (int a = 0; a < PERIOD_Y; ++a) {
                        const int fx = x + b * SMALL_X, fg = g + a * SMALL_GROUPS, opposite = (SIDE - fx) % SIDE;
                        const int at = fx * GROUPS + fg, last = opposite * GROUPS + GROUPS - 1 - fg;
                        const int next = opposite * GROUPS + (GROUPS - fg) % GROUPS;
                        __global const float *weight = weights + ((size_t)(min(fx, SIDE - fx) * GROUPS + fg) * even
                                                                  + first) * CHANNELS * 8;
                        float8 total_re[CHANNELS], total_im[CHANNELS];
#pragma unroll
                        for (int c = 0; c < CHANNELS; ++c) total_re[c] = total_im[c] = 0.0f;
                        for (int p = 0; p < pairs; ++p) {
                            const float8 re = spectra_re[p][at], im = spectra_im[p][at];
                            const float8 back_re = reversed(spectra_re[p][last], spectra_re[p][next]);
                            const float8 back_im = reversed(spectra_im[p][last], spectra_im[p][next]);
                            const float8 one_re = re + back_re, one_im = im - back_im;
                            const float8 two_re = im + back_im, two_im = back_re - re;
#pragma unroll
                            for (int c = 0; c < CHANNELS; ++c) {
                                const float8 v = vload8(2 * p * CHANNELS + c, weight);
                                const float8 w = vload8((2 * p + 1) * CHANNELS + c, weight);
                                total_re[c] += v * one_re + w * two_re;
                                total_im[c] += v * one_im + w * two_im;
                            }
                        }
#pragma unroll
                        for (int o = 0; o < OUTPUTS; ++o) {
                            float8 re = total_re[of[o]], im = total_im[of[o]];
                            const int dy = PERIOD_Y * PERIOD_X == 1 ? 0 : o / PERIOD_X;
                            const int dx = PERIOD_Y * PERIOD_X == 1 ? 0 : o % PERIOD_X;
                            if (dy) {
                                const float8 c = vload8(2 * dy * GROUPS + fg, turns), old = re;
                                const float8 s = vload8((2 * dy + 1) * GROUPS + fg, turns);
                                re = c * old - s * im;
                                im = c * im + s * old;
                            }
                            if (dx) {
                                const float2 t = roots[fx * dx % SIDE];
                                const float8 old = re;
                                re = t.x * old - t.y * im;
                                im = t.x * im + t.y * old;
                            }
                            sums_re[o / 2] += o % 2 ? -im : re;
                            sums_im[o / 2] += o % 2 ? re : im;
                        }
                    }
#pragma unroll
                for (int o = 0; o < OUTPUT_PAIRS; ++o) {
                    folded_re[o][x * SMALL_GROUPS + g] = sums_re[o];
                    folded_im[o][x * SMALL_GROUPS + g] = sums_im[o];
                }
            }
    }
    for (int o = 0; o < OUTPUT_PAIRS; ++o) {
        float8 *lines_re = spectra_re[0], *lines_im = spectra_im[0];  // [y][groups of x]
        for (int g = 0; g < SMALL_GROUPS; ++g) {
#define LOAD(e, re, im) re = folded_re[o][(e) * SMALL_GROUPS + g], im = folded_im[o][(e) * SMALL_GROUPS + g];
            BACK_X
#undef LOAD
            for (int x = 0; x < SMALL_X / 8; ++x) {
                transpose(br + 8 * x);
                transpose(bi + 8 * x);
#pragma unroll
                for (int j = 0; j < 8; ++j) {
                    lines_re[(8 * g + j) * (SMALL_X / 8) + x] = br[8 * x + j];
                    lines_im[(8 * g + j) * (SMALL_X / 8) + x] = bi[8 * x + j];
                }
            }
        }
        for (int g = 0; g < SMALL_X / 8; ++g) {
#define LOAD(e, re, im) re = lines_re[(e) * (SMALL_X / 8) + g], im = lines_im[(e) * (SMALL_X / 8) + g];
            BACK_Y
#undef LOAD
            for (int y = 0; y < SMALL_Y; ++y) {
#if PERIOD_X == 2
                float *to = image[0] + (y * PERIOD_Y + o) * SIDE + 16 * g;
                vstore8((float8)(br[y].s0, bi[y].s0, br[y].s1, bi[y].s1, br[y].s2, bi[y].s2, br[y].s3, bi[y].s3), 0, to);
                vstore8((float8)(br[y].s4, bi[y].s4, br[y].s5, bi[y].s5, br[y].s6, bi[y].s6, br[y].s7, bi[y].s7), 1, to);
#else
                for (int half_ = 0; half_ < 2 && 2 * o + half_ < OUTPUTS; ++half_) {
                    const float8 values = half_ ? bi[y] : br[y];
                    const int out_ = 2 * o + half_;
                    if (PERIOD_Y * PERIOD_X == 1)
                        vstore8(values, 0, image[out_] + y * SIDE + 8 * g);
                    else
                        for (int lane = 0; lane < 8; ++lane)
                            image[0][(y * PERIOD_Y + out_ / PERIOD_X) * SIDE + (8 * g + lane) * PERIOD_X
                                     + out_ % PERIOD_X] = ((float *)&values)[lane];
                }
#endif
            }
        }
    }
    const int most_y = min(VALID, out_rows - tile_y), most_x = min(VALID, out_cols - tile_x);
    for (int n = 0; n < IMAGES; ++n)
        for (int y = 0; y < most_y; ++y) {
            __global float *to = out + ((size_t)n * out_rows + tile_y + y) * out_cols + tile_x;
            const float *from = image[n] + (y + OVERLAP) * SIDE + OVERLAP;
            for (int x = 0; x < most_x; ++x) to[x] = from[x];
        }
}
