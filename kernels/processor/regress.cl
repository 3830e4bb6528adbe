// Three passes: `survey` makes a guide with round kernels, `shape` a kernel for each pixel from the guide, `regress` the
// planes. One pixel per work-item.
// From the host: CHANNELS, TILE, PERIOD_Y, PERIOD_X, and the constants of regress.py.
#pragma OPENCL FP_CONTRACT OFF
#include "tiles.clh"

#define TERMS 5  // dy, dx, dy^2 / 2, dy dx, dx^2 / 2

inline float squared(const float x) { return x * x; }

// Where a frame shows a place of the reference [pixel], rows first.
inline float2 place_in(__global const float *restrict displacement, const int i, const int reference, const float y,
                       const float x, const int tiles_y, const int tiles_x)
{
    const float2 here = (float2)(y, x);
    if (i == reference) return here;
    return clamp(here + displacement_at(displacement + 2 * (size_t)i * tiles_y * tiles_x, y, x, tiles_y, tiles_x),
                 -1e6f, 1e6f);
}

// Fits one value per channel, with its weight behind, and slopes and bends common to all. ellipse: inverse covariance (yy, yx, xx) of the
// kernel; span: its reach in rows and columns. Returns the weight of all samples in units of the inverse variance.
inline float fit(
    __global const ushort *restrict raw, __global const float *restrict displacement,
    __global const float *restrict trusted, __global const float *restrict table, __global const int *restrict cfa,
    __global const float *restrict balance, float *found, const float3 ellipse, const float2 span, const float level,
    const float y, const float x, const int reference, const int tiles_y, const int tiles_x, const int rows,
    const int cols, const int h, const int w, const int frames)
{
    float count[CHANNELS], sum[CHANNELS], middle[CHANNELS][TERMS], matrix[TERMS][TERMS], right[TERMS];
    for (int c = 0; c < CHANNELS; ++c) {
        count[c] = sum[c] = 0.0f;
        for (int k = 0; k < TERMS; ++k) middle[c][k] = 0.0f;
    }
    for (int k = 0; k < TERMS; ++k) {
        right[k] = 0.0f;
        for (int l = 0; l <= k; ++l) matrix[k][l] = 0.0f;
    }
    float all = 0.0f;
    const int block_y = clamp((int)floor(y + 0.5f), 0, rows - 1) / PERIOD_Y;
    const int block_x = clamp((int)floor(x + 0.5f), 0, cols - 1) / PERIOD_X;
    for (int i = 0; i < frames; ++i) {
        const float share = trusted[((size_t)i * h + block_y) * w + block_x];
        if (!(share > 0.0f)) continue;
        const float2 at = place_in(displacement, i, reference, y, x, tiles_y, tiles_x);
        const float dark = table[i], scale = table[frames + i], full = table[4 * frames + i];
        float weights[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c) {
            const float b = balance[c];
            weights[c] = share / (b * (table[2 * frames + i] * level + b * table[3 * frames + i]));
        }
        const int top = max((int)ceil(at.x - span.x), 0), bottom = min((int)floor(at.x + span.x), rows - 1);
        const int left = max((int)ceil(at.y - span.y), 0), last = min((int)floor(at.y + span.y), cols - 1);
        for (int v = top; v <= bottom; ++v)
            for (int u = left; u <= last; ++u) {
                const float dy = v - at.x, dx = u - at.y;
                const float e = ellipse.x * dy * dy + 2.0f * ellipse.y * dy * dx + ellipse.z * dx * dx;
                const float d = (dy * dy + dx * dx) * (1.0f / (WIDE * WIDE));
                const float kernel_ = squared(squared(fmax(1.0f - e * (1.0f / CUT), 0.0f)));
                const float near_ = kernel_ + PEDESTAL * squared(fmax(1.0f - d, 0.0f));
                const float number = raw[((size_t)i * rows + v) * cols + u];
                if (!(near_ > 0.0f) || number >= full) continue;
                const int c = cfa[v % PERIOD_Y * PERIOD_X + u % PERIOD_X];
                const float weight = near_ * weights[c], value = (number - dark) * scale * balance[c];
                const float terms[TERMS] = {dy, dx, 0.5f * dy * dy, dy * dx, 0.5f * dx * dx};
                all += kernel_ * weights[c];
                count[c] += weight;
                sum[c] += weight * value;
                for (int k = 0; k < TERMS; ++k) {
                    const float part = weight * terms[k];
                    middle[c][k] += part;
                    right[k] += part * value;
                    for (int l = 0; l <= k; ++l) matrix[k][l] += part * terms[l];
                }
            }
    }
    for (int k = 0; k < TERMS; ++k) {
        const float own = matrix[k][k];
        for (int c = 0; c < CHANNELS; ++c)
            if (count[c] > 0.0f) {
                const float mean = middle[c][k] / count[c];
                right[k] -= mean * sum[c];
                for (int l = 0; l <= k; ++l) matrix[k][l] -= mean * middle[c][l];
            }
        matrix[k][k] += ROUNDING * own + (k < 2 ? SLOPE : BEND);
    }
    for (int k = 0; k < TERMS; ++k) {  // Cholesky, and forward substitution
        for (int l = 0; l <= k; ++l) {
            float left = matrix[k][l];
            for (int j = 0; j < l; ++j) left -= matrix[k][j] * matrix[l][j];
            matrix[k][l] = l < k ? left / matrix[l][l] : sqrt(fmax(left, SLOPE));
        }
        for (int j = 0; j < k; ++j) right[k] -= matrix[k][j] * right[j];
        right[k] /= matrix[k][k];
    }
    for (int k = TERMS - 1; k >= 0; --k) {
        for (int j = k + 1; j < TERMS; ++j) right[k] -= matrix[j][k] * right[j];
        right[k] /= matrix[k][k];
    }
    for (int c = 0; c < CHANNELS; ++c) {
        float left = sum[c];
        for (int k = 0; k < TERMS; ++k) left -= middle[c][k] * right[k];
        found[c] = count[c] > 0.0f ? left / count[c] : level;
        found[CHANNELS + c] = count[c];
    }
    return all;
}

