// From the samples to planes of blocks, through the layers, and back. A CPU's work-item of `convolve` makes ALONG blocks
// of a row, MADE outputs of EACH vectors at once in registers; GPUs have network_tiles.cl. Planes of blocks have a row above and below and GUARD columns before them. What is there
// is never written; it reaches only the margin of the frame, a block further with each layer.
#pragma OPENCL FP_CONTRACT ON
#include "bayer.clh"
#define GUARD_COLUMNS 8
#define MADE 6
#define EACH 2
#define ALONG 64

__kernel void encode(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    __global const int *restrict colors,  // [period_y][period_x]
    // out:
    __global float *restrict samples,     // [7][height][width] codes and masks of the colours, noise
    // params:
    const float black_level, const float scale, const float offset, const float sigma, const float red,
    const float green, const float blue, const int root, const int margin,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int height, const int width)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= width || y >= height);
    const long plane = (long)height * width, at = (long)y * width + x;
    const int v = outside(y - margin, rows, period_y), u = outside(x - margin, cols, period_x);
    const int color = colors[v % period_y * period_x + u % period_x];
    const float factor = color == 0 ? red : color == 1 ? green : blue;
    float code = ((float)raw[(long)v * cols + u] - black_level) * scale;
    if (root) {
        code += offset;
        code = factor * (code < 0.0f ? -sqrt(-code) : sqrt(code));
    }
    for (int c = 0; c < 3; ++c) {
        samples[c * plane + at] = c == color ? code : 0.0f;
        samples[(3 + c) * plane + at] = c == color ? 1.0f : 0.0f;
    }
    samples[6 * plane + at] = root ? factor * sigma : 0.0f;
}

__kernel void guess(
    // in:
    __global const float *restrict samples,  // [7][height][width]
    __global const float *restrict taps,     // [7]
    // out:
    __global float *restrict planes,         // [3][height - 6][width - 6]
    // sizes:
    const int height, const int width)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= width - 6 || y >= height - 6);
    const long plane = (long)height * width;
    for (int c = 0; c < 3; ++c) {
        __global const float *codes = samples + c * plane + (long)y * width + x;
        __global const float *masks = codes + 3 * plane;
        float sum = 0.0f, total = 0.0f;
        for (int dy = 0; dy < 7; ++dy) {
            for (int dx = 0; dx < 7; ++dx) {
                const float weight = taps[dy] * taps[dx];
                sum += weight * codes[(long)dy * width + dx];
                total += weight * masks[(long)dy * width + dx];
            }
        }
        const long here = 3L * width + 3;
        planes[(c * (long)(height - 6) + y) * (width - 6) + x] = masks[here] > 0.0f ? codes[here] : sum / total;
    }
}

__kernel void pack(
    // in:
    __global const float *restrict samples,  // [7][2 high + 6][2 wide + 6]
    __global const float *restrict guess,    // [3][2 high][2 wide]
    // out:
    __global float *restrict blocks,         // [28][high + 2][stride]
    // sizes:
    const int high, const int wide, const int stride)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= wide || y >= high);
    const long plane = (long)(high + 2) * stride, across = 2L * wide + 6, area = (2L * high + 6) * across;
    __global float *out = blocks + (y + 1L) * stride + GUARD_COLUMNS + x;
    for (int i = 0; i < 4; ++i) {
        const long v = 2L * y + i / 2, u = 2L * x + i % 2;
        for (int c = 0; c < 3; ++c) {
            out[(4 * c + i) * plane] = guess[(c * 2L * high + v) * 2L * wide + u];
            out[(12 + 4 * c + i) * plane] = samples[(3 + c) * area + (v + 3) * across + u + 3];
        }
        out[(24 + i) * plane] = samples[6 * area + (v + 3) * across + u + 3];
    }
}

__kernel void convolve(
    // in:
    __global const float *restrict blocks,   // [inputs][high + 2][stride]
    __global const float *restrict weights,  // [outputs / MADE][inputs][9][MADE]
    __global const float *restrict biases,   // [outputs]
    // out:
    __global float *restrict out,            // [outputs][high + 2][stride]
    // params:
    const int kind,                          // 0: relu, 1: its input added, then relu, 2: neither
    // sizes:
    const int inputs, const int outputs, const int high, const int stride)
{
    const long plane = (long)(high + 2) * stride;
    const int y = get_global_id(1), begin = get_global_id(0) * ALONG;
    for (int made = 0; made < outputs; made += MADE) {
        for (int x = begin; x < begin + ALONG; x += EACH * 8) {
            const long middle = (y + 1L) * stride + x;
            float8 sums[MADE][EACH];
#pragma unroll
            for (int o = 0; o < MADE; ++o) {
#pragma unroll
                for (int e = 0; e < EACH; ++e) sums[o][e] = biases[made + o];
            }
            __global const float *weight = weights + (long)made * inputs * 9;
            for (int i = 0; i < inputs; ++i) {
                for (int dy = 0; dy < 3; ++dy) {
                    __global const float *from = blocks + i * plane + middle + (dy - 1L) * stride - 1;
#pragma unroll
                    for (int dx = 0; dx < 3; ++dx, weight += MADE) {
                        float8 values[EACH];
#pragma unroll
                        for (int e = 0; e < EACH; ++e) values[e] = vload8(e, from + dx);
#pragma unroll
                        for (int o = 0; o < MADE; ++o) {
#pragma unroll
                            for (int e = 0; e < EACH; ++e) sums[o][e] += weight[o] * values[e];
                        }
                    }
                }
            }
#pragma unroll
            for (int o = 0; o < MADE; ++o) {
                const long at = (made + o) * plane + middle;
#pragma unroll
                for (int e = 0; e < EACH; ++e) {
                    float8 value = sums[o][e];
                    if (kind == 1) value += vload8(e, blocks + at);
                    vstore8(kind == 2 ? value : fmax(value, 0.0f), e, out + at);
                }
            }
        }
    }
}

__kernel void decode(
    // in:
    __global const float *restrict guess,   // [3][2 high][2 wide]
    __global const float *restrict blocks,  // [12][high + 2][stride]
    // out:
    __global float *restrict rgb,           // [3][rows][cols]
    // params:
    const float offset, const float red, const float green, const float blue, const int root, const int margin,
    // sizes:
    const int high, const int wide, const int stride, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows);
    const int v = y + margin, u = x + margin;
    const long at = (v / 2 + 1L) * stride + GUARD_COLUMNS + u / 2, plane = (long)(high + 2) * stride;
    for (int c = 0; c < 3; ++c) {
        float code = guess[(c * 2L * high + v) * 2L * wide + u] + blocks[(4 * c + v % 2 * 2 + u % 2) * plane + at];
        if (root) {
            code /= c == 0 ? red : c == 1 ? green : blue;
            code = code * fabs(code) - offset;
        }
        rgb[((long)c * rows + y) * cols + x] = code;
    }
}
