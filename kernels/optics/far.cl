// BLOCK rows of a matrix by SPANS x WIDTH lanes, which are neighbours in memory, per work-item. On a CPU a row's weight is
// loaded once for all lanes, and as many sums are under way as its registers hold.
#include "lanes.clh"
#define OWN (SPANS * WIDTH)

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
    const int lane = OWN * get_global_id(0), line = get_global_id(1), own_lanes = min(OWN, lanes - lane);
    if (lane >= lanes || line >= lines) return;
    const int first = line % blocks * BLOCK, batch = line / blocks, own_rows = min(BLOCK, rows - first);
    real total[SPANS][BLOCK];
#pragma unroll
    for (int span = 0; span < SPANS; ++span)
#pragma unroll
        for (int row = 0; row < BLOCK; ++row) total[span][row] = 0.0f;
    for (int part = 0; part < sums; ++part) {
        const int place = batch * sums + part, own = place % matrices * blocks + line % blocks, entries = count[own];
        __global const float *weight = values + (size_t)own * most * BLOCK;
        __global const float *value = given + ((size_t)place * size + start[own]) * lanes + lane;
        if (own_lanes == OWN)
            for (int entry = 0; entry < entries; ++entry, value += lanes, weight += BLOCK)
#pragma unroll
                for (int span = 0; span < SPANS; ++span) {
                    const real light = load(value + span * WIDTH, WIDTH);
#pragma unroll
                    for (int row = 0; row < BLOCK; ++row) total[span][row] += weight[row] * light;
                }
        else
            for (int entry = 0; entry < entries; ++entry, value += lanes, weight += BLOCK)
                for (int span = 0; span < SPANS; ++span) {
                    const real light = load(value + span * WIDTH, clamp(own_lanes - span * WIDTH, 0, WIDTH));
                    for (int row = 0; row < BLOCK; ++row) total[span][row] += weight[row] * light;
                }
    }
#pragma unroll
    for (int span = 0; span < SPANS; ++span) {
        const int here = clamp(own_lanes - span * WIDTH, 0, WIDTH);
        if (is_turned) {
            __global float *to = out + ((size_t)batch * lanes + lane + span * WIDTH) * rows + first;
#if WIDTH == 8 && BLOCK == 4
            if (here == WIDTH && own_rows == BLOCK) {
#define TURN(i, s) vstore4((is_added ? vload4(0, to + i * rows) : (float4)0.0f) + (float4)(                     \
                               total[span][0].s, total[span][1].s, total[span][2].s, total[span][3].s), 0, to + i * rows);
                TURN(0, s0) TURN(1, s1) TURN(2, s2) TURN(3, s3) TURN(4, s4) TURN(5, s5) TURN(6, s6) TURN(7, s7)
            } else
#endif
            for (int i = 0; i < here; ++i)
#pragma unroll
                for (int row = 0; row < BLOCK; ++row)
                    if (row < own_rows)
                        to[i * rows + row] = (is_added ? to[i * rows + row] : 0.0f) + ((float *)&total[span][row])[i];
        } else {
#pragma unroll
            for (int row = 0; row < BLOCK; ++row) {
                __global float *to = out + ((size_t)batch * rows + first + row) * lanes + lane + span * WIDTH;
                const int some = row < own_rows ? here : 0;
                real sum = total[span][row];
                if (is_added) sum += load(to, some);
                STORE(float, sum, to, some)
            }
        }
    }
}

// What `each` Gaussians of every channel see of the planes, one after the other while these are in a CPU's cache.
__kernel void combine(
    // in:
    __global const float *restrict planes,   // [count][size]
    __global const float *restrict weights,  // [channels][count][sigmas]
    // out:
    __global float *restrict out,            // [channels][sigmas][size]
    // params:
    const int each,
    // sizes:
    const int places, const int size, const int count, const int sigmas)
{
    const int at = WIDTH * get_global_id(0), first = each * get_global_id(1), own = min(WIDTH, size - at);
    GUARD(at >= size || first >= places)
    for (int place = first; place < min(first + each, places); ++place) {
        const int channel = place / sigmas, sigma = place % sigmas;
        real sum = 0.0f;
        for (int plane = 0; plane < count; ++plane)
            sum += weights[(channel * count + plane) * sigmas + sigma] * load(planes + (size_t)plane * size + at, own);
        STORE(float, sum, out + (size_t)place * size + at, own)
    }
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
