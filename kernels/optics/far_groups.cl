// The far field on GPUs: both axes of a grid at once, with the intermediate result in a work-group's local memory.
// From the host: HIGH, blocks of four rows in a work-group's result, 8 or a part of it; LOCAL_BYTES.
//
// OpenCL C that is also CUDA C++, see common/fft.clh.
#ifndef LOCAL
#define LOCAL(type, name, count) __local type name[count]
#endif
#define WIDE 32             // columns of a work-group, the lanes of a warp
#define LINES 8             // of such lanes
#define STRIP (4 * LINES)   // rows that are taken from global memory at a time
#define SHARES (LINES / HIGH)  // lines that make one block of rows, each with a part of the entries

__kernel void both(
    // in:
    __global const float *restrict given,     // [batch][size_y][size_x]
    __global const float *restrict weights,   // [channels][planes][sums], of planes in a channel; or nothing
    __global const float4 *restrict values_y, __global const int *restrict start_y,  // [sums][blocks][most_y], [sums][blocks]
    __global const int *restrict count_y, __global const int *restrict tiles_y,      // [sums][blocks], [sums][down][2]
    __global const float *restrict values_x, __global const int *restrict start_x,   // [sums][most_x][cols], [sums][cols]
    __global const int *restrict count_x, __global const int *restrict tiles_x,      // [sums][cols], [sums][across][2]
    // out:
    __global float *restrict out,             // [channels][parts][rows][cols]
    // params:
    const int is_added, const int is_weighted, const int pitch, const int stride, const int parts,
    // sizes:
    const int planes, const int size_y, const int size_x, const int rows, const int cols, const int blocks,
    const int most_y, const int most_x, const int sums, const int down, const int across)
{
    LOCAL(float, strip, LOCAL_BYTES / 4);  // [STRIP][pitch] of the input, then [rows of a tile][WIDE]
    const int between = STRIP * pitch, lane = get_local_id(0) % WIDE, line = get_local_id(0) / WIDE;
    const int tile_x = get_group_id(0) % across, tile_y = get_group_id(0) / across % down;
    const int batch = get_group_id(0) / (across * down), channel = batch / parts;
    const int x = tile_x * WIDE + lane, block = tile_y * HIGH + line % HIGH, share = line / HIGH;
    __global const float *first = given + (size_t)channel * stride * size_y * size_x;
    float total[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int s = batch % parts; s < sums; s += parts) {
        const int top = tiles_y[2 * (s * down + tile_y)], high = tiles_y[2 * (s * down + tile_y) + 1];
        const int left = tiles_x[2 * (s * across + tile_x)], wide = tiles_x[2 * (s * across + tile_x) + 1];
        const int entries_x = x < cols ? count_x[s * cols + x] : 0, first_x = x < cols ? start_x[s * cols + x] - left : 0;
        for (int done = 0; done < high; done += STRIP) {
            int at[4];  // rows beyond the last are the last once more, and not used
            _Pragma("unroll") for (int n = 0; n < 4; ++n) {
                const int row = done + line + n * LINES;
                at[n] = (top + (row < high ? row : high - 1)) * size_x + left;
            }
            for (int u = lane; u < wide; u += WIDE) {
                float light[4] = {0.0f, 0.0f, 0.0f, 0.0f};
                _Pragma("unroll 4") for (int k = 0; k < planes; ++k) {
                    const float weight = is_weighted ? weights[(channel * planes + k) * sums + s] : 1.0f;
                    __global const float *plane = first + (size_t)k * size_y * size_x + u;
                    _Pragma("unroll") for (int n = 0; n < 4; ++n) light[n] += weight * plane[at[n]];
                }
                _Pragma("unroll") for (int n = 0; n < 4; ++n) strip[(line + n * LINES) * pitch + u] = light[n];
            }
            barrier(CLK_LOCAL_MEM_FENCE);
            float part[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            _Pragma("unroll 4") for (int entry = 0; entry < entries_x; ++entry) {
                const float weight = values_x[(s * most_x + entry) * cols + x];
                _Pragma("unroll") for (int n = 0; n < 4; ++n)
                    part[n] += weight * strip[(line + n * LINES) * pitch + first_x + entry];
            }
            _Pragma("unroll") for (int n = 0; n < 4; ++n)
                if (done + line + n * LINES < high) strip[between + (done + line + n * LINES) * WIDE + lane] = part[n];
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        if (block < blocks) {
            const int own = s * blocks + block, first_y = start_y[own] - top, entries_y = count_y[own];
            _Pragma("unroll 4") for (int entry = share; entry < entries_y; entry += SHARES) {
                const float4 weight = values_y[own * most_y + entry];
                const float light = strip[between + (first_y + entry) * WIDE + lane];
                total[0] += weight.x * light;
                total[1] += weight.y * light;
                total[2] += weight.z * light;
                total[3] += weight.w * light;
            }
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    _Pragma("unroll") for (int n = 0; n < 4; ++n)
        if (SHARES > 1) strip[(n * LINES + line) * WIDE + lane] = total[n];
    barrier(CLK_LOCAL_MEM_FENCE);
    _Pragma("unroll") for (int n = 0; n < 4; ++n)
        if (share == 0 && x < cols && 4 * block + n < rows) {
            _Pragma("unroll") for (int m = 1; m < SHARES; ++m)
                total[n] += strip[(n * LINES + line + m * HIGH) * WIDE + lane];
            const size_t place = ((size_t)batch * rows + 4 * block + n) * cols + x;
            out[place] = (is_added ? out[place] : 0.0f) + total[n];
        }
}

// Pixels of a mosaic, or of every channel, from the splines around them: 32 x 32 of a work-group.
__kernel void evaluate(
    // in:
    __global const float *restrict onto,      // [1 or channels][rows][cols]
    __global const float *restrict light,     // [channels][high][wide]
    __global const float4 *restrict values_y, __global const int *restrict start_y,  // [rows]
    __global const float4 *restrict values_x, __global const int *restrict start_x,  // [cols]
    __global const int *restrict cfa,         // [phases_y][phases_x]
    // out:
    __global float *restrict out,             // as onto
    // sizes:
    const int rows, const int cols, const int high, const int wide, const int phases_y, const int phases_x,
    const int down, const int across)
{
    const int x = get_group_id(0) % across * WIDE + get_local_id(0) % WIDE;
    const int first = get_group_id(0) / across % down * STRIP + get_local_id(0) / WIDE;
    const int plane = get_group_id(0) / (across * down);
    if (x >= cols) return;
    const float4 row = values_x[x];
    const int left = start_x[x], phase = x % phases_x;
    _Pragma("unroll") for (int n = 0; n < 4; ++n) {
        const int y = first + n * LINES;
        if (y < rows) {
            const int channel = plane + cfa[y % phases_y * phases_x + phase];
            __global const float *own = light + ((size_t)channel * high + start_y[y]) * wide + left;
            const float4 column = values_y[y];
            const float weights[4] = {column.x, column.y, column.z, column.w};
            const size_t at = ((size_t)plane * rows + y) * cols + x;
            float sum = onto[at];
            _Pragma("unroll") for (int m = 0; m < 4; ++m)
                sum += weights[m] * (row.x * own[m * wide] + row.y * own[m * wide + 1] + row.z * own[m * wide + 2]
                                     + row.w * own[m * wide + 3]);
            out[at] = sum;
        }
    }
}
