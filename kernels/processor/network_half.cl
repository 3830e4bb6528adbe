// The layers of network.cl by matrix units: products of float16, sums of float32. For NVIDIA's devices from compute
// capability 8.0 on, whose instructions OpenCL has no other name for.
// Channels of a block are side by side, WIDTH of them. A work-group makes DOWN rows of ALONG blocks, a warp two rows.
// A warp multiplies 16 blocks with 16 channels by 16 channels with 8 outputs. Of these its work-item 4 g + t holds the
// blocks g and g + 8, and the channels t WIDTH / 4 + 4 s .. + 3 in the step s: any order of a sum will do, and these
// are side by side in memory. From the host: WIDTH and OUT (multiples of 16).
// OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#include "bayer.clh"
#define ALONG 32
#define DOWN 8
#define ITEMS 128
#define GUARD_COLUMNS 8
#define ACROSS (ALONG + 2)
#define STEPS (WIDTH / 16)
#define TILES (OUT / 8)  // of 8 outputs
#define MOST 65504.0f    // in float16

// Two numbers in float16, the first one in the lower half.
uint to_halves(const float low, const float high)
{
    uint halves;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(halves) : "f"(min(high, MOST)), "f"(min(low, MOST)));
    return halves;
}

float from_half(const uint bits)
{
    float value;
    asm("{ .reg .b16 low, high; mov.b32 {low, high}, %1; cvt.f32.f16 %0, low; }" : "=f"(value) : "r"(bits));
    return value;
}

__kernel void encode_half(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    __global const int *restrict colors,  // [period_y][period_x]
    // out:
    __global float *restrict codes,       // [height][width]
    __global ushort *restrict hues,       // [height][width] colour of each pixel
    // params:
    const float black_level, const float scale, const float offset, const float red, const float green,
    const float blue, const int root, const int margin,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int height, const int width)
{
    const int at = get_group_id(0) * ITEMS + get_local_id(0), x = at % width, y = at / width;
    if (y >= height) return;
    const int v = outside(y - margin, rows, period_y), u = outside(x - margin, cols, period_x);
    const int color = colors[v % period_y * period_x + u % period_x];
    float code = ((float)raw[v * cols + u] - black_level) * scale;
    if (root) {
        code += offset;
        code = (color == 0 ? red : color == 1 ? green : blue) * (code < 0.0f ? -sqrt(-code) : sqrt(code));
    }
    codes[at] = code;
    hues[at] = color;
}

// The first guess of a block's pixels, and the inputs of the first layer.
__kernel void guess_half(
    // in:
    __global const float *restrict codes,  // [2 high + 6][2 wide + 6]
    __global const ushort *restrict hues,  // [2 high + 6][2 wide + 6]
    __global const float *restrict taps,   // [7]
    // out:
    __global float *restrict guess,        // [3][2 high][2 wide]
    __global ushort *restrict blocks,      // [high + 2][stride][OUT], 28 used
    // params:
    const float red, const float green, const float blue,  // noise of their codes
    // sizes:
    const int high, const int wide, const int stride)
{
    const int item = get_group_id(0) * ITEMS + get_local_id(0), x = item % wide, y = item / wide;
    if (y >= high) return;
    float sums[4][3], totals[4][3], values[32];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
#pragma unroll
        for (int c = 0; c < 3; ++c) sums[i][c] = totals[i][c] = 0.0f;
        values[28 + i] = 0.0f;
    }
#pragma unroll
    for (int dy = 0; dy < 8; ++dy) {
#pragma unroll
        for (int dx = 0; dx < 8; ++dx) {
            const int at = (2 * y + dy) * (2 * wide + 6) + 2 * x + dx, hue = hues[at];
            const float code = codes[at];
#pragma unroll
            for (int c = 0; c < 3; ++c) {
                const float mask = hue == c ? 1.0f : 0.0f, masked = hue == c ? code : 0.0f;
#pragma unroll
                for (int i = 0; i < 4; ++i) {
                    const int v = dy - i / 2, u = dx - i % 2;
                    if (v < 0 || v > 6 || u < 0 || u > 6) continue;
                    const float weight = taps[v] * taps[u];
                    sums[i][c] += weight * masked;
                    totals[i][c] += weight * mask;
                    if (v != 3 || u != 3) continue;
                    values[4 * c + i] = code;
                    values[12 + 4 * c + i] = mask;
                    values[24 + i] = hue == 0 ? red : hue == 1 ? green : blue;
                }
            }
        }
    }
#pragma unroll
    for (int i = 0; i < 4; ++i) {
#pragma unroll
        for (int c = 0; c < 3; ++c) {
            const int k = 4 * c + i;
            if (values[12 + k] == 0.0f) values[k] = sums[i][c] / totals[i][c];
            guess[(c * 2 * high + 2 * y + i / 2) * 2 * wide + 2 * x + i % 2] = values[k];
        }
    }
    __global uint2 *to = (__global uint2 *)blocks + ((y + 1) * stride + GUARD_COLUMNS + x) * (OUT / 4);
#pragma unroll
    for (int i = 0; i < OUT / 4; ++i) {
        uint2 four;
        four.x = i < 8 ? to_halves(values[i % 8 * 4], values[i % 8 * 4 + 1]) : 0;
        four.y = i < 8 ? to_halves(values[i % 8 * 4 + 2], values[i % 8 * 4 + 3]) : 0;
        to[i] = four;
    }
}

