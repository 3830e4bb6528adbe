// The far field on GPUs: both axes of a grid at once, what is between them in the local memory of a work-group.
// From the host: HIGH blocks of four rows and 32 columns are a work-group's result; LOCAL_BYTES; THREADS.
//
// OpenCL C that is also CUDA C++, see common/fft.clh.
#ifndef LOCAL
#define LOCAL(type, name, count) __local type name[count]
#endif
#define WIDE 32         // columns, of the lanes of a warp
#define STRIP (4 * HIGH)  // rows that are taken from global memory at a time

__kernel void both(
    // in:
    __global const float *restrict given,     // [planes][size_y][size_x]
    __global const float *restrict weights,   // [channels][planes][sums] if channels are made of planes, or nothing
    __global const float4 *restrict values_y, __global const int *restrict start_y,  // [sums][blocks][most_y], [sums][blocks]
    __global const int *restrict count_y, __global const int *restrict tiles_y,      // [sums][blocks], [sums][down][2]
    __global const float *restrict values_x, __global const int *restrict start_x,   // [sums][most_x][cols], [sums][cols]
    __global const int *restrict count_x, __global const int *restrict tiles_x,      // [sums][cols], [sums][across][2]
    // out:
    __global float *restrict out,             // [planes or channels][rows][cols]
    // params:
    const int is_added, const int is_mixed, const int pitch,
    // sizes:
    const int planes, const int size_y, const int size_x, const int rows, const int cols, const int blocks,
    const int most_y, const int most_x, const int sums, const int down, const int across)
{
    LOCAL(float, strip, LOCAL_BYTES / 4);  // [STRIP][pitch] of what is given, then [rows of a tile][WIDE]
    const int between = STRIP * pitch, lane = get_local_id(0) % WIDE, line = get_local_id(0) / WIDE;
    const int tile_x = get_group_id(0) % across, tile_y = get_group_id(0) / across % down;
    const int batch = get_group_id(0) / (across * down), x = tile_x * WIDE + lane, block = tile_y * HIGH + line;
    float total[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int s = 0; s < sums; ++s) {
        const int top = tiles_y[2 * (s * down + tile_y)], high = tiles_y[2 * (s * down + tile_y) + 1];
        const int left = tiles_x[2 * (s * across + tile_x)], wide = tiles_x[2 * (s * across + tile_x) + 1];
        const int entries_x = x < cols ? count_x[s * cols + x] : 0, first_x = x < cols ? start_x[s * cols + x] - left : 0;
        for (int done = 0; done < high; done += STRIP) {
            for (int row = line; row < STRIP && done + row < high; row += HIGH)
                for (int u = lane; u < wide; u += WIDE) {
                    __global const float *value = given + (size_t)(top + done + row) * size_x + left + u;
                    float light = 0.0f;
                    if (is_mixed)
                        for (int k = 0; k < planes; ++k)
                            light += weights[(batch * planes + k) * sums + s] * value[(size_t)k * size_y * size_x];
                    else
                        light = value[(size_t)batch * size_y * size_x];
                    strip[row * pitch + u] = light;
                }
            barrier(CLK_LOCAL_MEM_FENCE);
            float part[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            for (int entry = 0; entry < entries_x; ++entry) {
                const float weight = values_x[(s * most_x + entry) * cols + x];
                _Pragma("unroll") for (int n = 0; n < 4; ++n)
                    part[n] += weight * strip[(line + n * HIGH) * pitch + first_x + entry];
            }
            _Pragma("unroll") for (int n = 0; n < 4; ++n)
                if (done + line + n * HIGH < high) strip[between + (done + line + n * HIGH) * WIDE + lane] = part[n];
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        if (block < blocks) {
            const int own = s * blocks + block, first_y = start_y[own] - top, entries_y = count_y[own];
            for (int entry = 0; entry < entries_y; ++entry) {
                const float4 weight = values_y[own * most_y + entry];
                const float light = strip[between + (first_y + entry) * WIDE + lane];
                total[0] += weight.x * light;
                total[1] += weight.y * light;
                total[2] += weight.z * light;
                total[3] += weight.w * light;
            }
        }
    }
    _Pragma("unroll") for (int n = 0; n < 4; ++n)
        if (x < cols && 4 * block + n < rows) {
            const size_t at = ((size_t)batch * rows + 4 * block + n) * cols + x;
            out[at] = (is_added ? out[at] : 0.0f) + total[n];
        }
}

// A pixel of a mosaic, or of every channel, from the splines around it.
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
    const int pixels, const int rows, const int cols, const int high, const int wide, const int phases_y,
    const int phases_x)
{
    const int at = get_group_id(0) * THREADS + get_local_id(0);
    if (at >= pixels) return;
    const int plane = at / (rows * cols), y = at / cols % rows, x = at % cols;
    const int channel = plane + cfa[y % phases_y * phases_x + x % phases_x];
    __global const float *own = light + ((size_t)channel * high + start_y[y]) * wide + start_x[x];
    const float4 down = values_y[y], across = values_x[x];
    const float weights[4] = {down.x, down.y, down.z, down.w};
    float sum = onto[at];
    _Pragma("unroll") for (int n = 0; n < 4; ++n)
        sum += weights[n] * (across.x * own[n * wide] + across.y * own[n * wide + 1] + across.z * own[n * wide + 2]
                             + across.w * own[n * wide + 3]);
    out[at] = sum;
}
