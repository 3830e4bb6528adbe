// A work-item sums CHUNK neighbours of one row (from the host; 1 on a GPU), one instant after the other: the inner loop
// is plain, so LLVM vectorises it, and its sums stay in the nearest cache. Pixel after pixel instead, all instants of
// one pixel would fall on the same cache lines if a picture's size is a multiple of a page.
__kernel void shutter(
    // in:
    __global const float *restrict rates,    // [instants][rows][cols]
    __global const float *restrict weights,  // [rows][instants]
    __global const int2 *restrict spans,     // [rows] first instant, one after the last
    // out:
    __global float *restrict mean,           // [rows][cols]
    // sizes:
    const int instants, const int rows, const int cols)
{
    const int y = get_global_id(1), start = get_global_id(0) * CHUNK, pixels = min(CHUNK, cols - start);
    if (y >= rows || pixels <= 0) return;
    const size_t at = (size_t)y * cols + start, picture = (size_t)rows * cols;
    const int2 span = spans[y];
    float sum[CHUNK];
    for (int i = 0; i < pixels; ++i) sum[i] = 0.0f;
    for (int k = span.x; k < span.y; ++k) {
        const float weight = weights[y * instants + k];
        __global const float *restrict from = rates + k * picture + at;
        for (int i = 0; i < pixels; ++i) sum[i] += weight * from[i];
    }
    for (int i = 0; i < pixels; ++i) mean[at + i] = sum[i];
}
