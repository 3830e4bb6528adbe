// Multiplies and adds only in registers: the limit of arithmetic. Ten chains hide an operation's latency and leave
// room for both factors among 16 registers; VECTOR is as wide as the device's registers.
#define STEP(s) s = s * a + b;
#define EACH(DO) DO(s0) DO(s1) DO(s2) DO(s3) DO(s4) DO(s5) DO(s6) DO(s7) DO(s8) DO(s9)
#define BEGIN(s) VECTOR s = (VECTOR)(first);
#define ADD(s) sum += s;

__kernel void fma_chains(
    // out:
    __global float *restrict out,  // [count][WIDTH]
    // params:
    const float a, const float b, const int steps,
    // sizes:
    const int count)
{
    const int i = get_global_id(0);
    GUARD(i >= count)
    const float first = i;
    EACH(BEGIN)
    for (int n = 0; n < steps; ++n) { EACH(STEP) }
    VECTOR sum = 0.0f;
    EACH(ADD)
    ((__global VECTOR *)out)[i] = sum;
}
