// Every list of taps belongs to a row phase and a channel and gives an offset and a weight for each column phase.
// A GPU's work-item makes a pixel. A CPU's makes a row: all column phases share a list's offset, and BLOCK neighbours
// are a few vectors, multiplied with the weights of their phases. Most of these are 0; it is still many times faster
// than single pixels. Columns are 64-bit: see bayer.clh.
inline float pixel(
    __global const ushort *restrict raw, __global const int *restrict starts, __global const int2 *restrict offsets,
    __global const float *restrict weights, const long y, const long x, const int list, const int phase,
    const bool inside, const int period_x, const int stride, const int rows, const int cols)
{
    float sum = 0.0f, total = 0.0f;
    for (int k = starts[list]; k < starts[list + 1]; ++k) {
        const float weight = weights[(long)k * stride + phase];
        const int2 offset = offsets[(long)k * period_x + phase];
        const long v = y + offset.x, u = x + offset.y;
        if (inside || (v >= 0 && v < rows && u >= 0 && u < cols)) {
            sum += weight * (float)raw[v * cols + u];
            total += weight;
        }
    }
    return inside ? sum : sum / total;
}

#if BLOCK == 32
// BLOCK pixels from x on, whose windows are inside the frame's columns.
inline void block(
    __global const ushort *restrict raw, __global const int *restrict starts, __global const int2 *restrict offsets,
    __global const float *restrict weights, __global float *restrict out, const float black_level, const float scale,
    const long y, const long x, const int list, const int phase, const bool inside, const int period_x,
    const int stride, const int rows, const int cols)
{
    float8 a = 0.0f, b = 0.0f, c = 0.0f, d = 0.0f;
    const int begin = starts[list], end = starts[list + 1];
    for (int k = begin; k < end; ++k) {
        const int2 offset = offsets[(long)k * period_x];
        if (!inside && (y + offset.x < 0 || y + offset.x >= rows)) continue;
        __global const float *weight = weights + (long)k * stride + phase;
        __global const ushort *samples = raw + (y + offset.x) * cols + x + offset.y;
        a += convert_float8(vload8(0, samples)) * vload8(0, weight);
        b += convert_float8(vload8(1, samples)) * vload8(1, weight);
        c += convert_float8(vload8(2, samples)) * vload8(2, weight);
        d += convert_float8(vload8(3, samples)) * vload8(3, weight);
    }
    if (!inside) {
        float8 ta = 0.0f, tb = 0.0f, tc = 0.0f, td = 0.0f;
        for (int k = begin; k < end; ++k) {
            const long v = y + offsets[(long)k * period_x].x;
            if (v < 0 || v >= rows) continue;
            __global const float *weight = weights + (long)k * stride + phase;
            ta += vload8(0, weight);
            tb += vload8(1, weight);
            tc += vload8(2, weight);
            td += vload8(3, weight);
        }
        a /= ta;
        b /= tb;
        c /= tc;
        d /= td;
    }
    vstore8((a - black_level) * scale, 0, out);
    vstore8((b - black_level) * scale, 1, out);
    vstore8((c - black_level) * scale, 2, out);
    vstore8((d - black_level) * scale, 3, out);
}
#endif

__kernel void interpolate(
    // in:
    __global const ushort *restrict raw,    // [rows][cols]
    __global const int *restrict starts,    // [period_y CHANNELS + 1]
    __global const int2 *restrict offsets,  // [N][period_x] rows, columns
    __global const float *restrict weights, // [N][stride]
    // out:
    __global float *restrict out,           // [CHANNELS][rows][cols]
    // params:
    const float black_level, const float scale, const int reach_y, const int reach_x,
    // sizes:
    const int period_y, const int period_x, const int stride, const int rows, const int cols)
{
    const long y = get_global_id(1);
    const bool inside = y >= reach_y && y < rows - reach_y;
    const int list = (int)(y % period_y) * CHANNELS;
    const long pixels = (long)rows * cols;
    out += y * cols;
#if BLOCK == 1
    const long x = get_global_id(0);
    GUARD(y >= rows || x >= cols)
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c)
        out[c * pixels + x] = (pixel(raw, starts, offsets, weights, y, x, list + c, x % period_x,
                                     inside && x >= reach_x && x < cols - reach_x, period_x, stride, rows, cols)
                               - black_level) * scale;
#else
    const long end = cols - reach_x;  // of the columns whose windows are inside
    const bool wide = end - reach_x >= BLOCK;
    for (int c = 0; c < CHANNELS; ++c) {
        __global float *plane = out + c * pixels;
        for (long i = 0; i < (wide ? 2 * reach_x : cols); ++i) {
            const long x = wide && i >= reach_x ? cols - 1 - (i - reach_x) : i;
            plane[x] = (pixel(raw, starts, offsets, weights, y, x, list + c, x % period_x, false, period_x, stride,
                              rows, cols) - black_level) * scale;
        }
        if (!wide) continue;
        for (long x = reach_x; x < end; x += BLOCK) {
            const long from = min(x, end - BLOCK);  // the last overlaps the one before it
            block(raw, starts, offsets, weights, plane + from, black_level, scale, y, from, list + c, from % period_x,
                  inside, period_x, stride, rows, cols);
        }
    }
#endif
}
