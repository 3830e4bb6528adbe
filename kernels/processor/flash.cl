// A GPU's work-item does a pixel, a CPU's a row, 8 pixels at once. From the host: RADIUS, WIDTH, CPU (0 or 1), BETTER,
// HIGHLIGHT.
#include "lanes.clh"

#define SIDE (2 * RADIUS + 1)

INLINE real positive(const real value) { return value > 0.0f ? value : (real)0.0f; }  // fmax() is slow on PoCL

INLINE real larger(const real a, const real b) { return a > b ? a : b; }

INLINE real step_(const real value)
{
    real t = positive(value);
    t = t > 1.0f ? (real)1.0f : t;
    return t * t * (3.0f - 2.0f * t);
}

INLINE real at(__global const float *restrict row, const int x, const int dx, const bool inside, const int cols)
{
#if WIDTH == 8
    if (inside) return vload8(0, row + x + dx);
    real found;
    for (int lane = 0; lane < WIDTH; ++lane) ((float *)&found)[lane] = row[clamp(x + lane + dx, 0, cols - 1)];
    return found;
#else
    return row[clamp(x + dx, 0, cols - 1)];
#endif
}

// 1 / (2 variance) / 3 of value c
INLINE real certainty(__global const float *restrict noise, const int c, const real red, const real green,
                      const real blue)
{
    const real more = noise[4 * c] * positive(red) + noise[4 * c + 1] * positive(green)
        + noise[4 * c + 2] * positive(blue);
    return 1.0f / (6.0f * (positive(more) + noise[4 * c + 3]));
}

// Means of the ambient picture, weighted by similarity in it.
INLINE void own_means(
    __global const float *restrict ambient, __global const float *restrict noise,
    __global const float *restrict spatial, real *own, const float per_reach, const int y, const int x,
    const bool inside, const int rows, const int cols)
{
    const size_t plane = (size_t)rows * cols, row = (size_t)y * cols;
    real a[3], sure[3], weight = 0.0f;
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        a[c] = at(ambient + c * plane + row, x, 0, inside, cols);
        own[c] = 0.0f;
    }
#pragma unroll
    for (int c = 0; c < 3; ++c) sure[c] = certainty(noise, c, a[0], a[1], a[2]);
    for (int dy = 0; dy < SIDE; ++dy) {
        const size_t other = (size_t)clamp(y + dy - RADIUS, 0, rows - 1) * cols;
        for (int dx = 0; dx < SIDE; ++dx) {
            real value[3], alike = 0.0f;
#pragma unroll
            for (int c = 0; c < 3; ++c) {
                value[c] = at(ambient + c * plane + other, x, dx - RADIUS, inside, cols);
                alike += (value[c] - a[c]) * (value[c] - a[c]) * sure[c];
            }
            const real root = positive(1.0f - alike * per_reach), w = spatial[dy * SIDE + dx] * root * root;
#pragma unroll
            for (int c = 0; c < 3; ++c) own[c] += w * value[c];
            weight += w;
        }
    }
#pragma unroll
    for (int c = 0; c < 3; ++c) own[c] = own[c] / weight;
}

INLINE void pixels(
    __global const float *restrict ambient, __global const float *restrict flash,
    __global const float *restrict ambient_noise, __global const float *restrict flash_noise,
    __global const float *restrict spatial, __global float *restrict out, const float full, const float per_reach,
    const int y, const int x, const bool inside, const int rows, const int cols)
{
    const size_t plane = (size_t)rows * cols, row = (size_t)y * cols;
    real f[3], sure[3], sum_a[3], sum_f[3];
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        f[c] = at(flash + c * plane + row, x, 0, inside, cols);
        sum_a[c] = sum_f[c] = 0.0f;
    }
