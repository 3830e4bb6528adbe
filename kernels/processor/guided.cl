// Five passes: `encode` writes codes with their surroundings, `first` the first picture (CHANNELS channels and 0), `contrast` its
// differences along rows, columns and both diagonals, `classify` each pixel's row of the table, `apply` the planes.
// All but `apply` compute whole numbers, which are the same on every device.
#pragma OPENCL FP_CONTRACT OFF
#define LARGEST 131071

// The pixel in place of pixel i: mirrored for periods up to 2, else a whole number of periods away.
inline int repeated(const int i, const int n, const int period)
{
    if (period <= 2) {
        const int span = max(2 * n - 2, 1), at = (i % span + span) % span;
        return at < n ? at : span - at;
    }
    if (i < 0) return (i % period + period) % period;
    return i < n ? i : n - period + (i - n) % period;
}

inline int place(const int i, const int period) { return (i % period + period) % period; }

__kernel void encode(
    // in:
    __global const ushort *restrict raw,     // [rows][cols]
    __global const float *restrict factors,  // [period_y][period_x]
    // out:
    __global int *restrict codes,            // [high][wide]
    // params:
    const float shift, const float zero, const float steps, const int root, const int reach, const int shift_y,
    const int shift_x,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols, const int high, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= wide || y >= high)
    const int v = repeated(y - reach, rows, period_y), u = repeated(x - reach, cols, period_x);
    float value = (float)raw[(size_t)v * cols + u] + shift;
    if (root) value = copysign(sqrt(fabs(value)), value) - zero;
    value = value * factors[(v + shift_y) % period_y * period_x + (u + shift_x) % period_x] * steps;
    codes[(size_t)y * wide + x] = (int)clamp(floor(value + 0.5f), -(float)LARGEST, (float)LARGEST);
}

__kernel void first(
    // in:
    __global const int *restrict codes,    // [rows + 2 inner][wide]
    __global const int2 *restrict taps,    // [count] rows, columns
    __global const int4 *restrict weights, // [period_y period_x][count]
    // out:
    __global int4 *restrict pictures,      // [rows][cols]
    // params:
    const int inner, const int outer, const int shift_y, const int shift_x,
    // sizes:
    const int period_y, const int period_x, const int count, const int rows, const int cols, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int position = place(y - outer + shift_y, period_y) * period_x + place(x - outer + shift_x, period_x);
    __global const int *at = codes + (size_t)(y + inner) * wide + x + inner;
    __global const int4 *weight = weights + position * count;
    int4 sum = (int4)(1024);
    for (int t = 0; t < count; ++t) sum += weight[t] * at[taps[t].x * wide + taps[t].y];
    pictures[(size_t)y * cols + x] = sum >> 11;
}

inline int light(__global const int4 *restrict pixel)
{
    const int values[4] = {pixel->x, pixel->y, pixel->z, pixel->w};
    return values[0] + values[1] + values[2] + values[3] + values[GUIDE];
}

// The contrast of colour between two pixels.
inline int tint(__global const int4 *restrict one, __global const int4 *restrict other)
{
    const int4 step = *one - *other;
    const int steps[4] = {step.x, step.y, step.z, step.w};
    int sum = 0;
    for (int c = 0; c < CHANNELS; ++c) sum += abs(steps[c] - steps[GUIDE]);
    return sum;
}

__kernel void contrast(
    // in:
    __global const int4 *restrict pictures,  // [..][wide]
    // out:
    __global int4 *restrict contrasts,       // [rows][cols]
    __global int *restrict tints,            // [rows][cols] of colour
    // params:
    const int reach,
    // sizes:
    const int rows, const int cols, const int wide)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    __global const int4 *at = pictures + (size_t)(y + reach) * wide + x + reach;
    tints[(size_t)y * cols + x] = tint(at + 1, at - 1) + tint(at + wide, at - wide);
    contrasts[(size_t)y * cols + x] = (int4)(
        abs(light(at + 1) - light(at - 1)), abs(light(at + wide) - light(at - wide)),
        abs(light(at + wide + 1) - light(at - wide - 1)), abs(light(at + wide - 1) - light(at - wide + 1)));
}

