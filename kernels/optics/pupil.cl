// One frequency of one band per work-item; the table of a band stays in cache.

// Weights of the cubic through the nodes -1, 0, 1, 2 at t.
float4 cubic(const float t)
{
    return (float4)(-t * (t - 1.0f) * (t - 2.0f) / 6.0f, (t + 1.0f) * (t - 1.0f) * (t - 2.0f) / 2.0f,
                    -(t + 1.0f) * t * (t - 2.0f) / 2.0f, (t + 1.0f) * t * (t - 1.0f) / 6.0f);
}

// Node below the place of s < 1 among `length` nodes even in 1 - sqrt(1 - s), kept so that a cubic has all its nodes.
int node(const float s, const int length, float *rest)
{
    // 1 - sqrt(1 - s) without its cancellation
    const float place = s / (1.0f + sqrt(1.0f - s)) * (length - 1);
    const int i = clamp((int)place, 1, length - 3);
    *rest = place - i;
    return i;
}

__kernel void radial(
    // in:
    __global const float *restrict table,     // [bands][length]
    __global const float *restrict q,
    __global const float *restrict weight_y,  // [replicas][rows]
    __global const float *restrict weight_x,  // [replicas][cols]
    __global const float *restrict fy, __global const float *restrict fx,
    // out:
    __global float *restrict tables,          // [bands][rows][cols]
    // params:
    const int low, const int high, const int length,
    // sizes:
    const int bands, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), band = get_global_id(2);
    GUARD(x >= cols || y >= rows || band >= bands)
    __global const float *line = table + (size_t)band * length;
    float sum = 0.0f;
    for (int a = low; a <= high; ++a)
        for (int b = low; b <= high; ++b) {
            const float v = q[band] * (fy[y] + a), u = q[band] * (fx[x] + b);
            const float s = sqrt(u * u + v * v);
            float rest;
            const int i = node(fmin(s, 1.0f), length, &rest);
            const float4 c = cubic(rest);
            const float value = c.x * line[i - 1] + c.y * line[i] + c.z * line[i + 1] + c.w * line[i + 2];
            sum += s < 1.0f ? value * weight_y[(a - low) * rows + y] * weight_x[(b - low) * cols + x] : 0.0f;
        }
    tables[((size_t)band * rows + y) * cols + x] = sum;
}

__kernel void polar(
    // in:
    __global const float2 *restrict table,    // [bands][sectors * per_sector + 1][length]
    __global const float *restrict q,
    __global const float *restrict weight_y,  // [replicas][rows]
    __global const float *restrict weight_x,  // [replicas][cols]
    __global const float *restrict fy, __global const float *restrict fx,
    // out:
    __global float2 *restrict tables,         // [bands][rows][cols]
    // params:
    const int low, const int high, const float angle, const int sides, const float inner, const int sectors,
    const int per_sector, const int length,
    // sizes:
    const int bands, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), band = get_global_id(2);
    GUARD(x >= cols || y >= rows || band >= bands)
    const int rays = sectors * per_sector;
    float2 sum = (float2)(0.0f, 0.0f);
    for (int a = low; a <= high; ++a)
        for (int b = low; b <= high; ++b) {
            const float v = q[band] * (fy[y] + a), u = q[band] * (fx[x] + b);
            float s = sqrt(u * u + v * v);
            if (s >= 1.0f) continue;
            float turn = (atan2(v, u) - angle) / M_PI_F;  // in half turns, then within [0, 1)
            const float whole = floor(turn);
            turn -= whole;
            const float sign = ((int)whole & 1) ? -1.0f : 1.0f;
            if (sides > 0) {  // s of the cut-off's nearest side
                const float part = turn * sides / 2.0f;
                s *= cos((part - rint(part)) * 2.0f * M_PI_F / sides) / inner;
                if (s >= 1.0f) continue;
            }
            const float ray = turn * rays;
            const int start = min((int)ray / per_sector, sectors - 1) * per_sector;
            const int j = start + clamp((int)ray - start, 1, per_sector - 2);
            const float4 across = cubic(ray - j);
            float rest;
            const int i = node(s, length, &rest);
            const float4 along = cubic(rest);
            float2 value = (float2)(0.0f, 0.0f);
            for (int k = 0; k < 4; ++k) {
                __global const float2 *line = table + ((size_t)band * (rays + 1) + j + k - 1) * length + i;
                const float weight = k == 0 ? across.x : k == 1 ? across.y : k == 2 ? across.z : across.w;
                value += weight * (along.x * line[-1] + along.y * line[0] + along.z * line[1] + along.w * line[2]);
            }
            const float weight = weight_y[(a - low) * rows + y] * weight_x[(b - low) * cols + x];
            sum += weight * (float2)(value.x, sign * value.y);
        }
    tables[((size_t)band * rows + y) * cols + x] = sum;
}
