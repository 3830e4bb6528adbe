// Stockham transforms in global memory, one radix per pass; lines along either axis, neighbours in memory together.

__kernel void stockham(
    // in:
    __global const float2 *restrict in, __global const float2 *restrict roots,
    // out:
    __global float2 *restrict out,
    // params:
    const int radix, const int done, const int length, const int step, const int line_step, const int axis,
    // sizes:
    const int planes, const int size_y, const int size_x, const int plane_size)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= size_x || y >= size_y || plane >= planes)
    const int i = axis == 0 ? y : x, line = axis == 0 ? x : y;
    const size_t base = (size_t)plane * plane_size + (size_t)line * line_step;
    const int apart = length / radix, k = i % done, first = (i - k) * radix + k, stride = apart / done;
    for (int m = 0; m < radix; ++m) {
        const int turn = (k + m * done) * stride;  // roots per input: below length
        float2 sum = in[base + (size_t)i * step];
        for (int n = 1, at = 0; n < radix; ++n) {
            at += turn;
            if (at >= length) at -= length;
            const float2 w = roots[at], v = in[base + (size_t)(i + n * apart) * step];
            sum += (float2)(w.x * v.x - w.y * v.y, w.x * v.y + w.y * v.x);
        }
        out[base + (size_t)(first + m * done) * step] = sum;
    }
}

__kernel void complex_from_real(
    // in:
    __global const float *restrict in,
    // out:
    __global float2 *restrict out,
    // sizes:
    const int planes, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= cols || y >= rows || plane >= planes)
    const size_t i = ((size_t)plane * rows + y) * cols + x;
    out[i] = (float2)(in[i], 0.0f);
}

// Second half of each row from the first: after the inverse along y every row is the half spectrum of a real row.
__kernel void mirror(__global float2 *data, const int planes, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= cols || y >= rows || plane >= planes)
    if (x <= cols / 2) return;
    const size_t row = ((size_t)plane * rows + y) * cols;
    const float2 v = data[row + cols - x];
    data[row + x] = (float2)(v.x, -v.y);
}

__kernel void real_from_complex(
    // in:
    __global const float2 *restrict in,
    // out:
    __global float *restrict out,
    // params:
    const float scale,
    // sizes:
    const int planes, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= cols || y >= rows || plane >= planes)
    const size_t i = ((size_t)plane * rows + y) * cols + x;
    out[i] = scale * in[i].x;
}