__kernel void classify(
    // in:
    __global const int4 *restrict contrasts,  // [rows + 2 box][cols + 2 box]
    __global const int *restrict tints,       // the same
    __global const int *restrict limits,      // [strengths + ratios + diagonals + shares]
    // out:
    __global int *restrict units,             // [rows][cols]
    // params:
    const int least, const int shift_y, const int shift_x,
    // sizes:
    const int period_y, const int period_x, const int ratios, const int diagonals, const int shares,
    const int strengths, const int box, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int wide = cols + 2 * box, span = 2 * box + 1;
    int4 sum = (int4)(0);
    long tint = 0;
    for (int v = 0; v < span; ++v)
        for (int u = 0; u < span; ++u) {
            sum += contrasts[(size_t)(y + v) * wide + x + u];
            tint += tints[(size_t)(y + v) * wide + x + u];
        }
    int direction = ratios, diagonal = diagonals, share = 0, strength = 0;
    for (int i = 0; i < ratios + diagonals; ++i) {
        const long ratio = limits[strengths + i], more = (ratio - 8) * least;
        const long one = i < ratios ? sum.x : sum.z, two = i < ratios ? sum.y : sum.w;
        const int step = (8 * one > ratio * two + more) - (8 * two > ratio * one + more);
        if (i < ratios) direction += step;
        else diagonal += step;
    }
    for (int i = 0; i < shares; ++i) {
        const long ratio = limits[strengths + ratios + diagonals + i], light_sum = sum.x + sum.y;
        share += 16 * tint > ratio * light_sum + (ratio - 8) * least;
    }
    for (int i = 0; i < strengths; ++i) strength += sum.x + sum.y > limits[i];
    const int position = (y + shift_y) % period_y * period_x + (x + shift_x) % period_x;
    units[(size_t)y * cols + x] =
        (((position * (2 * ratios + 1) + direction) * (2 * diagonals + 1) + diagonal) * (shares + 1) + share)
            * (strengths + 1) + strength;
}

__kernel void apply(
    // in:
    __global const int *restrict codes,         // [rows + 2 reach][wide]
    __global const int4 *restrict pictures,     // [rows + 2 outer][broad]
    __global const int *restrict units,         // [rows][cols]
    __global const int2 *restrict code_taps,    // [codes_count] rows, columns
    __global const int2 *restrict guide_taps,   // [guides_count]
    __global const float4 *restrict weights,    // [units][codes_count + CHANNELS guides_count]
    __global const float4 *restrict share,      // [units] of the loss
    __global const float *restrict loss,        // of roots, see levels.py
    // out:
    __global float *restrict out,               // [CHANNELS][rows][cols]
    // params:
    const float unit, const float zero, const float offset, const float scale, const int root, const int reach,
    const int outer,
    // sizes:
    const int codes_count, const int guides_count, const int rows, const int cols, const int wide, const int broad)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const size_t pixel = (size_t)y * cols + x, pixels = (size_t)rows * cols;
    const int row = units[pixel];
    __global const float4 *weight = weights + (size_t)row * (codes_count + CHANNELS * guides_count);
    __global const int *at = codes + (size_t)(y + reach) * wide + x + reach;
    float4 sum = (float4)(0.0f);
    for (int t = 0; t < codes_count; ++t)
        sum += weight[t] * (float)at[code_taps[t].x * wide + code_taps[t].y];
    weight += codes_count;
    __global const int4 *near = pictures + (size_t)(y + outer) * broad + x + outer;
    for (int t = 0; t < guides_count; ++t) {
        const float4 color = convert_float4(near[guide_taps[t].x * broad + guide_taps[t].y]);
        const float values[4] = {color.x, color.y, color.z, color.w};
        float4 part = weight[CHANNELS * t] * values[0];
        for (int c = 1; c < CHANNELS; ++c) part += weight[CHANNELS * t + c] * values[c];
        sum += part;
    }
    float4 code = sum * unit;
    if (root) {
        code += zero;
        const float4 square = code * code, near_black = loss[1] / (loss[0] + square);
        const float4 part = fmin(near_black, 1.0f);
        const float4 lost = (((loss[2] * part + loss[3]) * part + loss[4]) * part + loss[5]) * part + loss[6];
        code = code * fabs(code) - offset + (loss[0] > 0.0f ? share[row] * lost : (float4)(0.0f));
    }
    const float planes[4] = {code.x, code.y, code.z, code.w};
    for (int o = 0; o < CHANNELS; ++o) out[o * pixels + pixel] = planes[o] * scale;
}
