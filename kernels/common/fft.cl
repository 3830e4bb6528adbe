// Transforms of whole lines in local memory: each work-group reads its lines once and writes them once.
// From the host: LENGTH of the transform, THREADS of a group, LINES in it, SIGN of the exponent (-1 forward, +1
// inverse), PASSES: a list of PASS(radix, product of the radices before it).

// Where element e of a line is kept: every 16th place is left out, so that strides of powers of two meet all banks.
#define AT(e) ((e) + ((e) >> 4))
#define ROOM (LENGTH + (LENGTH >> 4) + 1)

inline float2 times(const float2 a, const float2 b)
{
    return (float2)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

inline float2 turned(const float2 a)  // times SIGN i
{
    return (float2)(-SIGN * a.y, SIGN * a.x);
}

inline void transform_2(float2 *v)
{
    const float2 a = v[0], b = v[1];
    v[0] = a + b;
    v[1] = a - b;
}

inline void transform_3(float2 *v)
{
    const float2 sum = v[1] + v[2], middle = v[0] - 0.5f * sum, side = turned(0.866025404f * (v[1] - v[2]));
    v[0] += sum;
    v[1] = middle + side;
    v[2] = middle - side;
}

inline void transform_4(float2 *v)
{
    const float2 a = v[0] + v[2], b = v[0] - v[2], c = v[1] + v[3], d = turned(v[1] - v[3]);
    v[0] = a + c;
    v[1] = b + d;
    v[2] = a - c;
    v[3] = b - d;
}

inline void transform_5(float2 *v)
{
    const float2 s1 = v[1] + v[4], s2 = v[2] + v[3], d1 = v[1] - v[4], d2 = v[2] - v[3];
    const float2 m1 = v[0] + 0.309016994f * s1 - 0.809016994f * s2, m2 = v[0] - 0.809016994f * s1 + 0.309016994f * s2;
    const float2 t1 = turned(0.951056516f * d1 + 0.587785252f * d2);
    const float2 t2 = turned(0.587785252f * d1 - 0.951056516f * d2);
    v[0] += s1 + s2;
    v[1] = m1 + t1;
    v[2] = m2 + t2;
    v[3] = m2 - t2;
    v[4] = m1 - t1;
}

inline void transform_8(float2 *v)
{
    float2 even[4] = {v[0], v[2], v[4], v[6]}, odd[4] = {v[1], v[3], v[5], v[7]};
    transform_4(even);
    transform_4(odd);
    odd[1] = times(odd[1], (float2)(0.707106781f, SIGN * 0.707106781f));
    odd[2] = turned(odd[2]);
    odd[3] = times(odd[3], (float2)(-0.707106781f, SIGN * 0.707106781f));
#pragma unroll
    for (int m = 0; m < 4; ++m) {
        v[m] = even[m] + odd[m];
        v[m + 4] = even[m] - odd[m];
    }
}

// One Stockham pass over all lines of the group, in place: every work-item holds its inputs while all others read.
#define PASS(RADIX, DONE)                                                                                      \
    {                                                                                                          \
        const int apart = LENGTH / RADIX, count = LINES * apart;                                               \
        float2 v[(LINES * LENGTH / RADIX + THREADS - 1) / THREADS][RADIX];                                     \
        _Pragma("unroll") for (int b = 0; b * THREADS < LINES * LENGTH / RADIX; ++b) {                         \
            const int j = item + b * THREADS;                                                                  \
            if (j < count) {                                                                                   \
                const int i = j % apart, k = i % DONE;                                                         \
                __local const float2 *from = line + j / apart * ROOM;                                          \
                v[b][0] = from[AT(i)];                                                                         \
                _Pragma("unroll") for (int m = 1; m < RADIX; ++m)                                              \
                    v[b][m] = DONE == 1 ? from[AT(i + m * apart)]                                              \
                                        : times(from[AT(i + m * apart)],                                       \
                                                roots[m * k * (LENGTH / (RADIX * DONE))]);                     \
                transform_##RADIX(v[b]);                                                                       \
            }                                                                                                  \
        }                                                                                                      \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                          \
        _Pragma("unroll") for (int b = 0; b * THREADS < LINES * LENGTH / RADIX; ++b) {                         \
            const int j = item + b * THREADS;                                                                  \
            if (j < count) {                                                                                   \
                const int i = j % apart, k = i % DONE;                                                         \
                const int first = (i - k) * RADIX + k;                                                         \
                __local float2 *to = line + j / apart * ROOM;                                                  \
                _Pragma("unroll") for (int m = 0; m < RADIX; ++m) to[AT(first + m * DONE)] = v[b][m];          \
            }                                                                                                  \
        }                                                                                                      \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                          \
    }

// Real rows to half spectra, two rows as the real and imaginary part of one line.
__kernel void rows_forward(
    // in:
    __global const float *restrict planes,   // [rows][LENGTH], all planes' rows one after the other
    __global const float2 *restrict roots,   // [LENGTH]
    // out:
    __global float2 *restrict spectra,       // [rows][pitch]
    // sizes:
    const int rows, const int pitch)
{
    __local float2 line[LINES * ROOM];
    const int item = get_local_id(0), first = 2 * get_group_id(0), second = min(first + 1, rows - 1);
    for (int x = item; x < LENGTH; x += THREADS)
        line[AT(x)] = (float2)(planes[(size_t)first * LENGTH + x], planes[(size_t)second * LENGTH + x]);
    barrier(CLK_LOCAL_MEM_FENCE);
    PASSES
    for (int x = item; x <= LENGTH / 2; x += THREADS) {
        const float2 a = line[AT(x)], b = line[AT(x == 0 ? 0 : LENGTH - x)];
        spectra[(size_t)first * pitch + x] = 0.5f * (float2)(a.x + b.x, a.y - b.y);
        if (second > first) spectra[(size_t)second * pitch + x] = 0.5f * (float2)(a.y + b.y, b.x - a.x);
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
    __local float2 line[LINES * ROOM];
    const int item = get_local_id(0), first = 2 * get_group_id(0), second = min(first + 1, rows - 1);
    for (int x = item; x <= LENGTH / 2; x += THREADS) {
        const float2 a = spectra[(size_t)first * pitch + x], b = spectra[(size_t)second * pitch + x];
        line[AT(x)] = (float2)(a.x - b.y, a.y + b.x);
        if (x > 0) line[AT(LENGTH - x)] = (float2)(a.x + b.y, b.x - a.y);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    PASSES
    for (int x = item; x < LENGTH; x += THREADS) {
        planes[(size_t)first * LENGTH + x] = scale * line[AT(x)].x;
        planes[(size_t)second * LENGTH + x] = scale * (second > first ? line[AT(x)].y : line[AT(x)].x);
    }
}

// Columns of half spectra in place, LINES neighbours at a time: what is read and written together lies together.
__kernel void columns(
    // in, out:
    __global float2 *spectra,                // [planes][LENGTH][pitch]
    // in:
    __global const float2 *restrict roots,
    // sizes:
    const int cols, const int pitch)
{
    __local float2 line[LINES * ROOM];
    const int item = get_local_id(0), left = LINES * get_group_id(0);
    __global float2 *plane = spectra + (size_t)get_group_id(1) * LENGTH * pitch;
    for (int j = item; j < LINES * LENGTH; j += THREADS) {
        const int x = j % LINES, y = j / LINES;
        line[x * ROOM + AT(y)] = left + x < cols ? plane[(size_t)y * pitch + left + x] : (float2)(0.0f, 0.0f);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    PASSES
    for (int j = item; j < LINES * LENGTH; j += THREADS) {
        const int x = j % LINES, y = j / LINES;
        if (left + x < cols) plane[(size_t)y * pitch + left + x] = line[x * ROOM + AT(y)];
    }
}
