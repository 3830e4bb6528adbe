// A work-item does `run` pixels by fours, four on GPUs, and single ones at the very end.
#include "codes.clh"

__kernel void encode(
    // in:
    __global const float *restrict rgb,     // [3][pixels]
    __global const uint *restrict entries,  // of the table
    // out:
    __global uchar *restrict out,           // [pixels][3]
    // params:
    const float bottom, const float top, const int shift,
    // sizes:
    const int run, const int pixels)
{
    const Codes table = {entries, bottom, top, shift};
    __global const float *red = rgb, *green = rgb + pixels, *blue = rgb + 2L * pixels;
    long i = (long)get_global_id(0) * run;
    const long end = min(i + run, (long)pixels);
    for (; i + 4 <= end; i += 4)
        store_codes(codes(table, LOAD4(red + i)), codes(table, LOAD4(green + i)), codes(table, LOAD4(blue + i)),
                    out + 3 * i);
    for (; i < end; ++i) {
        out[3 * i] = code(table, red[i]);
        out[3 * i + 1] = code(table, green[i]);
        out[3 * i + 2] = code(table, blue[i]);
    }
}
