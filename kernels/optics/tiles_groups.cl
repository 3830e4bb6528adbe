// Tiles on GPUs: a work-group has one, in local memory. Two real planes are the real and the imaginary part of one
// complex tile, and so are two outputs. Transforms are in place: forward they leave frequency f of an axis at PLACE_SIDE(f),
// back they begin with frequencies at PLACE_Y(f) and PLACE_X(f) and leave pixels in their order. A work-item writes to
// the places that it has read, and a pass needs one barrier and the registers of one of its butterflies.
// From the host: THREADS of a group, SIDE of a tile, OVERLAP, PERIOD_Y and PERIOD_X of the mosaic, 1 of channels;
// OUTPUTS: the mosaic's phases, or the channels; OF, the channel of each; CHANNELS; OWN_TABLES, whether each has its own;
// BORDER; PASSes: FIRST of the columns, COLUMNS the others, ROWS, BACK_X, BACK_Y and LAST; PLACE_SIDE, PLACE_Y, PLACE_X;
// TURNS_Y and TURNS_X, roots of unity of the periods.
#include "border.clh"
#include "fft.clh"

#define SMALL_Y (SIDE / PERIOD_Y)
#define SMALL_X (SIDE / PERIOD_X)
#define VALID (SIDE - 2 * OVERLAP)
#define PITCH (SIDE + 1)  // odd: adjacent lines then meet all banks
#define SMALL_PITCH (SMALL_X + 1)
#define IS_MOSAIC (PERIOD_Y * PERIOD_X > 1)
#define IMAGES ((OUTPUTS + 1) / 2)         // complex ones, two outputs in each
#define TOGETHER (IS_MOSAIC ? IMAGES : 1)  // of them that are in local memory at once
#define HALF ((SMALL_Y / 2 + 1) * SMALL_X) // frequencies of an output: the others are their conjugates
#define ROOT(n) line[LOCAL_BYTES / 8 - SIDE + (n)]  // exp(2 pi i n / SIDE)
#define OWN ((HALF + THREADS - 1) / THREADS)

// Places of element e of line l: along columns and rows of the tile, of the images that are together.
#define COLUMN(l, e) ((e) * PITCH + (l))
#define ROW(l, e) ((l) * PITCH + (e))
#define BACK_COLUMN(l, e) (((l) / SMALL_X * SMALL_Y + (e)) * SMALL_PITCH + (l) % SMALL_X)
#define BACK_ROW(l, e) ((l) * SMALL_PITCH + (e))

// One pass of radix RADIX over LINES lines, in place, of blocks of BLOCK elements: decimation in frequency forward (SIGN
// -1), in time back (Oppenheim and Schafer, Discrete-Time Signal Processing, 9.2 to 9.4). Neighbouring work-items have
// neighbouring lines.
#define PASS_IN_PLACE(RADIX, BLOCK, LENGTH, LINES, SIGN, LOAD, STORE)                                              \
    _Pragma("unroll") for (int n = 0; n * THREADS < LINES * (LENGTH / RADIX); ++n) {                               \
        const int j = item + n * THREADS, l = j % (LINES), i = j / (LINES), k = i % (BLOCK / RADIX);               \
        const int first = (i - k) * RADIX + k;                                                                     \
        if (LINES * (LENGTH / RADIX) % THREADS == 0 || j < LINES * (LENGTH / RADIX)) {                             \
            float2 v[RADIX];                                                                                       \
            _Pragma("unroll") for (int m = 0; m < RADIX; ++m) {                                                    \
                v[m] = LOAD(l, first + m * (BLOCK / RADIX));                                                       \
                if (SIGN > 0 && BLOCK > RADIX && m > 0) v[m] = times(v[m], ROOT(m * k * (SIDE / BLOCK)));         \
            }                                                                                                      \
            transform_##RADIX(v, SIGN);                                                                            \
            _Pragma("unroll") for (int m = 0; m < RADIX; ++m) {                                                    \
                if (SIGN < 0 && BLOCK > RADIX && m > 0)                                                            \
                    v[m] = times(v[m], conjugate(ROOT(m * k * (SIDE / BLOCK))));                                  \
                STORE(l, first + m * (BLOCK / RADIX), v[m])                                                        \
            }                                                                                                      \
        }                                                                                                          \
    }                                                                                                              \
    barrier(CLK_LOCAL_MEM_FENCE);

