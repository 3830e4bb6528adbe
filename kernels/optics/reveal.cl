__kernel void begin(
    // in:
    __global const float *restrict planes,
    // out:
    __global float *restrict out,
    // sizes:
    const int count, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    GUARD(x >= cols || y >= rows || p >= count)
    const size_t at = ((size_t)p * rows + y) * cols + x;
    out[at] = planes[at];
}

// One sample of one plane per work-item.
__kernel void reveal(
    // in:
    __global const float *restrict planes,  // [count][pixels]
    __global const int *restrict index,     // [3][samples]: replaced, shown, taken away
    __global const float *restrict factor,  // [samples]
    // out:
    __global float *restrict out,           // [count][pixels]
    // sizes:
    const int count, const int samples, const int pixels)
{
    const int k = get_global_id(0), p = get_global_id(1);
    GUARD(k >= samples || p >= count)
    __global const float *plane = planes + (size_t)p * pixels;
    const float own = plane[index[samples + k]], f = factor[k];
    out[(size_t)p * pixels + index[k]] = own + f * (own - plane[index[2 * samples + k]]);
}
