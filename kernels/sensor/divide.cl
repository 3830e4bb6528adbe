// One pixel per work-item.
__kernel void divide(
    // in:
    __global const float *restrict whole,
    __global const float *restrict parts,   // [count][rows][cols]
    __global const float *restrict shares,  // [count][high][wide]
    // out:
    __global float *restrict diodes,        // [count + 1][rows][cols]
    // sizes:
    const int count, const int rows, const int cols, const int high, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const size_t pixel = (size_t)y * cols + x, plane = (size_t)rows * cols;
    float left = whole[pixel];
    for (int k = 0; k < count; k++) {
        const float share = shares[((size_t)k * high + y % high) * wide + x % wide];
        const float own = fmin(fmax(share * parts[k * plane + pixel], 0.0f), left);
        diodes[k * plane + pixel] = own;
        left -= own;
    }
    diodes[count * plane + pixel] = left;
}
