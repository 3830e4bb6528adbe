// One frequency of BANDS bands per work-item (one on a GPU): they share the frequency's direction and its replicas.

// Weights of the cubic through the nodes -1, 0, 1, 2 at t.
float4 cubic(const float t)
{
    return (float4)(-t * (t - 1.0f) * (t - 2.0f) / 6.0f, (t + 1.0f) * (t - 1.0f) * (t - 2.0f) / 2.0f,
                    -(t + 1.0f) * t * (t - 2.0f) / 2.0f, (t + 1.0f) * t * (t - 1.0f) / 6.0f);
}

// Node below the place of s < 1 among `length` nodes even in 1 - sqrt(1 - s), limited to nodes with a whole cubic.
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
    const int x = get_global_id(0), y = get_global_id(1), first = get_global_id(2) * BANDS;
    GUARD(x >= cols || y >= rows || first >= bands)
    const int count = min(BANDS, bands - first);
    float sums[BANDS];
    for (int n = 0; n < BANDS; ++n) sums[n] = 0.0f;
    for (int a = low; a <= high; ++a)
        for (int b = low; b <= high; ++b) {
            const float v = fy[y] + a, u = fx[x] + b, radius = sqrt(u * u + v * v);
            const float weight = weight_y[(a - low) * rows + y] * weight_x[(b - low) * cols + x];
            for (int n = 0; n < count; ++n) {
                const float s = q[first + n] * radius;
                if (s >= 1.0f) continue;
                float rest;
                const int i = node(s, length, &rest);
                sums[n] += weight * dot(cubic(rest), vload4(0, table + (size_t)(first + n) * length + i - 1));
            }
        }
    for (int n = 0; n < count; ++n) tables[((size_t)(first + n) * rows + y) * cols + x] = sums[n];
}

__kernel void polar(
    // in:
    __global const float *restrict table,     // [bands][sectors * per_sector + 1][length][2]
    __global const float *restrict q,
    __global const float2 *restrict weight_y,  // [replicas][rows]
    __global const float2 *restrict weight_x,  // [replicas][cols]
    __global const float *restrict fy, __global const float *restrict fx,
    // out:
    __global float2 *restrict tables,         // [bands][rows][cols]
    // params:
    const int low, const int high, const float angle, const int sides, const float inner, const int sectors,
    const int per_sector, const int length,
    // sizes:
    const int bands, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), first = get_global_id(2) * BANDS;
    GUARD(x >= cols || y >= rows || first >= bands)
    const int count = min(BANDS, bands - first);
    const int rays = sectors * per_sector;
    float2 sums[BANDS];
    for (int n = 0; n < BANDS; ++n) sums[n] = (float2)(0.0f, 0.0f);
    for (int a = low; a <= high; ++a)
        for (int b = low; b <= high; ++b) {
            const float v = fy[y] + a, u = fx[x] + b;
            float turn = (atan2(v, u) - angle) / M_PI_F;  // in half turns, then within [0, 1)
            const float whole = floor(turn);
            turn -= whole;
            float radius = sqrt(u * u + v * v);
            if (sides > 0) {  // s of the cut-off's nearest side
                const float part = turn * sides / 2.0f;
                radius *= cospi((part - rint(part)) * 2.0f / sides) / inner;  // some drivers lack cos
            }
            const float ray = turn * rays;
            const int start = min((int)ray / per_sector, sectors - 1) * per_sector;
            const int j = start + clamp((int)ray - start, 1, per_sector - 2);
            const float4 across = cubic(ray - j);
            const float2 wy = weight_y[(a - low) * rows + y], wx = weight_x[(b - low) * cols + x];
            const float2 weight = (float2)(wy.x * wx.x - wy.y * wx.y, wy.x * wx.y + wy.y * wx.x);
            const float sign = ((int)whole & 1) ? -1.0f : 1.0f;
            for (int n = 0; n < count; ++n) {
                const float s = q[first + n] * radius;
                if (s >= 1.0f) continue;
                float rest;
                const int i = node(s, length, &rest);
                const float4 along = cubic(rest);
                __global const float *near = table + 2 * (((size_t)(first + n) * (rays + 1) + j - 1) * length + i - 1);
                const float8 line = across.x * vload8(0, near) + across.y * vload8(0, near + 2 * length)
                                  + across.z * vload8(0, near + 4 * length) + across.w * vload8(0, near + 6 * length);
                const float8 sum = line * along.xxyyzzww;
                const float4 half_sum = sum.lo + sum.hi;
                const float2 value = (half_sum.lo + half_sum.hi) * (float2)(1.0f, sign);
                sums[n] += (float2)(weight.x * value.x - weight.y * value.y, weight.x * value.y + weight.y * value.x);
            }
        }
    for (int n = 0; n < count; ++n) tables[((size_t)(first + n) * rows + y) * cols + x] = sums[n];
}

