// Reads only local memory: the limit of kernels whose work-items share it. Eight sums hide the latency of a read. A row
// has SPAN elements of VECTOR; work-items read it in turn, so that no read is a constant of the loop.
#ifndef LOCAL
#define LOCAL(type, name, count) __local type name[count]
#endif
#define EACH(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#define BEGIN(k) VECTOR s##k = (VECTOR)(0.0f);
#define STEP(k) s##k += values[at + (k) * SPAN];

__kernel void local_sums(
    // out:
    __global float *restrict out,  // [groups * THREADS][WIDTH]
    // sizes:
    const int steps)
{
    LOCAL(VECTOR, values, 8 * SPAN);
    const int item = get_local_id(0);
    for (int n = item; n < 8 * SPAN; n += THREADS) values[n] = (VECTOR)(1.0f + (n & 1));
    barrier(CLK_LOCAL_MEM_FENCE);
    EACH(BEGIN)
    for (int n = 0; n < steps; ++n) {
        const int at = (item + n) & (SPAN - 1);
        EACH(STEP)
    }
    ((__global VECTOR *)out)[get_group_id(0) * THREADS + item] = s0 + s1 + s2 + s3 + s4 + s5 + s6 + s7;
}
