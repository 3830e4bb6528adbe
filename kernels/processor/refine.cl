// Two passes: `smooth` mixes the colours, `sums` adds over the pixels of a tile, one tile per work-item.
// From the host: TILE, PERIOD_Y, PERIOD_X, FULL, MARGIN.
#pragma OPENCL FP_CONTRACT OFF

__kernel void smooth(
    // in:
    __global const ushort *restrict raw,   // [frames][rows][cols]
    __global const float *restrict table,  // [5][frames] dark, scale, shot, floor, full
    // out:
    __global float *restrict out,          // [frames][rows][cols]
    // sizes:
    const int frames, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), i = get_global_id(2);
    GUARD(x >= cols || y >= rows || i >= frames)
    const float full = table[4 * frames + i];
    float sum = 0.0f;
    bool is_full = false;
    for (int j = 1 - PERIOD_Y; j < PERIOD_Y; ++j) {
        __global const ushort *line = raw + ((size_t)i * rows + clamp(y + j, 0, rows - 1)) * cols;
        float part = 0.0f;
        for (int k = 1 - PERIOD_X; k < PERIOD_X; ++k) {
            const float number = line[clamp(x + k, 0, cols - 1)];
            part += (float)(PERIOD_X - abs(k)) * number;
            is_full = is_full || number >= full;
        }
        sum += (float)(PERIOD_Y - abs(j)) * part;
    }
    const float mean = sum / (float)(PERIOD_Y * PERIOD_Y * PERIOD_X * PERIOD_X);
    const float rate = (mean - table[i]) * table[frames + i], left = (full - table[i]) * table[frames + i] - rate;
    const float noise = table[2 * frames + i] * fmax(rate, 0.0f) + table[3 * frames + i];
    is_full = is_full || left < 0.0f || left * left < MARGIN * MARGIN * noise;
    out[((size_t)i * rows + y) * cols + x] = is_full ? FULL : rate;
}

// Weights of the samples at -1, 0, 1, 2 at 0 <= s < 1, after Keys.
inline float4 keys(const float s)
{
    const float r = 1.0f - s;
    return (float4)(-0.5f * s * r * r, 1.0f - s * s * (2.5f - 1.5f * s), 1.0f - r * r * (2.5f - 1.5f * r),
                    -0.5f * s * s * r);
}

__kernel void sums(
    // in:
    __global const float *restrict plane,         // [frames][rows][cols]
    __global const float *restrict displacement,  // [frames][tiles_y][tiles_x][2]
    __global const float *restrict table,         // [5][frames]
    // out:
    __global float *restrict out,                 // [frames][tiles_y][tiles_x][7]
    // params:
    const int reference,
    // sizes:
    const int tiles_y, const int tiles_x, const int frames, const int rows, const int cols)
{
    const int tx = get_global_id(0), ty = get_global_id(1), i = get_global_id(2);
    GUARD(tx >= tiles_x || ty >= tiles_y || i >= frames)
    const size_t at = ((size_t)i * tiles_y + ty) * tiles_x + tx;
    const float dy = displacement[2 * at] * PERIOD_Y, dx = displacement[2 * at + 1] * PERIOD_X;
    const float whole_y = floor(dy), whole_x = floor(dx);
    const float4 wy = keys(dy - whole_y), wx = keys(dx - whole_x);
    const float weights[4] = {wy.x, wy.y, wy.z, wy.w};
    const int down = (int)clamp(whole_y, -1e6f, 1e6f), right = (int)clamp(whole_x, -1e6f, 1e6f);
    const float shot = table[2 * frames + i] + table[2 * frames + reference];
    const float floor_ = table[3 * frames + i] + table[3 * frames + reference];
    __global const float *wanted = plane + (size_t)reference * rows * cols;
    __global const float *seen = plane + (size_t)i * rows * cols;
    float found[7] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    const int last_y = min((ty + 1) * TILE * PERIOD_Y, rows - 1), last_x = min((tx + 1) * TILE * PERIOD_X, cols - 1);
    for (int y = max(ty * TILE * PERIOD_Y, 1); y < last_y; y += PERIOD_Y) {
        if (y + down < 1 || y + down + 2 >= rows) continue;
        float part[7] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        for (int x = max(tx * TILE * PERIOD_X, 1); x < last_x; x += PERIOD_X) {
            if (x + right < 1 || x + right + 2 >= cols) continue;
            __global const float *here = wanted + (size_t)y * cols + x;
            const float up = here[-cols], low = here[cols], before = here[-1], after = here[1], own = here[0];
            float value = 0.0f, largest = fmax(fmax(fmax(up, low), fmax(before, after)), own);
            for (int a = 0; a < 4; ++a) {
                __global const float *taps = seen + (size_t)(y + down + a - 1) * cols + x + right - 1;
                const float4 four = (float4)(taps[0], taps[1], taps[2], taps[3]);
                value += weights[a] * (wx.x * four.x + wx.y * four.y + wx.z * four.z + wx.w * four.w);
                largest = fmax(largest, fmax(fmax(four.x, four.y), fmax(four.z, four.w)));
            }
            if (largest >= FULL) continue;
            const float weight = 1.0f / (shot * fmax(own, 0.0f) + floor_);
            const float slope_y = 0.5f * (low - up), slope_x = 0.5f * (after - before), off = value - own;
            part[0] += weight * slope_y * slope_y;
            part[1] += weight * slope_y * slope_x;
            part[2] += weight * slope_x * slope_x;
            part[3] -= weight * slope_y * off;
            part[4] -= weight * slope_x * off;
            part[5] += weight * off * off;
            part[6] += 1.0f;
        }
        for (int k = 0; k < 7; ++k) found[k] += part[k];
    }
    for (int k = 0; k < 7; ++k) out[7 * at + k] = i == reference ? 0.0f : found[k];
}
