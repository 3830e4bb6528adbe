// defects.py has the rules. A GPU's work-item makes a pixel, a CPU's a row, LANES neighbours at once: their range is
// computed as if all had the first column phase of the mosaic, then the second .., and a mask selects the right one.
// The other rules are checked only if a pixel is farther outside its range than the range is wide. Columns are 64-bit:
// see bayer.clh.
// The threshold is not contracted: the same bits everywhere.
#pragma OPENCL FP_CONTRACT OFF

#define LANES 16
typedef ushort16 pixels;
typedef uchar16 uchars;
#define LOAD(from) vload16(0, from)
#define STORE(values, to) vstore16(values, 0, to)
#define AS_PIXELS as_ushort16
#define ANY(values) ((as_ulong4(values).x | as_ulong4(values).y | as_ulong4(values).z | as_ulong4(values).w) != 0)

inline bool is_inside(const long y, const long x, const int rows, const int cols)
{
    return y >= 0 && y < rows && x >= 0 && x < cols;
}

inline bool is_defect(const int here, const int low, const int high, const int spread, const float black_level,
                      const float per_level, const float constant_part)
{
    const bool above = here > high;
    const int excess = above ? here - high : low - here, more = above ? spread : -spread;
    const float end = (float)(above ? high : low), limit = per_level * fmax(end - black_level, 0.0f) + constant_part;
    const bool spreads = 8 * more > excess & (float)more * (float)more > limit;
    return excess > 0 & (float)excess * (float)excess > limit & excess > high - low & !spreads;
}

// Any pixel, the border's too. near: COUNT neighbours, 4 adjacent ones, the 4 beyond these.
inline bool is_defect_at(
    __global const ushort *restrict raw, __global const int2 *restrict near, const long y, const long x,
    const float black_level, const float per_level, const float constant_part, const int rows, const int cols)
{
    int low = 65536, high = -1, spread = 0;
    for (int n = 0; n < COUNT; ++n) {
        const long v = y + near[n].x, u = x + near[n].y;
        if (!is_inside(v, u, rows, cols)) continue;
        const int value = raw[v * cols + u];
        low = min(low, value);
        high = max(high, value);
    }
    for (int n = COUNT; n < COUNT + 4; ++n) {
        const long v = y + near[n + 4].x, u = x + near[n + 4].y;
        if (is_inside(v, u, rows, cols))
            spread += (int)raw[(y + near[n].x) * cols + x + near[n].y] - (int)raw[v * cols + u];
    }
    return high >= 0 && is_defect(raw[y * cols + x], low, high, spread, black_level, per_level, constant_part);
}

__kernel void mark(
    // in:
    __global const ushort *restrict raw,   // [rows][cols]
    __global const int2 *restrict near,    // [period_y][period_x][COUNT + 8] rows, columns
    __global const ushort *restrict masks, // [period_x][period_x + LANES] 65535 if a column has the phase
    // out:
    __global uchar *restrict flags,        // [rows][cols] 255 for a defect
    // params:
    const float black_level, const float per_level, const float constant_part, const int reach,
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols)
{
    const long y = get_global_id(1);
    near += (y % period_y) * period_x * (COUNT + 8);
#if LINES == 0
    const long x = get_global_id(0);
    GUARD(y >= rows || x >= cols)
    flags[y * cols + x] = is_defect_at(raw, near + x % period_x * (COUNT + 8), y, x, black_level, per_level,
                                       constant_part, rows, cols) ? 255 : 0;
#else
    const bool inner = y >= reach && y < rows - reach && cols - 2 * reach >= LANES;
    const long begin = inner ? reach : cols, end = inner ? cols - reach : cols;
    __global uchar *out = flags + y * cols;
    for (long i = 0; i < begin + cols - end; ++i) {
        const long x = i < begin ? i : end + i - begin;
        out[x] = is_defect_at(raw, near + x % period_x * (COUNT + 8), y, x, black_level, per_level, constant_part,
                              rows, cols) ? 255 : 0;
    }
    long at[PERIOD_X][COUNT];
    for (int phase = 0; phase < PERIOD_X; ++phase)
        for (int n = 0; n < COUNT; ++n)
            at[phase][n] = (y + near[phase * (COUNT + 8) + n].x) * cols + near[phase * (COUNT + 8) + n].y;
    for (long next = begin; next < end; next += LANES) {
        const long x = min(next, end - LANES);  // the last overlaps the one before it
        const pixels here = LOAD(raw + y * cols + x);
        pixels suspect = 0;
        for (int phase = 0; phase < PERIOD_X; ++phase) {
            pixels low = LOAD(raw + at[phase][0] + x), high = low;
#pragma unroll
            for (int n = 1; n < COUNT; ++n) {
                const pixels value = LOAD(raw + at[phase][n] + x);
                low = value < low ? value : low;
                high = value > high ? value : high;
            }
            const pixels above = here - high, below = low - here, range = high - low;
            const pixels is_out = AS_PIXELS(((here > high) & (above > range)) | ((here < low) & (below > range)));
            suspect |= is_out & LOAD(masks + phase * (PERIOD_X + LANES) + x % PERIOD_X);
        }
        STORE((uchars)0, out + x);
        if (ANY(suspect))
            for (int lane = 0; lane < LANES; ++lane)
                if (((ushort *)&suspect)[lane])
                    out[x + lane] = is_defect_at(raw, near + (x + lane) % PERIOD_X * (COUNT + 8), y, x + lane,
                                                 black_level, per_level, constant_part, rows, cols) ? 255 : 0;
    }
#endif
}

