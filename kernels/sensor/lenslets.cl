// Squares along the pixels: `across` and `down` are products with banded matrices along rows and columns. A work-item has
// WIDTH neighbouring positions and BLOCK lines, so that each weight or value is read once for several sums.
// Other arrays: `bundle` adds the samples of each lenslet, and `gather` adds up the cells near a pixel. From the host: WIDTH, CELLS of the pupil along the axis; STEPS of the table.
#define BLOCK 8

// Sums over the middle axis.
__kernel void add_up(
    // in:
    __global const float *restrict values,  // [outer][count][inner]
    // out:
    __global float *restrict sums,          // [outer][inner]
    // sizes:
    const int outer, const int count, const int inner)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= inner || y >= outer)
    float sum = 0.0f;
    for (int k = 0; k < count; ++k) sum += values[((size_t)y * count + k) * inner + x];
    sums[(size_t)y * inner + x] = sum;
}

#ifdef WIDTH
#include "lanes.clh"

__kernel void across(
    // in:
    __global const float *restrict rates,        // [cells_y][CELLS][channels][rows][cols]
    __global const float *restrict totals,       // [cells_y][channels][rows][cols]
    __global const float *restrict weights,      // [pairs][window][CELLS][positions]
    __global const float *restrict far_weights,  // [pairs][far_window][positions]
    __global const int *restrict first,          // [pairs][positions / BLOCK]
    __global const int *restrict far_first,      // [pairs][positions / BLOCK]
    __global const int *restrict pairs,          // [pairs][2] phase, channel
    // out:
    __global float *restrict lines,              // [pairs][cells_y * rows][positions]
    // sizes:
    const int pair_count, const int cells_y, const int channels, const int rows, const int cols, const int positions,
    const int window, const int far_window)
{
    const int k = get_global_id(0) * WIDTH, groups = (rows + BLOCK - 1) / BLOCK;
    const int top = get_global_id(1) % groups * BLOCK, j = get_global_id(1) / groups % cells_y;
    const int pair = get_global_id(1) / groups / cells_y;
    GUARD(k >= positions || pair >= pair_count)
    const size_t area = (size_t)rows * cols;
    const int channel = pairs[2 * pair + 1], block = (pair * positions + k) / BLOCK;
    __global const float *restrict from = rates + ((size_t)j * CELLS * channels + channel) * area + first[block];
    __global const float *restrict from_far = totals + ((size_t)j * channels + channel) * area + far_first[block];
    __global const float *restrict weight = weights + (size_t)pair * window * CELLS * positions + k;
    int at[BLOCK];
    real sum[BLOCK];
#pragma unroll
    for (int d = 0; d < BLOCK; ++d) {
        at[d] = min(top + d, rows - 1) * cols;
        sum[d] = 0.0f;
    }
    for (int m = 0; m < window; ++m)
        for (int i = 0; i < CELLS; ++i) {
            const real w = load(weight + (size_t)(m * CELLS + i) * positions, WIDTH);
            __global const float *restrict plane = from + i * channels * area + m;
#pragma unroll
            for (int d = 0; d < BLOCK; ++d) sum[d] += w * plane[at[d]];
        }
    for (int m = 0; m < far_window; ++m) {
        const real w = load(far_weights + ((size_t)pair * far_window + m) * positions + k, WIDTH);
#pragma unroll
        for (int d = 0; d < BLOCK; ++d) sum[d] += w * from_far[at[d] + m];
    }
    __global float *restrict to = lines + (((size_t)pair * cells_y + j) * rows + top) * positions + k;
#pragma unroll
    for (int d = 0; d < BLOCK; ++d)
        if (top + d < rows) {
            STORE(float, sum[d], to + (size_t)d * positions, WIDTH)
        }
}

