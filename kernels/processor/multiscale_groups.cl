// As multiscale.cl, for GPUs. All levels lie one after the other in one array, each as a plane per axis, without margins.
// A work-group of `split` and of `join` has a tile of TILE x TILE pixels, and the same part of the picture in coarser
// levels. A work-group of `shrink` goes down BAND rows of a level. Each of its COLUMNS work-items has the blocks that begin
// in one column; neighbours exchange what their blocks remove, four rows at a time. From the host: CHANNELS, LEVELS, SHADED,
// TILE (32 or 8), COLUMNS, BAND. OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#include "multiscale.clh"

#ifndef PAIR  // CUDA has this name
#define SHARED __local  // memory that a pointer points to
#define UNIT_CLAMP(x) clamp(x, 0.0f, 1.0f)
#else
#define SHARED
#define UNIT_CLAMP(x) __saturatef(x)
#endif

#define LINES 8
#define ITEMS (LINES * TILE)  // of a tile's group
#define EACH (TILE / LINES)   // rows of a work-item, LINES apart
#define HALVINGS (TILE == 32 ? 5 : 3)
#define SIZE(size, level) (((size) + (1 << (level)) - 1) >> (level))
#define LEAD 4                // columns of a group of `shrink` before its own pixels, and as many after them
#define STEP 4                // rows between barriers

// Begin of a level's planes.
inline size_t begin_of(const int level, const int rows, const int cols)
{
    size_t pixels = 0;
    for (int l = 0; l < level; ++l) pixels += (size_t)SIZE(rows, l) * SIZE(cols, l);
    return CHANNELS * pixels;
}

__kernel void split(
    // in:
    __global const float *restrict planes,  // [CHANNELS][rows][cols]
    __global const float *restrict gains,   // [ny][nx]
    __global const float *restrict axes,    // [CHANNELS][CHANNELS]
    // out:
    __global float *restrict values,        // levels up to HALVINGS
    // params:
    const float offset,
    // sizes:
    const int rows, const int cols, const int ny, const int nx)
{
    __local float pyramid[TILE * TILE * 4 / 3 + 1];
    const int item = get_local_id(0), across = SIZE(cols, HALVINGS);
    const int top = get_group_id(0) / across * TILE, left = get_group_id(0) % across * TILE;
    const int line = top + item / TILE, x = left + item % TILE;
    const size_t plane = (size_t)rows * cols;
    float root[EACH][CHANNELS];
#pragma unroll
    for (int n = 0; n < EACH; ++n) {
        const int v = min(line + n * LINES, rows - 1), u = min(x, cols - 1);
        const float gain = gain_at(gains, v, u, rows, cols, ny, nx);
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) root[n][c] = signed_root(planes[c * plane + v * cols + u] / gain + offset);
    }
    for (int a = 0; a < CHANNELS; ++a) {
#pragma unroll
        for (int n = 0; n < EACH; ++n) {
            const int y = line + n * LINES;
            float sum = 0.0f;
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) sum += axes[a * CHANNELS + c] * root[n][c];
            pyramid[item + n * ITEMS] = sum;
            if (y < rows && x < cols) values[a * plane + y * cols + x] = sum;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        __global float *means = values + CHANNELS * plane;
        int finer = 0, high = rows, wide = cols;
#pragma unroll 1  // it takes fewer registers
        for (int l = 1; l < LEVELS && l <= HALVINGS; ++l) {
            const int shift = HALVINGS - l, side = 1 << shift, finer_high = high, finer_wide = wide;
            high = SIZE(rows, l);
            wide = SIZE(cols, l);
            const int v = item >> shift, u = item & (side - 1), y = (top >> l) + v, w = (left >> l) + u;
            if (v < side && y < high && w < wide) {
                const int right = min(2 * w + 1, finer_wide - 1) - 2 * w;
                const int down = (min(2 * y + 1, finer_high - 1) - 2 * y) * 2 * side, at = finer + 4 * v * side + 2 * u;
                const float mean =
                    0.25f * ((pyramid[at] + pyramid[at + right]) + (pyramid[at + down] + pyramid[at + down + right]));
                pyramid[finer + 4 * side * side + item] = mean;
                means[a * (size_t)high * wide + y * wide + w] = mean;
            }
            means += (size_t)CHANNELS * high * wide;
            finer += 4 * side * side;
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }
}

// A level beyond those of `split`.
__kernel void halve(
    // inout:
    __global float *restrict values,
    // sizes:
    const int rows, const int cols, const int level)
{
    const int high = SIZE(rows, level), wide = SIZE(cols, level), i = get_group_id(0) * ITEMS + get_local_id(0);
    const int finer_high = SIZE(rows, level - 1), finer_wide = SIZE(cols, level - 1);
    const int x = i % wide, y = i / wide % high, axis = i / wide / high;
    if (axis >= CHANNELS) return;
    const int right = min(2 * x + 1, finer_wide - 1) - 2 * x, down = (min(2 * y + 1, finer_high - 1) - 2 * y) * finer_wide;
    __global const float *at =
        values + begin_of(level - 1, rows, cols) + ((size_t)axis * finer_high + 2 * y) * finer_wide + 2 * x;
    values[begin_of(level, rows, cols) + i] = 0.25f * ((at[0] + at[right]) + (at[down] + at[down + right]));
}

