// The mosaic by transforms of whole lines in local memory: columns forward, rows forward - weighted, summed and folded
// - inverse, columns inverse. Spectra of whole planes are never in global memory.
// From the host, for each kernel's own program: THREADS of a group, FORWARD and INVERSE, lists of PASS(...),
// BORDER, PERIOD_Y, PERIOD_X, CHANNELS and CFA of the mosaic, the transforms' LENGTH_Y and LENGTH_X, COMPLEX (tables are
// halves of complex values), and others below.
#include "border.clh"
#include "fft.clh"

#define SMALL_Y (LENGTH_Y / PERIOD_Y)
#define SMALL_X (LENGTH_X / PERIOD_X)
#define PHASES (PERIOD_Y * PERIOD_X)

#ifdef COLUMNS_FORWARD  // so many lines, each of two neighbouring real columns
float2 of_two_columns(__global const float *restrict plane, const int x, const int y, const int cols, const int end)
{
    __global const float *at = plane + y * cols + x;
    return IS_DARK(y) || x >= end ? PAIR(0.0f, 0.0f) : PAIR(at[0], x + 1 < end ? at[1] : 0.0f);
}

__kernel void columns_forward(
    // in:
    __global const float *restrict planes,   // [][rows][cols]
    __global const float2 *restrict roots,   // [LENGTH_Y]
    // out:
    __global float2 *restrict halves,        // [][LENGTH_Y / 2 + 1][pitch]
    // params:
    const int first, const int before,
    // sizes:
    const int rows, const int cols, const int pitch, const int groups)
{
    LOCAL(float2, line, COLUMNS_FORWARD * ROOM(LENGTH_Y));
    const int item = get_local_id(0), k = get_group_id(0) / groups;
    const int left = get_group_id(0) % groups * (2 * COLUMNS_FORWARD);
    __global const float *plane = planes + (size_t)(first + k) * rows * cols + left;
    __global float2 *from = halves + (size_t)k * (LENGTH_Y / 2 + 1) * pitch;
#define SIDE_BY_SIDE 1
#define LOAD(l, e) of_two_columns(plane, 2 * (l), inside_of((e) - before, rows), cols, cols - left)
    FORWARD
#undef SIDE_BY_SIDE
#undef LOAD
    for (int j = item; j < COLUMNS_FORWARD * (LENGTH_Y / 2 + 1); j += THREADS) {
        const int l = j % COLUMNS_FORWARD, y = j / COLUMNS_FORWARD, x = left + 2 * l;
        const float2 p = line[l * ROOM(LENGTH_Y) + AT(LENGTH_Y, y)];
        const float2 q = conjugate(line[l * ROOM(LENGTH_Y) + AT(LENGTH_Y, y == 0 ? 0 : LENGTH_Y - y)]);
        // the pitch has room for both: it is even
        if (x < pitch) *(__global float4 *)(from + (size_t)y * pitch + x) = QUAD((p + q) * 0.5f, turned(p - q, -0.5f));
    }
}
#endif

#ifdef ROWS_FORWARD  // so many of the PERIOD_Y rows that are folded into one at a time, and ROWS_INVERSE phases
float2 of_row(__global const float2 *restrict halves, const int fy, const int x, const int pitch)
{
    // before the rows are transformed, a row that is not stored is the conjugate of its opposite
    const int is_mirrored = fy > LENGTH_Y / 2;
    const float2 value = IS_DARK(x) ? PAIR(0.0f, 0.0f) : halves[(is_mirrored ? LENGTH_Y - fy : fy) * pitch + x];
    return is_mirrored ? conjugate(value) : value;
}