#pragma unroll
    for (int c = 0; c < 3; ++c) sure[c] = certainty(flash_noise, c, f[0], f[1], f[2]);
    real weight = 0.0f, misfit = 0.0f, fullness = 0.0f;
    float spread = 0.0f;
    for (int dy = 0; dy < SIDE; ++dy) {
        const size_t other = (size_t)clamp(y + dy - RADIUS, 0, rows - 1) * cols;
        for (int dx = 0; dx < SIDE; ++dx) {
            const float near = spatial[dy * SIDE + dx];
            real value[3], alike = 0.0f;
#pragma unroll
            for (int c = 0; c < 3; ++c) {
                value[c] = at(flash + c * plane + other, x, dx - RADIUS, inside, cols);
                alike += (value[c] - f[c]) * (value[c] - f[c]) * sure[c];
            }
            const real root = positive(1.0f - alike * per_reach), w = near * root * root;
#pragma unroll
            for (int c = 0; c < 3; ++c) {
                sum_a[c] += w * at(ambient + c * plane + other, x, dx - RADIUS, inside, cols);
                sum_f[c] += w * value[c];
            }
            weight += w;
            misfit += w * alike;
            fullness += larger(larger(value[0], value[1]), value[2]) >= full ? (real)near : (real)0.0f;
            spread += near;
        }
    }
    real v = misfit / weight;
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        sum_a[c] = sum_a[c] / weight;
        sum_f[c] = sum_f[c] / weight;
        v -= (f[c] - sum_f[c]) * (f[c] - sum_f[c]) * sure[c];
    }
    real known_a = 0.0f, known_f = 0.0f;
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        known_a += sum_a[c] * sum_a[c] * certainty(ambient_noise, c, sum_a[0], sum_a[1], sum_a[2]);
        known_f += sum_f[c] * sum_f[c] * certainty(flash_noise, c, sum_f[0], sum_f[1], sum_f[2]);
    }
    const real share = positive(v - 0.5f) / larger(v, (real)0.5f);
    const real shadow = 1.0f - step_(known_f / larger(BETTER * known_a, (real)1e-30f) - 1.0f);
    const real mask = larger(shadow, step_(HIGHLIGHT * fullness / spread));
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        const real floor_ = sqrt(2.0f / (3.0f * sure[c]));
        sum_a[c] = sum_a[c] * (1.0f + share * (f[c] - sum_f[c]) / larger(sum_f[c], floor_));
    }
    if (ANY(mask > 0.0f)) {  // most pixels are spared the ambient picture's own means
        real own[3];
        own_means(ambient, ambient_noise, spatial, own, per_reach, y, x, inside, rows, cols);
#pragma unroll
        for (int c = 0; c < 3; ++c) sum_a[c] = (1.0f - mask) * sum_a[c] + mask * own[c];
    }
#pragma unroll
    for (int c = 0; c < 3; ++c) STORE(float, sum_a[c], out + c * plane + row + x, inside ? WIDTH : min(WIDTH, cols - x))
}

__kernel void flash(
    // in:
    __global const float *restrict ambient,        // [3][rows][cols]
    __global const float *restrict flash,          // [3][rows][cols]
    __global const float *restrict ambient_noise,  // [3][4]
    __global const float *restrict flash_noise,    // [3][4]
    __global const float *restrict spatial,        // [SIDE][SIDE]
    // out:
    __global float *restrict out,                  // [3][rows][cols]
    // params:
    const float full, const float per_reach,
    // sizes:
    const int rows, const int cols)
{
    const int y = get_global_id(1);
    if (y >= rows || get_global_id(0) >= cols) return;
    const int end = CPU ? cols : (int)get_global_id(0) + 1;
    for (int x = get_global_id(0); x < end; x += WIDTH) {
        if (x >= RADIUS && x + WIDTH + RADIUS <= cols)
            pixels(ambient, flash, ambient_noise, flash_noise, spatial, out, full, per_reach, y, x, true, rows,
                   cols);
        else
            pixels(ambient, flash, ambient_noise, flash_noise, spatial, out, full, per_reach, y, x, false, rows,
                   cols);
    }
}