// Where passes read and write: two planes' samples, and pixels of two outputs.
#define IN_COLUMNS(l, e) line[COLUMN(l, e)]
#define TO_COLUMNS(l, e, value) line[COLUMN(l, e)] = value;
#define IN_ROWS(l, e) line[ROW(l, e)]
#define TO_ROWS(l, e, value) line[ROW(l, e)] = value;
#define IN_BACK_ROWS(l, e) line[BACK_ROW(l, e)]
#define TO_BACK_ROWS(l, e, value) line[BACK_ROW(l, e)] = value;
#define IN_BACK_COLUMNS(l, e) line[BACK_COLUMN(l, e)]
#define TO_BACK_COLUMNS(l, e, value) line[BACK_COLUMN(l, e)] = value;
#define FROM_PLANES(l, e) light(pair, inside_of(top + (e), rows), inside_of(left + (l), cols), cols, rows * cols, is_alone)
#define TO_PIXELS(l, e, value)                                                                                     \
    {                                                                                                              \
        const int o = 2 * (first_image + (l) / SMALL_X), x = (l) % SMALL_X;                                        \
        put(out, o, e, x, (value).x, tile_y, tile_x, out_rows, out_cols);                                          \
        if (o + 1 < OUTPUTS) put(out, o + 1, e, x, (value).y, tile_y, tile_x, out_rows, out_cols);                 \
    }

// Two planes' samples at row v, column u; -1 is dark.
float2 light(__global const float *restrict planes, const int v, const int u, const int cols, const int plane,
             const int is_alone)
{
    const int at = v * cols + u;
    return v < 0 || u < 0 ? PAIR(0.0f, 0.0f) : PAIR(planes[at], is_alone ? 0.0f : planes[at + plane]);
}

// Stores output o at its own row y and column x, if the tile is valid there and the result has this pixel.
void put(__global float *restrict out, const int o, const int y, const int x, const float value, const int tile_y,
         const int tile_x, const int out_rows, const int out_cols)
{
    const int v = y * PERIOD_Y + (IS_MOSAIC ? o / PERIOD_X : 0) - OVERLAP;
    const int u = x * PERIOD_X + (IS_MOSAIC ? o % PERIOD_X : 0) - OVERLAP;
    const int is_valid = v >= 0 && v < VALID && u >= 0 && u < VALID && tile_y + v < out_rows && tile_x + u < out_cols;
    const size_t row = (size_t)(IS_MOSAIC ? 0 : o) * out_rows + tile_y + v;
    if (is_valid) out[row * out_cols + tile_x + u] = value * (0.5f / (SIDE * SIDE));
}