__kernel void down(
    // in:
    __global const float *restrict lines,        // [pairs of columns][CELLS][rows][positions_x]
    __global const float *restrict totals,       // [pairs of columns][rows][positions_x]
    __global const float *restrict weights,      // [pairs of rows][window][CELLS][positions_y]
    __global const float *restrict far_weights,  // [pairs of rows][far_window][positions_y]
    __global const int *restrict first,          // [pairs of rows][positions_y / BLOCK]
    __global const int *restrict far_first,      // [pairs of rows][positions_y / BLOCK]
    __global const int *restrict column_pairs,   // [period_y][period_x]
    __global const int *restrict row_pairs,      // [period_y][period_x]
    // out:
    __global float *restrict pixels,             // [pixel_rows][pixel_cols]
    // sizes:
    const int rows, const int positions_x, const int positions_y, const int window, const int far_window,
    const int pixel_rows, const int pixel_cols, const int period_y, const int period_x)
{
    const int wide = positions_x / WIDTH, blocks = positions_y / BLOCK;
    const int k = get_global_id(0) % wide * WIDTH, phase_x = get_global_id(0) / wide;
    const int block = get_global_id(1) % blocks, phase_y = get_global_id(1) / blocks;
    GUARD(phase_x >= period_x || phase_y >= period_y)
    const int place = phase_y * period_x + phase_x, pair = row_pairs[place], plane = column_pairs[place];
    __global const float *restrict from = lines
        + ((size_t)plane * CELLS * rows + first[pair * blocks + block]) * positions_x + k;
    __global const float *restrict from_far = totals
        + ((size_t)plane * rows + far_first[pair * blocks + block]) * positions_x + k;
    __global const float *restrict weight = weights + (size_t)pair * window * CELLS * positions_y + block * BLOCK;
    __global const float *restrict far_weight = far_weights + (size_t)pair * far_window * positions_y + block * BLOCK;
    real sum[BLOCK];
#pragma unroll
    for (int d = 0; d < BLOCK; ++d) sum[d] = 0.0f;
    for (int m = 0; m < window; ++m)
        for (int j = 0; j < CELLS; ++j) {
            const real value = load(from + ((size_t)j * rows + m) * positions_x, WIDTH);
            __global const float *restrict w = weight + (size_t)(m * CELLS + j) * positions_y;
#pragma unroll
            for (int d = 0; d < BLOCK; ++d) sum[d] += w[d] * value;
        }
    for (int m = 0; m < far_window; ++m) {
        const real value = load(from_far + (size_t)m * positions_x, WIDTH);
#pragma unroll
        for (int d = 0; d < BLOCK; ++d) sum[d] += far_weight[m * positions_y + d] * value;
    }
    for (int d = 0; d < BLOCK; ++d) {
        const int y = phase_y + period_y * (block * BLOCK + d);
        for (int lane = 0; lane < WIDTH; ++lane) {
            const int x = phase_x + period_x * (k + lane);
            if (y < pixel_rows && x < pixel_cols) pixels[(size_t)y * pixel_cols + x] = ((float *)&sum[d])[lane];
        }
    }
}

#else

// The light of each lenslet: its samples by their shares.
__kernel void bundle(
    // in:
    __global const float *restrict rates,  // [planes][samples]
    __global const int *restrict sample,   // [lenslets][parts]
    __global const float *restrict share,  // [lenslets][parts]
    // out:
    __global float *restrict light,        // [planes][lenslets]
    // sizes:
    const int planes, const int samples, const int lenslets, const int parts)
{
    const int lenslet = get_global_id(0), plane = get_global_id(1);
    GUARD(lenslet >= lenslets || plane >= planes)
    float sum = 0.0f;
    for (int j = 0; j < parts; ++j) {
        const int at = lenslet * parts + j;
        sum += share[at] * rates[(size_t)plane * samples + sample[at]];
    }
    light[(size_t)plane * lenslets + lenslet] = sum;
}