// Walsh coefficients of four neighbours.
inline void walsh(SHARED const float *of, float *to)
{
    const float left = of[0] + of[1], right = of[2] + of[3], fall = of[0] - of[1], rise = of[2] - of[3];
    to[0] = left + right;
    to[1] = left - right;
    to[2] = fall - rise;
    to[3] = fall + rise;
}

// The part of a coefficient that is taken for noise: all up to the threshold t, nothing from sqrt(3) t on.
inline float noise_part(const float coefficient, const float scale)
{
    return coefficient * UNIT_CLAMP(CEILING - coefficient * coefficient * scale);
}

__kernel void shrink(
    // in:
    __global const float *restrict values,
    __global const float *restrict scales,  // [LEVELS][CHANNELS][4 down][4 along], 1 / (2 t^2)
    // out:
    __global float *restrict noise,         // that the blocks of each level remove, like `values`
    // sizes:
    const int rows, const int cols)
{
    __local float strip[2][STEP][COLUMNS + 3];  // values
    __local float others[2][STEP][3][COLUMNS];  // what blocks of a column remove from the next three
    const int item = get_local_id(0);
    int group = get_group_id(0), level = 0, high, wide, across, down;
    for (;; ++level) {
        high = SIZE(rows, level);
        wide = SIZE(cols, level);
        across = (wide + COLUMNS - 2 * LEAD - 1) / (COLUMNS - 2 * LEAD);
        down = (high + BAND - 1) / BAND;
        if (group < CHANNELS * down * across) break;
        group -= CHANNELS * down * across;
    }
    const int axis = group / (down * across), top = group / across % down * BAND, end = min(top + BAND, high);
    const int x = group % across * (COLUMNS - 2 * LEAD) + item - LEAD;
    const int is_own = item >= LEAD && item < COLUMNS - LEAD && x < wide;
    const size_t plane = begin_of(level, rows, cols) + (size_t)axis * high * wide;
    __global const float *from = values + plane + mirror_index(x, wide);
    __global float *to = noise + plane + x;
    float scale[16];
#pragma unroll
    for (int k = 0; k < 16; ++k) scale[k] = scales[(level * CHANNELS + axis) * 16 + k];
    // Sums and differences of rows y and y + 1, a pair, make those of four rows; y & 1 is their place. Blocks remove `low`
    // and `rise` from their second pair. All are Walsh coefficients along the rows.
    float last[4], sums[2][4], differences[2][4], low[2][4], rise[2][4], rest[4];
#pragma unroll
    for (int n = 0; n < 3; ++n) strip[1][n][item] = from[mirror_index(top - 3 + n, high) * wide];
#pragma unroll
    for (int n = 0; n < STEP; ++n) strip[0][n][item] = from[mirror_index(top + n, high) * wide];
    barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
    for (int n = 0; n < 3; ++n) {
        float fresh[4];
        walsh(&strip[1][n][item], fresh);
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            if (n > 0) {
                sums[n - 1][k] = last[k] + fresh[k];
                differences[n - 1][k] = last[k] - fresh[k];
                low[n - 1][k] = rise[n - 1][k] = rest[k] = 0.0f;
            }
            last[k] = fresh[k];
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int first = top - 3; first < end; first += STEP) {  // the upper row of a block
        const int half_of = (first - top + 3) / STEP % 2;    // of the local memory: one barrier is enough
        float next[STEP], own[STEP];
#pragma unroll
        for (int n = 0; n < STEP; ++n) next[n] = from[mirror_index(first + STEP + 3 + n, high) * wide];
#pragma unroll
        for (int n = 0; n < STEP; ++n) {
            float fresh[4], done[4];
            walsh(&strip[half_of][n][item], fresh);
#pragma unroll
            for (int k = 0; k < 4; ++k) {
                const float sum = last[k] + fresh[k], difference = last[k] - fresh[k];
                // the mean of the block stays: a coarser level removes its noise
                const float mean = k > 0 ? noise_part(sums[n & 1][k] + sum, scale[k]) : 0.0f;
                const float half_part = noise_part(sums[n & 1][k] - sum, scale[4 + k]);
                const float bump = noise_part(differences[n & 1][k] - difference, scale[8 + k]);
                const float zigzag = noise_part(differences[n & 1][k] + difference, scale[12 + k]);
                const float both = (mean + half_part) + low[n & 1][k], apart = (bump + zigzag) + rise[n & 1][k];
                done[k] = (both + apart) + rest[k];
                rest[k] = both - apart;
                low[n & 1][k] = mean - half_part;
                rise[n & 1][k] = zigzag - bump;
                sums[n & 1][k] = sum;
                differences[n & 1][k] = difference;
                last[k] = fresh[k];
            }
            const float left = done[0] + done[1], right = done[0] - done[1];
            const float odd = done[2] + done[3], even = done[2] - done[3];
            own[n] = left + odd;
            others[half_of][n][0][item] = left - odd;
            others[half_of][n][1][item] = right - even;
            others[half_of][n][2][item] = right + even;
        }
#pragma unroll
        for (int n = 0; n < STEP; ++n) strip[1 - half_of][n][item] = next[n];
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!is_own) continue;
#pragma unroll
        for (int n = 0; n < STEP; ++n) {
            const float sum = (own[n] + others[half_of][n][0][item - 1])
                              + (others[half_of][n][1][item - 2] + others[half_of][n][2][item - 3]);
            if (first + n >= top && first + n < end) to[(first + n) * wide] = sum * (1.0f / 256.0f);
        }
    }
}