__kernel void fold(
    // in:
    __global const float2 *restrict halves,   // [size][LENGTH_Y / 2 + 1][pitch]
    __global const float *restrict tables,    // [1 or CHANNELS][count][LENGTH_Y / 2 + 1][LENGTH_X / 2 + 1]
                                              // or [1 or CHANNELS][count][LENGTH_Y][LENGTH_X / 2 + 1][2]
    __constant float *mix,                    // [CHANNELS][size]
    __global const float2 *restrict roots_y,  // [LENGTH_Y]
    __global const float2 *restrict roots,    // [LENGTH_X]
    // out:
    __global float2 *restrict folded,         // [PHASES][SMALL_Y / 2 + 1][SMALL_X]
    // params:
    const int is_first, const int first, const int count, const int own_tables, const int before,
    // sizes:
    const int size, const int cols, const int pitch)
{
    LOCAL(float2, line, LOCAL_BYTES / 8);
    const float2 turns_y[PERIOD_Y] = {TURNS_Y}, turns_x[PERIOD_X] = {TURNS_X};  // roots of unity of the periods
    const int cfa[PHASES] = {CFA};
    const int item = get_local_id(0), y = get_group_id(0);
    const int table_size = (COMPLEX ? 2 * LENGTH_Y : LENGTH_Y / 2 + 1) * (LENGTH_X / 2 + 1);
    const size_t between = (size_t)own_tables * count * table_size;  // from one channel's tables to the next
    float2 sums[PHASES][OWN];  // of the work-item's own columns: item, item + THREADS, ...
    _Pragma("unroll") for (int p = 0; p < PHASES; ++p)
        _Pragma("unroll") for (int n = 0; n < OWN; ++n) sums[p][n] = PAIR(0.0f, 0.0f);
    for (int k = 0; k < size; ++k) {
        __global const float2 *half_plane = halves + (size_t)k * (LENGTH_Y / 2 + 1) * pitch;
        __global const float *table = tables + (size_t)(first + k) * table_size;
        _Pragma("unroll") for (int set = 0; set < PERIOD_Y; set += ROWS_FORWARD) {
#define SIDE_BY_SIDE 0
#define LOAD(l, e) of_row(half_plane, y + (set + (l)) * SMALL_Y, inside_of((e) - before, cols), pitch)
            FORWARD
#undef LOAD
            _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
                const int x = item + n * THREADS;
                if (x < SMALL_X) {
                    _Pragma("unroll") for (int l = 0; l < ROWS_FORWARD; ++l) {
                        const int a = set + l, fy = y + a * SMALL_Y;
                        _Pragma("unroll") for (int b = 0; b < PERIOD_X; ++b) {
                            const int fx = x + b * SMALL_X, is_opposite = fx > LENGTH_X - fx;
                            const int column = is_opposite ? LENGTH_X - fx : fx;
                            const float2 value = line[l * ROOM(LENGTH_X) + AT(LENGTH_X, fx)];
#if COMPLEX
                            // columns that are not stored are the conjugates of the opposite frequency
                            const int row = is_opposite && fy > 0 ? LENGTH_Y - fy : fy;
                            __global const float *entry = table + 2 * (row * (LENGTH_X / 2 + 1) + column);
                            float2 weighted[CHANNELS];
                            _Pragma("unroll") for (int c = 0; c < CHANNELS; ++c) {
                                const float2 transfer = *(__global const float2 *)(entry + c * between);
                                weighted[c] = times(value, is_opposite ? conjugate(transfer) : transfer)
                                              * mix[c * size + k];
                            }
#else
                            const int row = fy < LENGTH_Y - fy ? fy : LENGTH_Y - fy;
                            __global const float *entry = table + (row * (LENGTH_X / 2 + 1) + column);
                            float2 weighted[CHANNELS];
                            _Pragma("unroll") for (int c = 0; c < CHANNELS; ++c)
                                weighted[c] = value * (mix[c * size + k] * entry[c * between]);
#endif
                            _Pragma("unroll") for (int p = 0; p < PHASES; ++p) {
                                const float2 turn = times(turns_y[a * (p / PERIOD_X) % PERIOD_Y],
                                                          turns_x[b * (p % PERIOD_X) % PERIOD_X]);
                                const float2 term = weighted[cfa[p]];
                                sums[p][n] += turn.y == 0.0f ? term * turn.x : times(term, turn);
                            }
                        }
                    }
                }
            }
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }
    _Pragma("unroll") for (int set = 0; set < PHASES; set += ROWS_INVERSE) {
        _Pragma("unroll") for (int l = 0; l < ROWS_INVERSE; ++l) {
            const int p = set + l;
            _Pragma("unroll") for (int n = 0; n < OWN; ++n) {
                const int x = item + n * THREADS;
                if (x < SMALL_X)
                    line[l * ROOM(SMALL_X) + AT(SMALL_X, x)] = times(sums[p][n], times(roots_y[y * (p / PERIOD_X)],
                                                                              roots[x * (p % PERIOD_X)]));
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
#define LOAD(l, e) line[(l) * ROOM(SMALL_X) + AT(SMALL_X, e)]
        INVERSE
#undef SIDE_BY_SIDE
#undef LOAD
        _Pragma("unroll") for (int l = 0; l < ROWS_INVERSE; ++l) {
            __global float2 *to = folded + ((size_t)(set + l) * (SMALL_Y / 2 + 1) + y) * SMALL_X;
            for (int x = item; x < SMALL_X; x += THREADS) {
                const float2 value = line[l * ROOM(SMALL_X) + AT(SMALL_X, x)];
                to[x] = is_first ? value : to[x] + value;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
#endif

#ifdef COLUMNS_INVERSE  // so many columns of all phases, two real ones of them to a line
// Real columns c and c + 1 of the group as one line; column c belongs to phase c % PHASES at c / PHASES.
float2 of_two_phases(__global const float2 *restrict folded, const int left, const int c, const int y)
{
    const int is_mirrored = y > SMALL_Y / 2, row = is_mirrored ? SMALL_Y - y : y;
    const int a = left + c / PHASES, b = left + (c + 1) / PHASES;
    float2 p = PAIR(0.0f, 0.0f), q = PAIR(0.0f, 0.0f);
    if (a < SMALL_X) p = folded[(c % PHASES * (SMALL_Y / 2 + 1) + row) * SMALL_X + a];
    if (b < SMALL_X) q = folded[((c + 1) % PHASES * (SMALL_Y / 2 + 1) + row) * SMALL_X + b];
    return is_mirrored ? conjugate(p) + turned(conjugate(q), 1.0f) : p + turned(q, 1.0f);
}

__kernel void columns_inverse(
    // in:
    __global const float2 *restrict folded,  // [PHASES][SMALL_Y / 2 + 1][SMALL_X]
    __global const float2 *restrict roots,   // [LENGTH_Y]
    // out:
    __global float *restrict out,            // [rows][cols]
    // params:
    const float scale, const int start_y, const int start_x,
    // sizes:
    const int rows, const int cols)
{
    LOCAL(float2, line, COLUMNS_INVERSE * PHASES / 2 * ROOM(SMALL_Y));
    const int item = get_local_id(0), left = get_group_id(0) * COLUMNS_INVERSE;
#define SIDE_BY_SIDE 1
#define LOAD(l, e) of_two_phases(folded, left, 2 * (l), e)
    INVERSE
#undef SIDE_BY_SIDE
#undef LOAD
    for (int j = item; j < COLUMNS_INVERSE * PERIOD_X * LENGTH_Y; j += THREADS) {
        const int u = j % (COLUMNS_INVERSE * PERIOD_X), v = j / (COLUMNS_INVERSE * PERIOD_X);
        const int e = u / PERIOD_X * PHASES + v % PERIOD_Y * PERIOD_X + u % PERIOD_X;
        const int y = v - start_y, x = left * PERIOD_X + u - start_x;
        const float2 value = line[e / 2 * ROOM(SMALL_Y) + AT(SMALL_Y, v / PERIOD_Y)];
        if (y >= 0 && y < rows && x >= 0 && x < cols)
            out[(size_t)y * cols + x] = (e % 2 ? value.y : value.x) * scale;
    }
}
#endif