// The mean of balanced values with the weights of white's light in them.
inline float luminance_of(const float *values, __global const float *restrict balance)
{
    float sum = 0.0f, total = 0.0f;
    for (int c = 0; c < CHANNELS; ++c) {
        sum += values[c] / balance[c];
        total += 1.0f / balance[c];
    }
    return sum / total;
}

__kernel void survey(
    // in:
    __global const ushort *restrict raw,          // [frames][rows][cols]
    __global const float *restrict displacement,  // [frames][tiles_y][tiles_x][2]
    __global const float *restrict trusted,       // [frames][h][w]
    __global const float *restrict table,         // [5][frames] dark, scale, shot, floor, full
    __global const int *restrict cfa,             // [PERIOD_Y][PERIOD_X]
    __global const float *restrict balance,       // [CHANNELS]
    // out:
    __global float *restrict guide,               // [2 + 2 CHANNELS][rows][cols] luminance, variance, tints, weights
    // params:
    const int reference, const float variance,
    // sizes:
    const int tiles_y, const int tiles_x, const int rows, const int cols, const int h, const int w, const int frames)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    // the mean of the nearest samples; a frame counts as its photons do
    float level = 0.0f, weight = 0.0f;
    for (int i = 0; i < frames; ++i) {
        const float share = trusted[((size_t)i * h + y / PERIOD_Y) * w + x / PERIOD_X];
        if (!(share > 0.0f)) continue;
        const float2 at = place_in(displacement, i, reference, y, x, tiles_y, tiles_x);
        const int v = floor(at.x + 0.5f), u = floor(at.y + 0.5f);
        const float own = share / (table[2 * frames + i] + table[3 * frames + i]);
        for (int j = max(v - NEAR, 0); j <= min(v + NEAR, rows - 1); ++j)
            for (int k = max(u - NEAR, 0); k <= min(u + NEAR, cols - 1); ++k) {
                const float b = balance[cfa[j % PERIOD_Y * PERIOD_X + k % PERIOD_X]];
                level += own * ((float)raw[((size_t)i * rows + j) * cols + k] - table[i]) * table[frames + i];
                weight += own / b;
            }
    }
    level = weight > 0.0f ? fmax(level / weight, 0.0f) : 0.0f;
    float found[2 * CHANNELS];
    const float inverse = 1.0f / (ROUND * ROUND), reach = fmax(WIDE, sqrt(CUT) * ROUND);
    const float all = fit(raw, displacement, trusted, table, cfa, balance, found, (float3)(inverse, 0.0f, inverse),
                          (float2)(reach), level, y, x, reference, tiles_y, tiles_x, rows, cols, h, w,
                          frames);
    const float luminance = luminance_of(found, balance);
    const size_t at = (size_t)y * cols + x, plane = (size_t)rows * cols;
    guide[at] = luminance;
    guide[plane + at] = variance / fmax(all, 1e-20f);
    for (int c = 0; c < CHANNELS; ++c) {
        guide[(2 + c) * plane + at] = found[c] - luminance;
        guide[(2 + CHANNELS + c) * plane + at] = found[CHANNELS + c];
    }
}