// A defective pixel's value, from the good neighbours in its list.
inline ushort from_neighbours(
    __global const ushort *restrict raw, __global const uchar *restrict flags, __global const int4 *restrict entries,
    const int count, const long y, const long x, const int rows, const int cols)
{
    int nearest = -1, good = 0, group = -1;  // groups of the good ones, and of the pairs
    uint best = UINT_MAX, sum = 0;           // best: difference of a pair and, below it, its mean
    for (int n = 0; n < count; ++n) {
        const int4 entry = entries[n];
        if (group >= 0 && entry.w != group) break;
        const long v = y + entry.x, u = x + entry.y, v2 = y - entry.x, u2 = x - entry.y;
        if (!is_inside(v, u, rows, cols) || flags[v * cols + u]) continue;
        const uint value = raw[v * cols + u];
        if (nearest < 0 || entry.w == nearest) {
            nearest = entry.w;
            sum += value;
            ++good;
        }
        if (entry.z && is_inside(v2, u2, rows, cols) && !flags[v2 * cols + u2]) {
            const uint other = raw[v2 * cols + u2];
            best = min(best, abs_diff(value, other) << 16 | (value + other + 1) / 2);
            group = entry.w;
        }
    }
    if (group >= 0) return best & 0xFFFFu;
    return good ? (2 * sum + good) / (2 * good) : raw[y * cols + x];
}

__kernel void replace(
    // in:
    __global const ushort *restrict raw,    // [rows][cols]
    __global const uchar *restrict flags,   // [rows][cols] not 0 for a defect
    __global const int *restrict starts,    // [period_y period_x + 1]
    __global const int4 *restrict entries,  // rows, columns, whether the opposite has the same colour, group
    // out:
    __global ushort *restrict out,          // [rows][cols]
    // sizes:
    const int period_y, const int period_x, const int rows, const int cols)
{
    const long y = get_global_id(1);
    starts += y % period_y * period_x;
#if LINES == 0
    const long x = get_global_id(0);
    GUARD(y >= rows || x >= cols)
    const int list = x % period_x;
    out[y * cols + x] = flags[y * cols + x]
        ? from_neighbours(raw, flags, entries + starts[list], starts[list + 1] - starts[list], y, x, rows, cols)
        : raw[y * cols + x];
#else
    __global const ushort *from = raw + y * cols;
    __global const uchar *flag = flags + y * cols;
    __global ushort *to = out + y * cols;
    for (long x = 0; x < cols; ++x) to[x] = from[x];
    for (long start = 0; start < cols; start += 64) {
        const long end = min(start + 64, (long)cols);
        uchar some = 0;
        for (long x = start; x < end; ++x) some |= flag[x];
        if (!some) continue;
        for (long x = start; x < end; ++x) {
            if (!flag[x]) continue;
            const int list = x % period_x;
            to[x] = from_neighbours(raw, flags, entries + starts[list], starts[list + 1] - starts[list], y, x, rows,
                                    cols);
        }
    }
#endif
}
