// Tiles on GPUs: a work-group has one, in local memory. Two real planes are the real and the imaginary part of one
// complex tile, and so are two outputs.
// From the host: THREADS of a group, SIDE of a tile, OVERLAP, PERIOD_Y and PERIOD_X of the mosaic, 1 of channels;
// OUTPUTS: the mosaic's phases, or the channels; OF, the channel of each; CHANNELS; BORDER; COLUMNS, ROWS, BACK_X and
// BACK_Y: TILE_PASSes along columns and rows, and back; TURNS_Y and TURNS_X, roots of unity of the periods.
#include "border.clh"
#include "fft.clh"

#define SMALL_Y (SIDE / PERIOD_Y)
#define SMALL_X (SIDE / PERIOD_X)
#define VALID (SIDE - 2 * OVERLAP)
#define PITCH (SIDE + 1)  // odd, so that lines side by side meet all banks
#define SMALL_PITCH (SMALL_X + 1)
#define IS_MOSAIC (PERIOD_Y * PERIOD_X > 1)
#define IMAGES ((OUTPUTS + 1) / 2)         // complex ones, two outputs in each
#define TOGETHER (IS_MOSAIC ? IMAGES : 1)  // of them that are in local memory at once
#define OWN ((SMALL_Y * SMALL_X + THREADS - 1) / THREADS)  // frequencies of a work-item

// Places of element e of line l: along columns and rows of the tile, of the images that are together.
#define COLUMN(l, e) ((e) * PITCH + (l))
#define ROW(l, e) ((l) * PITCH + (e))
#define BACK_COLUMN(l, e) (((l) / SMALL_X * SMALL_Y + (e)) * SMALL_PITCH + (l) % SMALL_X)
#define BACK_ROW(l, e) ((l) * SMALL_PITCH + (e))

// One Stockham pass over LINES lines in place, as PASS of fft.clh, but neighbouring work-items have neighbouring lines.
#define TILE_PASS(RADIX, DONE, LENGTH, LINES, STEP, SIGN, PLACE)                                                   \
    {                                                                                                              \
        float2 v[(LINES * (LENGTH / RADIX) + THREADS - 1) / THREADS][RADIX];                                       \
        _Pragma("unroll") for (int n = 0; n * THREADS < LINES * (LENGTH / RADIX); ++n) {                           \
            const int j = item + n * THREADS, l = j % (LINES), i = j / (LINES), k = i % DONE;                      \
            if (j < LINES * (LENGTH / RADIX)) {                                                                    \
                _Pragma("unroll") for (int m = 0; m < RADIX; ++m) {                                                \
                    const int e = i + m * (LENGTH / RADIX);                                                        \
                    v[n][m] = DONE == 1 ? LOAD(l, e) : line[PLACE(l, e)];                                          \
                    if (DONE > 1 && m > 0) {                                                                       \
                        const float2 root = roots[m * k * (LENGTH / (RADIX * DONE) * STEP)];                       \
                        v[n][m] = times(v[n][m], PAIR(root.x, SIGN * root.y));                                     \
                    }                                                                                              \
                }                                                                                                  \
                transform_##RADIX(v[n], SIGN);                                                                     \
            }                                                                                                      \
        }                                                                                                          \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                              \
        _Pragma("unroll") for (int n = 0; n * THREADS < LINES * (LENGTH / RADIX); ++n) {                           \
            const int j = item + n * THREADS, l = j % (LINES), i = j / (LINES), k = i % DONE;                      \
            if (j < LINES * (LENGTH / RADIX)) {                                                                    \
                _Pragma("unroll") for (int m = 0; m < RADIX; ++m) {                                                \
                    const int e = (i - k) * RADIX + k + m * DONE;                                                  \
                    line[PLACE(l, e)] = v[n][m];                                                                   \
                }                                                                                                  \
            }                                                                                                      \
        }                                                                                                          \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                              \
    }

// Two planes' samples at row v, column u; -1 where it is dark.
float2 light(__global const float *restrict planes, const int v, const int u, const int cols, const int plane,
             const int is_alone)
{
    const int at = v * cols + u;
    return v < 0 || u < 0 ? PAIR(0.0f, 0.0f) : PAIR(planes[at], is_alone ? 0.0f : planes[at + plane]);
}

