// Planes and their half spectra: every line is read once and written once. The kernels of one program: LENGTH of the
// transform, LINES of a work-group, THREADS in it, BORDER and PASSES, a list of PASS(...), come from the host.
// Columns are transformed in place: a pass also orders what was read from global memory before it is written.
#define FENCE (CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE)
#include "border.clh"
#include "fft.clh"

float2 of_two_rows(__global const float *restrict a, __global const float *restrict b, const int x)
{
    return IS_DARK(x) ? PAIR(0.0f, 0.0f) : PAIR(a[x], b[x]);
}

float2 of_two_spectra(__global const float2 *restrict a, __global const float2 *restrict b, const int x)
{
    const int is_mirrored = x > LENGTH / 2, from = is_mirrored ? LENGTH - x : x;
    return is_mirrored ? conjugate(a[from]) + turned(conjugate(b[from]), 1.0f) : a[from] + turned(b[from], 1.0f);
}

float2 of_column(__global const float2 *restrict spectra, const int pitch, const int y)
{
    return IS_DARK(y) ? PAIR(0.0f, 0.0f) : spectra[y * pitch];
}

// Real rows to half spectra, two rows as the real and imaginary part of one line. Pixels left and right of the frame
// are filled in according to BORDER.
__kernel void rows_forward(
    // in:
    __global const float *restrict planes,   // [][cols], all planes' rows one after the other
    __global const float2 *restrict roots,   // [LENGTH]
    // out:
    __global float2 *restrict spectra,       // [rows][pitch]
    // params:
    const int first_row, const int before,
    // sizes:
    const int rows, const int cols, const int pitch)
{
    LOCAL(float2, line, ROOM(LENGTH));
    const int item = get_local_id(0), first = 2 * get_group_id(0), second = first + 1 < rows ? first + 1 : first;
    __global const float *a = planes + (size_t)(first_row + first) * cols;
    __global const float *b = planes + (size_t)(first_row + second) * cols;
#define SIDE_BY_SIDE 0
#define LOAD(l, e) of_two_rows(a, b, inside_of((e) - before, cols))
    PASSES
#undef SIDE_BY_SIDE
#undef LOAD
    for (int x = item; x <= LENGTH / 2; x += THREADS) {
        const float2 p = line[AT(LENGTH, x)], q = conjugate(line[AT(LENGTH, x == 0 ? 0 : LENGTH - x)]);
        spectra[(size_t)first * pitch + x] = (p + q) * 0.5f;
        if (second > first) spectra[(size_t)second * pitch + x] = turned(p - q, -0.5f);
    }
}

// Half spectra to real rows, the same way back.
__kernel void rows_inverse(
    // in:
    __global const float2 *restrict spectra, __global const float2 *restrict roots,
    // out:
    __global float *restrict planes,
    // params:
    const float scale,
    // sizes:
    const int rows, const int pitch)
{
    LOCAL(float2, line, ROOM(LENGTH));
    const int item = get_local_id(0), first = 2 * get_group_id(0), second = first + 1 < rows ? first + 1 : first;
    __global const float2 *a = spectra + (size_t)first * pitch, *b = spectra + (size_t)second * pitch;
#define SIDE_BY_SIDE 0
#define LOAD(l, e) of_two_spectra(a, b, e)
    PASSES
#undef SIDE_BY_SIDE
#undef LOAD
    for (int x = item; x < LENGTH; x += THREADS) {
        planes[(size_t)first * LENGTH + x] = line[AT(LENGTH, x)].x * scale;
        if (second > first) planes[(size_t)second * LENGTH + x] = line[AT(LENGTH, x)].y * scale;
    }
}

// Columns of half spectra, LINES neighbours at a time: values that are read and written together are adjacent. Rows
// above and below the frame are filled in according to BORDER. In place if there are none.
__kernel void columns(
    // in:
    __global const float2 *spectra,          // [planes][rows][pitch]
    __global const float2 *restrict roots,   // [LENGTH]
    // out:
    __global float2 *out,                    // [planes][LENGTH][pitch]
    // params:
    const int before,
    // sizes:
    const int rows, const int pitch, const int groups)
{
    LOCAL(float2, line, LINES * ROOM(LENGTH));
    const int item = get_local_id(0), plane = get_group_id(0) / groups, left = get_group_id(0) % groups * LINES;
    __global const float2 *from = spectra + (size_t)plane * rows * pitch + left;
    __global float2 *to = out + (size_t)plane * LENGTH * pitch + left;
#define SIDE_BY_SIDE 1
#define LOAD(l, e) of_column(from + l, pitch, inside_of((e) - before, rows))
    PASSES
#undef SIDE_BY_SIDE
#undef LOAD
    for (int j = item; j < LINES * LENGTH; j += THREADS) {
        const int x = j % LINES, y = j / LINES;
        to[(size_t)y * pitch + x] = line[x * ROOM(LENGTH) + AT(LENGTH, y)];
    }
}
