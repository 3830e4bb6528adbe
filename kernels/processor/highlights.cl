// Blocks, then sums of four up to one block, then colours filled from coarse to fine, then the pixels. CHANNELS and BLOCK
// come from the host.
#include "nodes.clh"

inline float part_clipped(const float value, const float per_top, const float first, const float span)
{
    return clamp((value * per_top - first) * span, 0.0f, 1.0f);
}

__kernel void measure_blocks(
    // in:
    __global const float *restrict camera,  // [CHANNELS][rows][cols]
    // out:
    __global float *restrict sums,          // [CHANNELS + 1][ny][nx], last the weights
    // params:
    const float per_top, const float first, const float span,
    // sizes:
    const int rows, const int cols, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1);
    GUARD(i >= nx || j >= ny)
    const long pixels = (long)rows * cols;
    float found[CHANNELS + 1];
#pragma unroll
    for (int c = 0; c <= CHANNELS; ++c) found[c] = 0.0f;
    const int end_y = min((j + 1) * BLOCK, rows), end_x = min((i + 1) * BLOCK, cols);
    for (int y = j * BLOCK; y < end_y; ++y)
        for (int x = i * BLOCK; x < end_x; ++x) {
            float light[CHANNELS], total = 0.0f, most = 0.0f, known = 1.0f;
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) {
                const float value = camera[c * pixels + (long)y * cols + x];
                light[c] = value < 0.0f ? 0.0f : value;  // NaN stays
                total += light[c];
                most = fmax(most, light[c]);
                known *= 1.0f - part_clipped(value, per_top, first, span);
            }
            const float share = fmin(most * per_top, 1.0f), weight = share * share * share * share * known;
            if (total > 0.0f && total <= FLT_MAX && weight > 0.0f) {
#pragma unroll
                for (int c = 0; c < CHANNELS; ++c) found[c] += weight * (light[c] / total);
                found[CHANNELS] += weight;
            }
        }
#pragma unroll
    for (int c = 0; c <= CHANNELS; ++c) sums[((long)c * ny + j) * nx + i] = found[c];
}

__kernel void add_up(
    // in:
    __global const float *restrict fine,  // [planes][fine_y][fine_x]
    // out:
    __global float *restrict coarse,      // [planes][ny][nx]
    // sizes:
    const int fine_y, const int fine_x, const int planes, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1), p = get_global_id(2);
    GUARD(i >= nx || j >= ny || p >= planes)
    __global const float *from = fine + ((long)p * fine_y + 2 * j) * fine_x + 2 * i;
    const bool is_right = 2 * i + 1 < fine_x, is_below = 2 * j + 1 < fine_y;
    float sum = from[0];
    if (is_right) sum += from[1];
    if (is_below) sum += from[fine_x];
    if (is_right && is_below) sum += from[fine_x + 1];
    coarse[((long)p * ny + j) * nx + i] = sum;
}

__kernel void fill(
    // in:
    __global const float *restrict sums,    // [planes + 1][ny][nx]
    __global const float *restrict colors,  // [planes][coarse_y][coarse_x]
    // out:
    __global float *restrict filled,        // [planes][ny][nx]
    // params:
    const float trust,
    // sizes:
    const int coarse_y, const int coarse_x, const int planes, const int ny, const int nx)
{
    const int i = get_global_id(0), j = get_global_id(1), p = get_global_id(2);
    GUARD(i >= nx || j >= ny || p >= planes)
    const float around = between(colors + (long)p * coarse_y * coarse_x, coarse_y, coarse_x,
                                 (j + 0.5f) * 0.5f - 0.5f, (i + 0.5f) * 0.5f - 0.5f);
    const long block = (long)j * nx + i, blocks = (long)ny * nx;
    filled[p * blocks + block] = (sums[p * blocks + block] + trust * around) / (sums[planes * blocks + block] + trust);
}

__kernel void rebuild(
    // in:
    __global const float *restrict camera,  // [CHANNELS][rows][cols]
    __global const float *restrict colors,  // [CHANNELS][ny][nx]
    // out:
    __global float *restrict out,           // [CHANNELS][rows][cols]
    // params:
    const float per_top, const float first, const float span, const float dark, const float most,
    // sizes:
    const int rows, const int cols, const int ny, const int nx)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const long pixels = (long)rows * cols, i = (long)y * cols + x;
    float value[CHANNELS], clipped[CHANNELS], total = 0.0f, any = 0.0f;
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) {
        value[c] = camera[c * pixels + i];
        clipped[c] = part_clipped(value[c], per_top, first, span);
        any = fmax(any, clipped[c]);
        total += value[c];
    }
    if (any > 0.0f && fabs(total) <= FLT_MAX) {  // NaN compares false
        float rho[CHANNELS], above = 0.0f, below = dark, brightest = 0.0f;
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            rho[c] = between(colors + (long)c * ny * nx, ny, nx, (y + 0.5f) / BLOCK - 0.5f, (x + 0.5f) / BLOCK - 0.5f);
            const float light = fmax(value[c], 0.0f);
            above += (1.0f - clipped[c]) * light;
            below += (1.0f - clipped[c]) * rho[c];
            brightest = fmax(brightest, light / rho[c]);
        }
        const float t = (above + dark * brightest) / below;
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            const float rebuilt = fmax(fmin(t * rho[c], most), value[c]);
            value[c] += clipped[c] * (rebuilt - value[c]);
        }
    }
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) out[c * pixels + i] = value[c];
}