__kernel void tiles(
    // in:
    __global const float *restrict planes,  // [count][rows][cols]
    __global const float *restrict tables,  // [1 or CHANNELS][count][SIDE / 2 + 1][SIDE / 2 + 1]
    __constant float *mix,                  // [CHANNELS][count]
    __global const float2 *restrict circle,  // [SIDE], roots of unity
    // out:
    __global float *restrict out,           // [1 or OUTPUTS][out_rows][out_cols]
    // params:
    const int margin, const int zero,
    // sizes:
    const int count, const int rows, const int cols, const int out_rows, const int out_cols, const int across)
{
    LOCAL(float2, line, LOCAL_BYTES / 8);
    const float2 turns_y[PERIOD_Y] = {TURNS_Y}, turns_x[PERIOD_X] = {TURNS_X};
    const int of[OUTPUTS] = {OF};
    const int quarter = (SIDE / 2 + 1) * (SIDE / 2 + 1);
    const int tile_y = get_group_id(0) / across * VALID, tile_x = get_group_id(0) % across * VALID;
    const int top = tile_y + margin - OVERLAP, left = tile_x + margin - OVERLAP;
    float2 sums[OWN][OUTPUTS];  // of the frequencies that are folded into one, but for a factor that they share
    _Pragma("unroll") for (int n = 0; n < OWN; ++n)
        _Pragma("unroll") for (int o = 0; o < OUTPUTS; ++o) sums[n][o] = PAIR(0.0f, 0.0f);
    if (get_local_id(0) < SIDE) ROOT(get_local_id(0)) = circle[get_local_id(0)];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < count; k += 2) {
        __global const float *pair = planes + (size_t)k * rows * cols;
        const int is_alone = k + 1 == count;
        const int item = get_local_id(0) + k * zero;  // or all that follows of it is kept from pair to pair, and spills
        FIRST
        COLUMNS
        ROWS
        _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
            // neighbours have adjacent places; elements of the first radix, 8, are far apart
            const int j = item + n * THREADS, s = j % SMALL_X, y = j / SMALL_X;
            const int x = s % (SMALL_X / 8) * 8 + s / (SMALL_X / 8);
            if (HALF % THREADS == 0 || j < HALF) {
                _Pragma("unroll") for (int a = 0; a < PERIOD_Y; ++a)
                    _Pragma("unroll") for (int b = 0; b < PERIOD_X; ++b) {
                        const int fy = y + a * SMALL_Y, fx = x + b * SMALL_X;
                        const int oy = fy == 0 ? 0 : SIDE - fy, ox = fx == 0 ? 0 : SIDE - fx;
                        const float2 value = line[ROW(PLACE_SIDE(fy), PLACE_SIDE(fx))];
                        const float2 back = conjugate(line[ROW(PLACE_SIDE(oy), PLACE_SIDE(ox))]);
                        const float2 one = value + back, two = turned(value - back, -1.0f);
                        const int at = (fy < oy ? fy : oy) * (SIDE / 2 + 1) + (fx < ox ? fx : ox) + k * quarter;
                        float2 totals[CHANNELS];
                        _Pragma("unroll") for (int c = 0; c < CHANNELS; ++c) {
                            __global const float *table = tables + (OWN_TABLES ? c : 0) * count * quarter + at;
                            totals[c] = one * (mix[c * count + k] * table[0]);
                            if (!is_alone) totals[c] += two * (mix[c * count + k + 1] * table[quarter]);
                        }
                        _Pragma("unroll") for (int o = 0; o < OUTPUTS; ++o) {
                            const int dy = IS_MOSAIC ? o / PERIOD_X : 0, dx = IS_MOSAIC ? o % PERIOD_X : 0;
                            const float2 turn = times(turns_y[a * dy % PERIOD_Y], turns_x[b * dx % PERIOD_X]);
                            sums[n][o] += turn.y == 0.0f ? totals[of[o]] * turn.x : times(totals[of[o]], turn);
                        }
                    }
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const int item = get_local_id(0);
    _Pragma("unroll") for (int first_image = 0; first_image < IMAGES; first_image += TOGETHER) {
        _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
            const int j = item + n * THREADS, s = j % SMALL_X, y = j / SMALL_X;
            const int x = s % (SMALL_X / 8) * 8 + s / (SMALL_X / 8);
            const int oy = SMALL_Y - y, ox = x == 0 ? 0 : SMALL_X - x;
            if (HALF % THREADS == 0 || j < HALF)
                _Pragma("unroll") for (int i = 0; i < TOGETHER; ++i) {
                    const int o = 2 * (first_image + i), has_two = o + 1 < OUTPUTS;
                    const int dy = IS_MOSAIC ? o / PERIOD_X : 0, dx = IS_MOSAIC ? o % PERIOD_X : 0;
                    const int ey = IS_MOSAIC ? (o + 1) / PERIOD_X : 0, ex = IS_MOSAIC ? (o + 1) % PERIOD_X : 0;
                    const float2 one = times(sums[n][o], times(ROOT(y * dy), ROOT(x * dx)));
                    const float2 two = has_two ? times(sums[n][has_two ? o + 1 : o], times(ROOT(y * ey), ROOT(x * ex)))
                                               : PAIR(0.0f, 0.0f);
                    line[BACK_ROW(i * SMALL_Y + PLACE_Y(y), PLACE_X(x))] = one + turned(two, 1.0f);
                    if (y > 0 && y < oy)
                        line[BACK_ROW(i * SMALL_Y + PLACE_Y(oy), PLACE_X(ox))] =
                            conjugate(one) + turned(conjugate(two), 1.0f);
                }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        BACK_X
        BACK_Y
        LAST
    }
}
