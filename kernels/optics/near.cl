// One frequency per work-item.
__kernel void near(
    // in:
    __global const float *restrict tables,    // [planes][rows][cols]
    __global const float *restrict energies,  // [planes][sigmas]
    __global const float *restrict down, __global const float *restrict across,  // [sigmas][rows], [sigmas][cols]
    // out:
    __global float *restrict out,
    // sizes:
    const int rows, const int cols, const int sigmas)
{
    const int x = get_global_id(0), y = get_global_id(1), plane = get_global_id(2);
    GUARD(x >= cols || y >= rows)
    float sum = 0.0f;
    for (int sigma = 0; sigma < sigmas; ++sigma)
        sum += energies[plane * sigmas + sigma] * down[sigma * rows + y] * across[sigma * cols + x];
    const size_t at = ((size_t)plane * rows + y) * cols + x;
    out[at] = tables[at] - sum;
}