__kernel void shape(
    // in:
    __global const float *restrict guide,  // [2 + 2 CHANNELS][rows][cols]
    // out:
    __global float *restrict ellipses,     // [3][rows][cols] inverse covariance: yy, yx, xx
    __global float *restrict tints,        // [2][CHANNELS][rows][cols] means, variances
    // sizes:
    const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    float yy = 0.0f, yx = 0.0f, xx = 0.0f, total = 0.0f;
    float mean[CHANNELS], square[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) mean[c] = square[c] = 0.0f;
    for (int j = -3; j <= 3; ++j)
        for (int k = -3; k <= 3; ++k) {
            const int v = clamp(y + j, 0, rows - 1), u = clamp(x + k, 0, cols - 1);
            const float share = squared(squared(1.0f - (j * j + k * k) / 20.0f));
            const float dy = 0.5f * (guide[(size_t)min(v + 1, rows - 1) * cols + u]
                                     - guide[(size_t)max(v - 1, 0) * cols + u]);
            const float dx = 0.5f * (guide[(size_t)v * cols + min(u + 1, cols - 1)]
                                     - guide[(size_t)v * cols + max(u - 1, 0)]);
            yy += share * dy * dy;
            yx += share * dy * dx;
            xx += share * dx * dx;
            total += share;
            for (int c = 0; c < CHANNELS; ++c) {
                const float tint = guide[((size_t)(2 + c) * rows + v) * cols + u];
                mean[c] += share * tint;
                square[c] += share * tint * tint;
            }
        }
    yy /= total;
    yx /= total;
    xx /= total;
    const float variance = guide[((size_t)rows + y) * cols + x];
    const float half_ = 0.5f * (yy + xx), apart = 0.5f * (yy - xx), length_ = sqrt(apart * apart + yx * yx);
    const float least = 1e-6f * variance;
    const float across = fmax(half_ + length_ - NOISE * variance, least);
    const float along = fmax(half_ - length_ - NOISE * variance, least);
    const float a = 1.0f / squared(clamp(WIDTH_ * sqrt(sqrt(variance / across)), NARROWEST, WIDEST));
    const float b = 1.0f / squared(clamp(WIDTH_ * sqrt(sqrt(variance / along)), NARROWEST, WIDEST));
    // (1 + cos 2t) / 2 etc. of the direction t in which the guide changes most
    const float cosine = length_ > 0.0f ? apart / length_ : 0.0f, sine = length_ > 0.0f ? yx / length_ : 0.0f;
    const size_t at = (size_t)y * cols + x, plane = (size_t)rows * cols;
    ellipses[at] = 0.5f * (a + b + (a - b) * cosine);
    ellipses[plane + at] = 0.5f * (a - b) * sine;
    ellipses[2 * plane + at] = 0.5f * (a + b - (a - b) * cosine);
    for (int c = 0; c < CHANNELS; ++c) {
        const float middle = mean[c] / total, own = guide[(2 + CHANNELS + c) * plane + at];
        const float noise = own > 0.0f ? TINT / own : 0.0f;
        tints[c * plane + at] = middle;
        tints[(CHANNELS + c) * plane + at] = fmax(square[c] / total - middle * middle - noise, 0.0f);
    }
}

__kernel void regress(
    // in:
    __global const ushort *restrict raw,          // [frames][rows][cols]
    __global const float *restrict displacement,  // [frames][tiles_y][tiles_x][2]
    __global const float *restrict trusted,       // [frames][h][w]
    __global const float *restrict table,         // [5][frames]
    __global const int *restrict cfa,             // [PERIOD_Y][PERIOD_X]
    __global const float *restrict balance,       // [CHANNELS]
    __global const float *restrict guide,         // [2 + 2 CHANNELS][rows][cols]
    __global const float *restrict ellipses,      // [3][rows][cols]
    __global const float *restrict tints,         // [2][CHANNELS][rows][cols]
    // out:
    __global float *restrict out,                 // [CHANNELS][high][wide]
    // params:
    const int reference, const float step,
    // sizes:
    const int tiles_y, const int tiles_x, const int rows, const int cols, const int h, const int w, const int high,
    const int wide, const int frames)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= wide || y >= high)
    const float v = (y + 0.5f) * step - 0.5f, u = (x + 0.5f) * step - 0.5f;
    const size_t at = (size_t)clamp((int)floor(v + 0.5f), 0, rows - 1) * cols + clamp((int)floor(u + 0.5f), 0, cols - 1);
    const size_t plane = (size_t)rows * cols;
    const float3 ellipse = (float3)(ellipses[at], ellipses[plane + at], ellipses[2 * plane + at]);
    const float determinant = ellipse.x * ellipse.z - ellipse.y * ellipse.y;
    const float2 span = (float2)(fmax(sqrt(CUT * ellipse.z / determinant), WIDE),
                                 fmax(sqrt(CUT * ellipse.x / determinant), WIDE));
    float found[2 * CHANNELS];
    fit(raw, displacement, trusted, table, cfa, balance, found, ellipse, span, fmax(guide[at], 0.0f), v, u, reference,
        tiles_y, tiles_x, rows, cols, h, w, frames);
    const float luminance = luminance_of(found, balance);
    for (int c = 0; c < CHANNELS; ++c) {
        const float mean = tints[c * plane + at], spread = tints[(CHANNELS + c) * plane + at] * found[CHANNELS + c];
        found[c] = luminance + mean + spread / (spread + TINT) * (found[c] - luminance - mean);
    }
    const float off = luminance_of(found, balance) - luminance;
    for (int c = 0; c < CHANNELS; ++c) out[((size_t)c * high + y) * wide + x] = (found[c] - off) / balance[c];
}