#define AROUND(side) ((side) + 2)               // of a coarser level's tile, with a neighbour on each side
#define SIDE(level) AROUND(max(TILE >> (level), 1))
#define MOST AROUND(TILE / 2)

// Bilinear interpolation from half the resolution at pixel (y, x), from a tile of pixels (top, left) on.
inline float interpolate(SHARED const float *coarse, const int y, const int x, const int side, const int top,
                         const int left, const int high, const int wide)
{
    const int v = y / 2, u = x / 2;
    const int far = min(max(v - 1 + 2 * (y & 1), 0), high - 1) - v, next = min(max(u - 1 + 2 * (x & 1), 0), wide - 1) - u;
    SHARED const float *at = coarse + (v - top) * side + u - left;
    return 0.75f * (0.75f * at[0] + 0.25f * at[next]) + 0.25f * (0.75f * at[far * side] + 0.25f * at[far * side + next]);
}

__kernel void join(
    // in:
    __global const float *restrict values,
    __global const float *restrict noise,
    __global const float *restrict gains,    // [ny][nx]
    __global const float *restrict inverse,  // [CHANNELS][CHANNELS], of the axes
    __global const float *restrict share,    // [CHANNELS]
    __global const float *restrict loss,     // of roots, see levels.py
    // out:
    __global float *restrict planes,         // [CHANNELS][rows][cols]
    // params:
    const float offset,
    // sizes:
    const int rows, const int cols, const int ny, const int nx)
{
    __local float coarse[2][CHANNELS * MOST * MOST];  // R - down(D) of odd and of even levels
    const int item = get_local_id(0), across = SIZE(cols, HALVINGS);
    const int top = get_group_id(0) / across * TILE, left = get_group_id(0) % across * TILE;
    const int x = left + item % TILE;
    const size_t plane = (size_t)rows * cols;
#pragma unroll
    for (int l = LEVELS - 1; l > 0; --l) {
        const int side = SIDE(l), high = SIZE(rows, l), wide = SIZE(cols, l);
        const int finer_high = SIZE(rows, l - 1), finer_wide = SIZE(cols, l - 1);
        __global const float *here = noise + begin_of(l, rows, cols), *finer = noise + begin_of(l - 1, rows, cols);
        for (int i = item; i < side * side; i += ITEMS) {
            const int y = (top >> l) - 1 + i / side, w = (left >> l) - 1 + i % side, at = 2 * (y * finer_wide + w);
            if (y < 0 || w < 0 || y >= high || w >= wide) continue;
            const int right = min(2 * w + 1, finer_wide - 1) - 2 * w;
            const int down = (min(2 * y + 1, finer_high - 1) - 2 * y) * finer_wide;
#pragma unroll 4
            for (int a = 0; a < CHANNELS; ++a) {
                __global const float *near = finer + (size_t)a * finer_high * finer_wide + at;
                const float mean = 0.25f * ((near[0] + near[right]) + (near[down] + near[down + right]));
                float sum = here[(size_t)a * high * wide + y * wide + w];
                if (l + 1 < LEVELS) {
                    const int coarser = SIDE(l + 1);
                    sum += interpolate(&coarse[(l + 1) & 1][a * coarser * coarser], y, w, coarser, (top >> (l + 1)) - 1,
                                       (left >> (l + 1)) - 1, SIZE(rows, l + 1), SIZE(cols, l + 1));
                }
                coarse[l & 1][a * side * side + i] = sum - mean;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (x >= cols) return;
#pragma unroll 2
    for (int n = 0; n < EACH; ++n) {
        const int y = top + item / TILE + n * LINES, at = y * cols + x;
        if (y >= rows) return;
        const float gain = gain_at(gains, y, x, rows, cols, ny, nx);
        float clean[CHANNELS];
#pragma unroll
        for (int a = 0; a < CHANNELS; ++a)
            clean[a] = (values[a * plane + at] - noise[a * plane + at])
                       - interpolate(&coarse[1][a * MOST * MOST], y, x, MOST, top / 2 - 1, left / 2 - 1, SIZE(rows, 1),
                                     SIZE(cols, 1));
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            float root = 0.0f;
#pragma unroll
            for (int a = 0; a < CHANNELS; ++a) root += inverse[c * CHANNELS + a] * clean[a];
            planes[c * plane + at] = gain * (light_of(root, share[c], loss) - offset);
        }
    }
}
