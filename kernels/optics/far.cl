// WIDTH lanes of BLOCK rows of a matrix per work-item. Lanes are neighbours in memory.
#include "lanes.clh"

__kernel void product(
    // in:
    __global const float *restrict given,   // [batch * sums][size][lanes]
    __global const float *restrict values,  // [matrices][blocks][most][BLOCK]
    __global const int *restrict start, __global const int *restrict count,  // [matrices][blocks]
    // out:
    __global float *restrict out,           // [batch][rows][lanes], or [batch][lanes][rows] if turned
    // params:
    const int is_added, const int is_turned,
    // sizes:
    const int lines, const int lanes, const int size, const int rows, const int blocks, const int most,
    const int matrices, const int sums)
{
    const int lane = WIDTH * get_global_id(0), line = get_global_id(1), own_lanes = min(WIDTH, lanes - lane);
    GUARD(lane >= lanes || line >= lines)
    const int first = line % blocks * BLOCK, batch = line / blocks, own_rows = min(BLOCK, rows - first);
    real total[BLOCK];
#pragma unroll
    for (int row = 0; row < BLOCK; ++row) total[row] = 0.0f;
    for (int part = 0; part < sums; ++part) {
        const int place = batch * sums + part, own = place % matrices * blocks + line % blocks, entries = count[own];
        __global const float *weight = values + (size_t)own * most * BLOCK;
        __global const float *value = given + ((size_t)place * size + start[own]) * lanes + lane;
        for (int entry = 0; entry < entries; ++entry, value += lanes, weight += BLOCK) {
            const real light = load(value, own_lanes);
#pragma unroll
            for (int row = 0; row < BLOCK; ++row) total[row] += weight[row] * light;
        }
    }
    if (is_turned) {
        __global float *to = out + ((size_t)batch * lanes + lane) * rows + first;
        for (int i = 0; i < own_lanes; ++i)
            for (int row = 0; row < own_rows; ++row)
                to[i * rows + row] = (is_added ? to[i * rows + row] : 0.0f) + ((float *)&total[row])[i];
    } else {
        for (int row = 0; row < own_rows; ++row) {
            __global float *to = out + ((size_t)batch * rows + first + row) * lanes + lane;
            real sum = total[row];
            if (is_added) sum += load(to, own_lanes);
            STORE(float, sum, to, own_lanes)
        }
    }
}

// What every Gaussian of every channel sees of the planes.
__kernel void combine(
    // in:
    __global const float *restrict planes,   // [count][size]
    __global const float *restrict weights,  // [channels][count][sigmas]
    // out:
    __global float *restrict out,            // [channels][sigmas][size]
    // sizes:
    const int places, const int size, const int count, const int sigmas)
{
    const int at = get_global_id(0), place = get_global_id(1);
    GUARD(at >= size || place >= places)
    const int channel = place / sigmas, sigma = place % sigmas;
    float sum = 0.0f;
    for (int plane = 0; plane < count; ++plane)
        sum += weights[(channel * count + plane) * sigmas + sigma] * planes[(size_t)plane * size + at];
    out[(size_t)place * size + at] = sum;
}

// A pixel of a mosaic, or of every channel, from the splines along its row.
__kernel void refine(
    // in:
    __global const float *restrict onto, __global const float *restrict lines,  // [channels][rows][splines]
    __global const float *restrict values, __global const int *restrict start,  // [4][cols], [phases][cols]
    // out:
    __global float *restrict out,
    // sizes:
    const int rows, const int cols, const int splines, const int phases)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    __global const float *value = lines + (plane * rows + y) * splines + start[y % phases * cols + x];
    const float sum = values[x] * value[0] + values[cols + x] * value[1] + values[2 * cols + x] * value[2] +
                      values[3 * cols + x] * value[3];
    const int at = (plane * rows + y) * cols + x;
    out[at] = onto[at] + sum;
}