__kernel void convolve_half(
    // in:
    __global const ushort *restrict blocks,   // [high + 2][stride][WIDTH]
    __global const ushort *restrict weights,  // [9][STEPS][TILES][32][4]
    __global const float *restrict biases,    // [OUT]
    // out:
    __global ushort *restrict out,            // [high + 2][stride][OUT]
    // params:
    const int kind,                           // as in network.cl
    // sizes:
    const int high, const int wide, const int stride, const int groups_across)
{
    __local uint2 tile[(DOWN + 2) * ACROSS * WIDTH / 4];
    const int item = get_local_id(0), g = item % 32 / 4, t = item % 4, row = item / 32 * 2;
    const int left = get_group_id(0) % groups_across * ALONG, top = get_group_id(0) / groups_across * DOWN;
    for (int i = item; i < (DOWN + 2) * ACROSS * WIDTH / 4; i += ITEMS) {
        const int place = i / (WIDTH / 4);
        const int y = min(top + place / ACROSS, high + 1), x = min(left + GUARD_COLUMNS - 1 + place % ACROSS, stride - 1);
        tile[i] = ((__global const uint2 *)blocks)[(y * stride + x) * (WIDTH / 4) + i % (WIDTH / 4)];
    }
    float sums[4][TILES][4];  // of 16 blocks: outputs 2 t + {0, 1} of block g, then of block g + 8
#pragma unroll
    for (int n = 0; n < TILES; ++n) {
        const float even = biases[OUT / 4 * t + 2 * n], odd = biases[OUT / 4 * t + 2 * n + 1];
#pragma unroll
        for (int m = 0; m < 4; ++m) {
            sums[m][n][0] = sums[m][n][2] = even;
            sums[m][n][1] = sums[m][n][3] = odd;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < 9; ++k) {
#pragma unroll
        for (int s = 0; s < STEPS; ++s) {
            uint2 lower[4], upper[4];
#pragma unroll
            for (int m = 0; m < 4; ++m) {
                const int place = (row + m / 2 + k / 3) * ACROSS + m % 2 * 16 + g + k % 3;
                lower[m] = tile[place * (WIDTH / 4) + t * STEPS + s];
                upper[m] = tile[(place + 8) * (WIDTH / 4) + t * STEPS + s];
            }
#pragma unroll
            for (int n = 0; n < TILES; ++n) {
                const uint2 weight = ((__global const uint2 *)weights)[((k * STEPS + s) * TILES + n) * 32 + item % 32];
#pragma unroll
                for (int m = 0; m < 4; ++m)
                    asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
                        "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
                        : "+f"(sums[m][n][0]), "+f"(sums[m][n][1]), "+f"(sums[m][n][2]), "+f"(sums[m][n][3])
                        : "r"(lower[m].x), "r"(upper[m].x), "r"(lower[m].y), "r"(upper[m].y), "r"(weight.x), "r"(weight.y));
            }
        }
    }
#pragma unroll
    for (int m = 0; m < 4; ++m) {
#pragma unroll
        for (int h = 0; h < 2; ++h) {
            const int v = row + m / 2, u = m % 2 * 16 + 8 * h + g, y = top + v, x = left + u;
            if (y >= high || x >= wide) continue;
            __global uint2 *to = (__global uint2 *)out + ((y + 1) * stride + GUARD_COLUMNS + x) * (OUT / 4) + t * (OUT / 16);
#pragma unroll
            for (int q = 0; q < OUT / 16; ++q) {
                float values[4];
                values[0] = sums[m][2 * q][2 * h];
                values[1] = sums[m][2 * q][2 * h + 1];
                values[2] = sums[m][2 * q + 1][2 * h];
                values[3] = sums[m][2 * q + 1][2 * h + 1];
                if (kind == 1) {
                    const uint2 own = tile[((v + 1) * ACROSS + u + 1) * (WIDTH / 4) + t * STEPS + q];
                    values[0] += from_half(own.x);
                    values[1] += from_half(own.x >> 16);
                    values[2] += from_half(own.y);
                    values[3] += from_half(own.y >> 16);
                }
                if (kind != 2) {
#pragma unroll
                    for (int i = 0; i < 4; ++i) values[i] = max(values[i], 0.0f);
                }
                uint2 four;
                four.x = to_halves(values[0], values[1]);
                four.y = to_halves(values[2], values[3]);
                to[q] = four;
            }
        }
    }
}

__kernel void decode_half(
    // in:
    __global const float *restrict guess,    // [3][2 high][2 wide]
    __global const ushort *restrict blocks,  // [high + 2][stride][16], 12 used
    // out:
    __global float *restrict rgb,            // [3][rows][cols]
    // params:
    const float offset, const float red, const float green, const float blue, const int root, const int margin,
    // sizes:
    const int high, const int wide, const int stride, const int rows, const int cols)
{
    const int item = get_group_id(0) * ITEMS + get_local_id(0), x = item % cols, y = item / cols;
    if (y >= rows) return;
    const int v = y + margin, u = x + margin;
    const int at = ((v / 2 + 1) * stride + GUARD_COLUMNS + u / 2) * 16 + v % 2 * 2 + u % 2;
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        float code = guess[(c * 2 * high + v) * 2 * wide + u] + from_half(blocks[at + 4 * c]);
        if (root) {
            code /= c == 0 ? red : c == 1 ? green : blue;
            code = code * fabs(code) - offset;
        }
        rgb[(c * rows + y) * cols + x] = code;
    }
}
