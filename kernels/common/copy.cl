// Reads and writes every element once: the ceiling that other kernels are measured against.
__kernel void copy(__global const float *restrict in, __global float *restrict out, const int count)
{
    const int i = get_global_id(0);
    GUARD(i >= count)
    out[i] = in[i];
}