// Light of cells near each pixel, by a table: of near pixels; or of the pixels' grid, a layer for each channel.
__kernel void gather(
    // in:
    __global const float *restrict light,      // [cells_y][cells_x][channels][samples]
    __global const int *restrict sample,       // [lenslets][parts]
    __global const float *restrict share,      // [lenslets][parts]
    __global const float *restrict places,     // [lenslets][parts][2] where the pupil's middle lands
    __global const float *restrict near_table, // [channels][side][side]
    __global const float *restrict far_light,  // [channels][pixel_rows][pixel_cols]
    __global const int *restrict cfa,          // [period_y][period_x]
    __global const float *restrict inverse,    // [2][2] from places to steps of the lattice
    // out:
    __global float *restrict pixels,           // [layers][pixel_rows][pixel_cols]
    // params:
    const int has_far, const float origin_y, const float origin_x, const float axis_y, const float axis_x, const float tilt,
    const float radius, const float reach,
    // sizes:
    const int cells_y, const int cells_x, const int channels, const int samples, const int parts,
    const int low_a, const int low_b, const int count_a, const int count_b, const int around_a, const int around_b,
    const int side, const int period_y, const int period_x, const int layers, const int pixel_rows,
    const int pixel_cols)
{
    const int px = get_global_id(0), py = get_global_id(1), layer = get_global_id(2);
    GUARD(px >= pixel_cols || py >= pixel_rows || layer >= layers)
    const int channel = layers == 1 ? cfa[py % period_y * period_x + px % period_x] : layer;
    const float y = py - 0.5f * (pixel_rows - 1), x = px - 0.5f * (pixel_cols - 1);
    // the lenslet whose image of the pupil's middle is nearest
    const float v = (y + tilt * axis_y) / (1.0f + tilt) - origin_y, u = (x + tilt * axis_x) / (1.0f + tilt) - origin_x;
    const int own_a = (int)rint(v * inverse[0] + u * inverse[2]) - low_a;
    const int own_b = (int)rint(v * inverse[1] + u * inverse[3]) - low_b;
    const float step_y = 2.0f * radius / cells_y, step_x = 2.0f * radius / cells_x;
    __global const float *restrict table = near_table + channel * side * side;
    float sum = has_far ? far_light[((size_t)channel * pixel_rows + py) * pixel_cols + px] : 0.0f;
    for (int a = max(own_a - around_a, 0); a <= min(own_a + around_a, count_a - 1); ++a)
        for (int b = max(own_b - around_b, 0); b <= min(own_b + around_b, count_b - 1); ++b)
            for (int part = 0; part < parts; ++part) {
                const int at = (a * count_b + b) * parts + part;
                // distances of the pixel from the images of the first cells; they grow by a step with each cell
                const float first_y = y - places[2 * at] - radius + 0.5f * step_y;
                const float first_x = x - places[2 * at + 1] - radius + 0.5f * step_x;
                const int j0 = max(0, (int)ceil((-reach - first_y) / step_y));
                const int j1 = min(cells_y - 1, (int)floor((reach - first_y) / step_y));
                const int i0 = max(0, (int)ceil((-reach - first_x) / step_x));
                const int i1 = min(cells_x - 1, (int)floor((reach - first_x) / step_x));
                if (j0 > j1 || i0 > i1 || share[at] == 0.0f) continue;
                float own = 0.0f;
                for (int j = j0; j <= j1; ++j) {
                    const float ty = clamp((first_y + j * step_y + reach) * STEPS, 0.0f, side - 1.001f);
                    const int row = (int)ty;
                    const float fy = ty - row;
                    for (int i = i0; i <= i1; ++i) {
                        const float tx = clamp((first_x + i * step_x + reach) * STEPS, 0.0f, side - 1.001f);
                        const int col = (int)tx;
                        const float fx = tx - col;
                        __global const float *restrict from = table + row * side + col;
                        const float upper = from[0] + fx * (from[1] - from[0]);
                        const float lower = from[side] + fx * (from[side + 1] - from[side]);
                        own += (upper + fy * (lower - upper))
                            * light[((size_t)(j * cells_x + i) * channels + channel) * samples + sample[at]];
                    }
                }
                sum += share[at] * own;
            }
    pixels[((size_t)layer * pixel_rows + py) * pixel_cols + px] = sum;
}
#endif
