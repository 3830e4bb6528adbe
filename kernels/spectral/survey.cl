// CPUs: a work-item takes a pair of rows and BLOCK projections, WIDTH columns at a time; the last block is the squares
// of the entries themselves. GPUs: survey_groups.cl. From the host: WIDTH, BLOCK.
#include "lanes.clh"

// The lanes that are of the row; 0 beyond, whatever is there.
INLINE real kept(real values, const int lanes)
{
    for (int lane = lanes; lane < WIDTH; ++lane) ((float *)&values)[lane] = 0.0f;
    return values;
}

INLINE float total(real values)
{
    float sum = 0.0f;
    for (int lane = 0; lane < WIDTH; ++lane) sum += ((float *)&values)[lane];
    return sum;
}

// WIDTH projections of samples and differences at `lanes` columns; `apart` of the columns have a right neighbour.
INLINE void add_projections(
    __global const float *restrict upper, __global const float *restrict lower, __global const float *restrict table,
    const size_t frame, const int entries, const int lanes, const int apart, const int *rows_of, real sums[3][BLOCK])
{
    real value[BLOCK], across[BLOCK], down[BLOCK];
#pragma unroll
    for (int b = 0; b < BLOCK; ++b) value[b] = across[b] = down[b] = 0.0f;
    for (int e = 0; e < entries; ++e) {
        const real here = load(upper + e * frame, lanes);
        const real right = load(upper + e * frame + 1, apart) - here, below = load(lower + e * frame, lanes) - here;
#pragma unroll
        for (int b = 0; b < BLOCK; ++b) {
            const float weight = table[rows_of[b] + e];
            value[b] += weight * here;
            across[b] += weight * right;
            down[b] += weight * below;
        }
    }
#pragma unroll
    for (int b = 0; b < BLOCK; ++b) {
        sums[0][b] += kept(value[b] * value[b], lanes);
        sums[1][b] += kept(across[b] * across[b], apart);
        sums[2][b] += kept(down[b] * down[b], lanes);
    }
}

INLINE void add_squares(
    __global const float *restrict upper, __global const float *restrict lower, const size_t frame, const int entries,
    const int lanes, const int apart, const float unit, real sums[3][BLOCK])
{
    real value = 0.0f, across = 0.0f, down = 0.0f;
    for (int e = 0; e < entries; ++e) {
        const real here = load(upper + e * frame, lanes);
        const real right = load(upper + e * frame + 1, apart) - here, below = load(lower + e * frame, lanes) - here;
        value += unit * here * (unit * here);
        across += unit * right * (unit * right);
        down += unit * below * (unit * below);
    }
    sums[0][0] += value;  // 0 beyond `lanes`
    sums[1][0] += kept(across, apart);
    sums[2][0] += down;
}

#define MEANS(first_of_block, used) do { \
    for (int kind = 0; kind < 3; ++kind) \
        for (int b = 0; b < (used); ++b) \
            out[((size_t)i * 3 + kind) * (count + 1) + (first_of_block) + b] \
                = total(sums[kind][b]) / (kind == 1 ? max(cols - 1, 1) : cols); \
    } while (0)

__kernel void mixed(
    // in:
    __global const float *restrict content,  // [entries][rows][cols]
    __global const float *restrict table,    // [count][entries]
    __global const int *restrict first,
    // out:
    __global float *restrict out,            // [pairs][3][count + 1]
    // sizes:
    const int entries, const int rows, const int cols, const int count, const float unit)
{
    const int i = get_global_id(1), begin = get_global_id(0) * BLOCK, y = clamp(first[i], 0, rows - 1);
    const size_t frame = (size_t)rows * cols;
    __global const float *upper = content + (size_t)y * cols, *lower = content + (size_t)min(y + 1, rows - 1) * cols;
    real sums[3][BLOCK];
    int rows_of[BLOCK];  // beyond the last projection it is made again, and not stored
    for (int b = 0; b < BLOCK; ++b) {
        sums[0][b] = sums[1][b] = sums[2][b] = 0.0f;
        rows_of[b] = min(begin + b, count - 1) * entries;
    }
    int x = 0;
    if (begin < count) {
        for (; x + WIDTH < cols; x += WIDTH)
            add_projections(upper + x, lower + x, table, frame, entries, WIDTH, WIDTH, rows_of, sums);
        add_projections(upper + x, lower + x, table, frame, entries, cols - x, cols - x - 1, rows_of, sums);
        MEANS(begin, min(BLOCK, count - begin));
    } else {
        for (; x + WIDTH < cols; x += WIDTH) {
            add_squares(upper + x, lower + x, frame, entries, WIDTH, WIDTH, unit, sums);
        }
        add_squares(upper + x, lower + x, frame, entries, cols - x, cols - x - 1, unit, sums);
        MEANS(count, 1);
    }
}

// Part of a difference between two samples in the squares of entries: one entry's square, or two.
INLINE float step_square(const int id, const int other, const float shade, const float its)
{
    return id == other ? (its - shade) * (its - shade) : shade * shade + its * its;
}

// The projection of a difference, which samples of one entry have without cancellation.
INLINE float step_projection(__global const float *row, const int id, const int other, const float shade,
                             const float its)
{
    return id == other ? row[id] * (its - shade) : row[other] * its - row[id] * shade;
}

__kernel void labelled(
    // in:
    __global const ushort *restrict ids,     // [rows][cols]
    __global const float *restrict content,  // [rows][cols], shading
    __global const float *restrict table,    // [count][entries]
    __global const int *restrict first,
    // out:
    __global float *restrict out,            // [pairs][3][count + 1]
    // sizes:
    const int entries, const int rows, const int cols, const int count, const float unit)
{
    const int i = get_global_id(1), begin = get_global_id(0) * BLOCK, y = clamp(first[i], 0, rows - 1);
    const size_t upper = (size_t)y * cols, lower = (size_t)min(y + 1, rows - 1) * cols;
    real sums[3][BLOCK];
    for (int b = 0; b < BLOCK; ++b) sums[0][b] = sums[1][b] = sums[2][b] = 0.0f;
    for (int x = 0; x < cols; x += WIDTH)
        for (int lane = 0; lane < min(WIDTH, cols - x); ++lane) {
            const size_t at = upper + x + lane, right = at + (x + lane + 1 < cols), below = lower + x + lane;
            const int id = ids[at], id_right = ids[right], id_below = ids[below];
            const float shade = content[at], shade_right = content[right], shade_below = content[below];
            for (int b = 0; b < min(BLOCK, count - begin); ++b) {
                __global const float *row = table + (begin + b) * entries;
                const float value = row[id] * shade;
                const float across = step_projection(row, id, id_right, shade, shade_right);
                const float down = step_projection(row, id, id_below, shade, shade_below);
                ((float *)&sums[0][b])[lane] += value * value;
                if (right != at) ((float *)&sums[1][b])[lane] += across * across;
                ((float *)&sums[2][b])[lane] += down * down;
            }
            if (begin >= count) {
                const float own = unit * shade;
                ((float *)&sums[0][0])[lane] += own * own;
                if (right != at) ((float *)&sums[1][0])[lane] += step_square(id, id_right, own, unit * shade_right);
                ((float *)&sums[2][0])[lane] += step_square(id, id_below, own, unit * shade_below);
            }
        }
    if (begin < count)
        MEANS(begin, min(BLOCK, count - begin));
    else
        MEANS(count, 1);
}