__kernel void tiles(
    // in:
    __global const float *restrict planes,  // [count][rows][cols]
    __global const float *restrict tables,  // [1 or CHANNELS][count][SIDE / 2 + 1][SIDE / 2 + 1]
    __constant float *mix,                  // [CHANNELS][count]
    __global const float2 *restrict roots,  // [SIDE]
    // out:
    __global float *restrict out,           // [1 or OUTPUTS][out_rows][out_cols]
    // params:
    const int own_tables, const int margin,
    // sizes:
    const int count, const int rows, const int cols, const int out_rows, const int out_cols, const int across)
{
    LOCAL(float2, line, LOCAL_BYTES / 8);
    const float2 turns_y[PERIOD_Y] = {TURNS_Y}, turns_x[PERIOD_X] = {TURNS_X};
    const int of[OUTPUTS] = {OF};
    const int item = get_local_id(0);
    const int tile_y = get_group_id(0) / across * VALID, tile_x = get_group_id(0) % across * VALID;
    const int top = tile_y + margin - OVERLAP, left = tile_x + margin - OVERLAP;
    const int quarter = (SIDE / 2 + 1) * (SIDE / 2 + 1), between = own_tables * count * quarter;
    float2 sums[IMAGES][OWN];
    _Pragma("unroll") for (int o = 0; o < IMAGES; ++o)
        _Pragma("unroll") for (int n = 0; n < OWN; ++n) sums[o][n] = PAIR(0.0f, 0.0f);
    for (int k = 0; k < count; k += 2) {
        __global const float *pair = planes + (size_t)k * rows * cols;
        const int is_alone = k + 1 == count;
#define LOAD(l, e) light(pair, inside_of(top + (e), rows), inside_of(left + (l), cols), cols, rows * cols, is_alone)
        COLUMNS
#undef LOAD
#define LOAD(l, e) line[ROW(l, e)]
        ROWS
#undef LOAD
        _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
            const int j = item + n * THREADS, x = j % SMALL_X, y = j / SMALL_X;
            if (j < SMALL_Y * SMALL_X) {
                _Pragma("unroll") for (int a = 0; a < PERIOD_Y; ++a)
                    _Pragma("unroll") for (int b = 0; b < PERIOD_X; ++b) {
                        const int fy = y + a * SMALL_Y, fx = x + b * SMALL_X;
                        const int oy = fy == 0 ? 0 : SIDE - fy, ox = fx == 0 ? 0 : SIDE - fx;
                        const float2 value = line[fy * PITCH + fx], back = conjugate(line[oy * PITCH + ox]);
                        const float2 one = value + back, two = turned(value - back, -1.0f);
                        const int at = (fy < oy ? fy : oy) * (SIDE / 2 + 1) + (fx < ox ? fx : ox) + k * quarter;
                        float2 totals[CHANNELS];
                        _Pragma("unroll") for (int c = 0; c < CHANNELS; ++c) {
                            totals[c] = one * (mix[c * count + k] * tables[c * between + at]);
                            if (!is_alone)
                                totals[c] += two * (mix[c * count + k + 1] * tables[c * between + quarter + at]);
                        }
                        _Pragma("unroll") for (int o = 0; o < OUTPUTS; ++o) {
                            const int dy = IS_MOSAIC ? o / PERIOD_X : 0, dx = IS_MOSAIC ? o % PERIOD_X : 0;
                            const float2 turn = times(turns_y[a * dy % PERIOD_Y], turns_x[b * dx % PERIOD_X]);
                            const float2 part = turn.y == 0.0f ? totals[of[o]] * turn.x : times(totals[of[o]], turn);
                            // what is common to all frequencies that are folded into one
                            const float2 own = times(part, times(roots[y * dy], roots[x * dx]));
                            sums[o / 2][n] += o % 2 ? turned(own, 1.0f) : own;
                        }
                    }
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    _Pragma("unroll") for (int first = 0; first < IMAGES; first += TOGETHER) {
        _Pragma("unroll") for (int o = 0; o < TOGETHER; ++o)
            _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
                const int j = item + n * THREADS, x = j % SMALL_X, y = j / SMALL_X;
                if (j < SMALL_Y * SMALL_X) line[(o * SMALL_Y + y) * SMALL_PITCH + x] = sums[first + o][n];
            }
        barrier(CLK_LOCAL_MEM_FENCE);
#define LOAD(l, e) line[BACK_ROW(l, e)]
        BACK_X
#undef LOAD
#define LOAD(l, e) line[BACK_COLUMN(l, e)]
        BACK_Y
#undef LOAD
        for (int j = item; j < VALID * VALID; j += THREADS) {
            const int v = j / VALID, u = j % VALID, y = tile_y + v, x = tile_x + u;
            if (y < out_rows && x < out_cols) {
                const int fy = v + OVERLAP, fx = u + OVERLAP;
                const int o = IS_MOSAIC ? fy % PERIOD_Y * PERIOD_X + fx % PERIOD_X : 0;
                const float2 value = line[(o / 2 * SMALL_Y + fy / PERIOD_Y) * SMALL_PITCH + fx / PERIOD_X];
                const float scale = 0.5f / (SIDE * SIDE);
                const size_t at = (size_t)y * out_cols + x, image = (size_t)out_rows * out_cols;
                if (IS_MOSAIC) {
                    out[at] = (o % 2 ? value.y : value.x) * scale;
                } else {
                    out[2 * first * image + at] = value.x * scale;
                    if (2 * first + 1 < OUTPUTS) out[(2 * first + 1) * image + at] = value.y * scale;
                }
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
