// One pixel per work-item writes all its planes; the table stays in cache.
__kernel void materials(
    // in:
    __global const ushort *restrict ids,
    __global const float *restrict shading,
    __global const float *restrict table,  // [planes][count]
    // out:
    __global float *restrict planes,       // [planes][rows][cols]
    // sizes:
    const int rows, const int cols, const int plane_count, const int count)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int i = y * cols + x;
    const int id = ids[i];
    const float shade = shading[i];
    for (int p = 0; p < plane_count; ++p) planes[(size_t)p * rows * cols + i] = shade * table[p * count + id];
}
