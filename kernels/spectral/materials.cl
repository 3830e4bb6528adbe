// One pixel per work-item writes all its planes; unrolled, neighbours then form the vector. PLANES: from the host.
__kernel void materials(
    // in:
    __global const ushort *restrict ids,
    __global const float *restrict shading,
    __global const float *restrict table,  // [PLANES][count]
    // out:
    __global float *restrict planes,       // [PLANES][pixels]
    // sizes:
    const int pixels, const int count)
{
    const size_t i = get_global_id(0);
    GUARD(i >= pixels)
    const int id = ids[i];
    const float shade = shading[i];
#pragma unroll
    for (int p = 0; p < PLANES; ++p) planes[(size_t)p * pixels + i] = shade * table[p * count + id];
}
