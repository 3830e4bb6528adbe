// One layer of network.cl over tiles, for GPUs: a tile's inputs and weights stay in local memory, CHUNK inputs at a time.
// A work-group makes ALONG columns of ROWS rows, a work-item EACH rows of one column in MADE outputs. From the host:
// INPUTS, OUTPUTS, CHUNK (divides INPUTS), ROWS, ITEMS = ALONG OUTPUTS / MADE ROWS / EACH.
// OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#pragma OPENCL FP_CONTRACT ON
#define ALONG 32
#define EACH 4
#define MADE 12
#define GUARD_COLUMNS 8
#define HIGH (ROWS + 2)
#define WIDE (ALONG + 2)

__kernel void convolve_tiles(
    // in:
    __global const float *restrict blocks,   // [INPUTS][high + 2][stride]
    __global const float *restrict weights,  // [INPUTS][9][OUTPUTS]
    __global const float *restrict biases,   // [OUTPUTS]
    // out:
    __global float *restrict out,            // [OUTPUTS][high + 2][stride]
    // params:
    const int kind,                          // as in network.cl
    // sizes:
    const int high, const int wide, const int stride, const int across)
{
    __local float tile[CHUNK * HIGH * WIDE];
    __local float4 shared[CHUNK * 9 * OUTPUTS / 4];
    const int item = get_local_id(0), plane = (high + 2) * stride;
    const int left = get_group_id(0) % across * ALONG, top = get_group_id(0) / across * ROWS;
    const int column = item % ALONG, part = item / ALONG;
    const int first = part % (OUTPUTS / MADE) * MADE, row = part / (OUTPUTS / MADE) * EACH;
    float sums[EACH][MADE];
#pragma unroll
    for (int r = 0; r < EACH; ++r) {
#pragma unroll
        for (int o = 0; o < MADE; ++o) sums[r][o] = biases[first + o];
    }
    for (int begin = 0; begin < INPUTS; begin += CHUNK) {
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = item; i < CHUNK * HIGH * WIDE; i += ITEMS) {
            const int y = min(top + i / WIDE % HIGH, high + 1);
            const int x = min(left + GUARD_COLUMNS - 1 + i % WIDE, stride - 1);
            tile[i] = blocks[(begin + i / (HIGH * WIDE)) * plane + y * stride + x];
        }
        for (int i = item; i < CHUNK * 9 * OUTPUTS / 4; i += ITEMS)
            shared[i] = ((__global const float4 *)weights)[begin * 9 * OUTPUTS / 4 + i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = 0; i < CHUNK; ++i) {
            float values[3][EACH + 2];
#pragma unroll
            for (int dx = 0; dx < 3; ++dx) {
#pragma unroll
                for (int r = 0; r < EACH + 2; ++r) values[dx][r] = tile[(i * HIGH + row + r) * WIDE + column + dx];
            }
#pragma unroll
            for (int k = 0; k < 9; ++k) {
#pragma unroll
                for (int q = 0; q < MADE / 4; ++q) {
                    const float4 weight = shared[((i * 9 + k) * OUTPUTS + first) / 4 + q];
#pragma unroll
                    for (int r = 0; r < EACH; ++r) {
                        const float value = values[k % 3][r + k / 3];
                        sums[r][4 * q] += weight.x * value;
                        sums[r][4 * q + 1] += weight.y * value;
                        sums[r][4 * q + 2] += weight.z * value;
                        sums[r][4 * q + 3] += weight.w * value;
                    }
                }
            }
        }
    }
    const int x = left + column;
#pragma unroll
    for (int r = 0; r < EACH; ++r) {
        const int y = top + row + r;
        if (x < wide && y < high) {
            const int middle = (y + 1) * stride + GUARD_COLUMNS + x;
#pragma unroll
            for (int o = 0; o < MADE; ++o) {
                const int at = (first + o) * plane + middle;
                float value = sums[r][o];
                if (kind == 1) value += blocks[at];
                out[at] = kind == 2 ? value : fmax(value, 0.0f);
            }
        }
    }
}
