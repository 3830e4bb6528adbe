// Convolution in float64, vertically by transforms of LENGTH rows (overlap-save), horizontally term by term: every
// transform is of eight columns in one vector, nothing is transposed, and all of it stays in a core's cache.
// Two parts of a strip, WIDTH columns apart, are the real and the imaginary parts of one complex signal: the kernel is
// real, so that they stay apart.

// y = transform of x or, with real and imaginary parts exchanged, its inverse times LENGTH. Both are overwritten; the
// result is in x when the number of passes is even. Stockham: radix 4, and one of 2 where LENGTH asks for it.
void transform(double8 *xr, double8 *xi, double8 *yr, double8 *yi, __global const double2 *roots)
{
    int s = 1;
    for (int n = LENGTH; n > 1; n /= 4, s *= 4) {
        if (n == 2) {
            for (int q = 0; q < s; ++q) {
                yr[q] = xr[q] + xr[q + s]; yi[q] = xi[q] + xi[q + s];
                yr[q + s] = xr[q] - xr[q + s]; yi[q + s] = xi[q] - xi[q + s];
            }
        } else {
            const int m = n / 4;
            for (int p = 0; p < m; ++p) {
                const double2 w1 = roots[p * s], w2 = roots[2 * p * s], w3 = roots[3 * p * s];
                for (int q = 0; q < s; ++q) {
                    const int a = q + s * p, b = a + s * m, c = b + s * m, d = c + s * m, o = q + s * 4 * p;
                    const double8 pr = xr[a] + xr[c], pi = xi[a] + xi[c], mr = xr[a] - xr[c], mi = xi[a] - xi[c];
                    const double8 tr = xr[b] + xr[d], ti = xi[b] + xi[d], ur = xi[d] - xi[b], ui = xr[b] - xr[d];
                    const double8 er = mr - ur, ei = mi - ui, fr = pr - tr, fi = pi - ti, gr = mr + ur, gi = mi + ui;
                    yr[o] = pr + tr; yi[o] = pi + ti;
                    yr[o + s] = w1.x * er - w1.y * ei; yi[o + s] = w1.x * ei + w1.y * er;
                    yr[o + 2 * s] = w2.x * fr - w2.y * fi; yi[o + 2 * s] = w2.x * fi + w2.y * fr;
                    yr[o + 3 * s] = w3.x * gr - w3.y * gi; yi[o + 3 * s] = w3.x * gi + w3.y * gr;
                }
            }
        }
        double8 *t = xr; xr = yr; yr = t;
        t = xi; xi = yi; yi = t;
    }
}

__kernel void columns(
    // in:
    __global const float *restrict extended,   // [count][period_y][period_x]
    __global const double2 *restrict kernels,  // [1 or count][LENGTH][taps_x]
    __global const double2 *restrict roots,    // [LENGTH]
    // out:
    __global double *restrict scratch,         // [strips][parts][2][LENGTH][PITCH]
    __global float *restrict out,              // [count][rows][cols]
    // params:
    const int k, const int own, const int valid, const int width, const int border,
    // sizes:
    const int parts, const int taps_x, const int rows, const int cols, const int period_y, const int period_x)
{
    const int part = get_global_id(0), strip = get_global_id(1), left = part * 2 * width;
    __global const float *source = extended + ((size_t)k * period_y + strip * valid) * period_x + left;
    __global const double2 *transfer = kernels + (size_t)(own * k) * LENGTH * taps_x;
    __global double *re = scratch + (size_t)(strip * parts + part) * 2 * LENGTH * PITCH, *im = re + LENGTH * PITCH;
    double8 buffers[4][LENGTH];
    double8 *xr = buffers[0], *xi = buffers[1], *yr = buffers[2], *yi = buffers[3];
    double8 *zr = ODD ? yr : xr, *zi = ODD ? yi : xi;
    int ready = 0;  // columns transformed; `border` of them are kept from one block to the next
    for (int x = 0; x < width; x += AHEAD) {
        for (; ready < x + AHEAD + border; ready += 8) {
            for (int f = 0; f < LENGTH; ++f) {
                xr[f] = convert_double8(vload8(0, source + (size_t)f * period_x + ready));
                xi[f] = convert_double8(vload8(0, source + (size_t)f * period_x + ready + width));
            }
            transform(xr, xi, yr, yi, roots);
            for (int f = 0; f < LENGTH; ++f) {
                vstore8(zr[f], 0, re + f * PITCH + ready - x);
                vstore8(zi[f], 0, im + f * PITCH + ready - x);
            }
        }
        for (int f = 0; f < LENGTH; ++f) {
            for (int b = 0; b < AHEAD; b += 32) {
                __global double *row_re = re + f * PITCH + b, *row_im = im + f * PITCH + b;
                __global const double2 *factor = transfer + f * taps_x;
                double8 sr[4], si[4];
#pragma unroll
                for (int i = 0; i < 4; ++i) sr[i] = si[i] = 0;
                for (int j = 0; j < taps_x; ++j) {
                    const double2 h = factor[j];
#pragma unroll
                    for (int i = 0; i < 4; ++i) {
                        const double8 vr = vload8(i, row_re + j), vi = vload8(i, row_im + j);
                        sr[i] += h.x * vr; sr[i] -= h.y * vi;
                        si[i] += h.x * vi; si[i] += h.y * vr;
                    }
                }
#pragma unroll
                for (int i = 0; i < 4; ++i) { vstore8(sr[i], i, row_re); vstore8(si[i], i, row_im); }
            }
        }
        for (int b = 0; b < AHEAD; b += 8) {
            for (int f = 0; f < LENGTH; ++f) {
                xr[f] = vload8(0, re + f * PITCH + b);
                xi[f] = vload8(0, im + f * PITCH + b);
            }
            transform(xi, xr, yi, yr, roots);
            for (int f = 0; f < valid && strip * valid + f < rows; ++f) {
                __global float *target = out + ((size_t)k * rows + strip * valid + f) * cols;
                float8 pair[2];
                pair[0] = convert_float8(zr[f]); pair[1] = convert_float8(zi[f]);
                for (int h = 0; h < 2; ++h) {
                    const int at = left + h * width + x + b;
                    if (x + b + 8 <= width && at + 8 <= cols) vstore8(pair[h], 0, target + at);
                    else {
                        float last[8];
                        vstore8(pair[h], 0, last);
                        for (int i = 0; x + b + i < width && at + i < cols; ++i) target[at + i] = last[i];
                    }
                }
            }
        }
        for (int f = 0; f < LENGTH; ++f)
            for (int i = 0; i < border; i += 8) {
                vstore8(vload8(0, re + f * PITCH + AHEAD + i), 0, re + f * PITCH + i);
                vstore8(vload8(0, im + f * PITCH + AHEAD + i), 0, im + f * PITCH + i);
            }
    }
}