// Adds what cubics between `nodes` frequencies of a period miss at the creases of a polygon's O; a row per work-item.
__kernel void crease(
    // in:
    __global const float *restrict lines,      // [creases][4], see gpusim.optics.creases
    __global const float2 *restrict sizes,     // [bands][creases][places]
    __global const float *restrict q,
    __global const float2 *restrict weight_y,  // [replicas][rows]
    __global const float2 *restrict weight_x,  // [replicas][cols]
    __global const float *restrict fy, __global const float *restrict fx,
    // out:
    __global float2 *restrict tables,          // [bands][rows][cols]
    // params:
    const int low, const int high, const float reach, const int nodes, const int period,
    // sizes:
    const int creases, const int places, const int bands, const int rows, const int cols)
{
    const int y = get_global_id(0), band = get_global_id(1);
    GUARD(y >= rows || band >= bands)
    const float at_y = fy[y] * nodes, ty = at_y - floor(at_y), scale = (places - 1) / (2.0f * reach);
    const float4 cy = cubic(ty);
    for (int k = 0; k < creases; ++k) {
        const float ny = lines[4 * k], nx = lines[4 * k + 1], offset = lines[4 * k + 2] / q[band];
        const float sign = lines[4 * k + 3] * q[band], step = 1.0f / nodes;
        const float wide = 2.0f * (fabs(ny) + fabs(nx)) * step, end = reach / q[band] + wide;
        __global const float2 *size = sizes + ((size_t)band * creases + k) * places;
        for (int a = low; a <= high; ++a) {
            const float v = fy[y] + a, rest = ny * v - offset;
            float first = low - 1.0f, last = high + 1.0f;  // of u: near the line, and not beyond its ends
            if (fabs(nx) > 1e-6f) {
                const float middle = -rest / nx, more = wide / fabs(nx);
                first = fmax(first, middle - more);
                last = fmin(last, middle + more);
            } else if (fabs(rest) >= wide) continue;
            if (fabs(ny) > 1e-6f) {
                const float middle = nx * v / ny, more = end / fabs(ny);
                first = fmax(first, middle - more);
                last = fmin(last, middle + more);
            } else if (fabs(nx * v) >= end) continue;
            const float2 wy = weight_y[(a - low) * rows + y];
            for (int b = low; b <= high; ++b) {
                const int from = max((int)ceil((first - b) * period), 0);
                const int to = min((int)floor((last - b) * period), cols - 1);
                for (int x = from; x <= to; ++x) {
                    const float u = fx[x] + b, place = ((nx * v - ny * u) * q[band] + reach) * scale;
                    if (place <= 0.0f || place >= places - 1) continue;
                    const int i = min((int)place, places - 2);
                    const float2 slope = size[i + 1] - size[i], here = size[i] + (place - i) * slope;
                    const float at_x = fx[x] * nodes, tx = at_x - floor(at_x), away = rest + nx * u;
                    const float4 cx = cubic(tx);
                    // |away|, and that times the place, less cubics through them
                    float none = fabs(away), once = 0.0f;
                    for (int m = -1; m <= 2; ++m) {
                        const float dy = (m - ty) * step, c = m < 0 ? cy.x : m < 1 ? cy.y : m < 2 ? cy.z : cy.w;
                        const float4 dx = ((float4)(-1.0f, 0.0f, 1.0f, 2.0f) - tx) * step;
                        const float4 taps = c * cx * fabs(away + ny * dy + nx * dx);
                        none -= taps.x + taps.y + taps.z + taps.w;
                        once -= dot(taps, nx * dy - ny * dx);
                    }
                    const float2 value = sign * (none * here + once * q[band] * scale * slope);
                    const float2 wx = weight_x[(b - low) * cols + x];
                    const float2 weight = (float2)(wy.x * wx.x - wy.y * wx.y, wy.x * wx.y + wy.y * wx.x);
                    tables[((size_t)band * rows + y) * cols + x] +=
                        (float2)(weight.x * value.x - weight.y * value.y, weight.x * value.y + weight.y * value.x);
                }
            }
        }
    }
}
