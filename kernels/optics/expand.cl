// One pixel of one term or channel per work-item; memory-bound. The recurrence is unrolled, without branches.

float chebyshev(const int degree, const float x)  // degree 1 or more
{
    float before = 1.0f, now = x, found = x;
#pragma unroll
    for (int n = 2; n <= 12; ++n) {
        const float next = 2.0f * x * now - before;
        before = now;
        now = next;
        found = n == degree ? next : found;
    }
    return found;
}

// Circle of confusion of a pixel, which its coverage multiplies.
float circle(const float cover, const float weighted, const float low, const float high)
{
    const int there = fabs(cover) > 1e-6f;
    return clamp(low + (there ? weighted : 0.0f) / (there ? cover : 1.0f), low, high);
}

__kernel void terms(
    // in:
    __global const float *restrict cover,     // [2][rows][cols]
    __global const int *restrict tile_y, __global const int *restrict tile_x,
    __global const float *restrict term_y, __global const float *restrict term_x,  // [count][rows], [count][cols]
    __global const float *restrict spans,     // [tiles][2]
    __global const int *restrict degrees,     // [count], of the circle
    // out:
    __global float *restrict out,             // [count ...][rows][cols]
    // params:
    const float low, const float high,
    // sizes:
    const int count, const int rows, const int cols, const int tiles_x)
{
    const int x = get_global_id(0), y = get_global_id(1), k = get_global_id(2);
    GUARD(x >= cols || y >= rows || k >= count)
    const size_t frame = (size_t)rows * cols, at = (size_t)y * cols + x;
    const int tile = tile_y[y] * tiles_x + tile_x[x], degree = degrees[k];
    float value = term_y[k * rows + y] * term_x[k * cols + x];
    if (degree > 0) {
        const float away = circle(cover[at], cover[frame + at], low, high) - spans[2 * tile];
        const float part = clamp(away * spans[2 * tile + 1], -1.0f, 1.0f);
        value *= degree > 1 ? chebyshev(degree, part) : part;
    }
    out[k * frame + at] = value;
}

__kernel void gains(
    // in:
    __global const float *restrict cover,     // [2][rows][cols]
    __global const int *restrict tile_y, __global const int *restrict tile_x,
    __global const float *restrict along_y, __global const float *restrict along_x,
    __global const float *restrict spans,     // [tiles][2]
    __global const float4 *restrict even,     // [channels][tiles]
    // out:
    __global float *restrict out,             // [terms_ + channels][rows][cols]
    // params:
    const float low, const float high,
    // sizes:
    const int terms_, const int channels, const int rows, const int cols, const int tiles_x, const int tiles)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    GUARD(x >= cols || y >= rows || c >= channels)
    const size_t frame = (size_t)rows * cols, at = (size_t)y * cols + x;
    const int tile = tile_y[y] * tiles_x + tile_x[x];
    const float away = circle(cover[at], cover[frame + at], low, high) - spans[2 * tile];
    const float4 e = even[c * tiles + tile];
    out[(terms_ + c) * frame + at] =
        1.0f / (1.0f + e.x + e.y * along_y[y] + e.z * along_x[x] + e.w * clamp(away, -2.0f, 2.0f));
}
