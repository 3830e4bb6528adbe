// On a CPU: CHUNK pixels per work-item, TOGETHER bands of them at a time, whose sums stay in the nearest cache. All bands
// at once are read from as many places, whole pages apart in frames of many sizes, which drive one another out of it.
// BANDS, PLANES, CHUNK and TOGETHER come from the host; WIDTH is 8.
#include "lanes.clh"

#define FROM_FLOAT(from) vload8(0, from)
#define FROM_HALF(from) vload_half8(0, from)
#define ONE_FLOAT(from) (*(from))
#define ONE_HALF(from) vload_half(0, from)

#define LINES(NAME, TYPE, MANY, ONE)                                                                                  \
    __kernel void NAME(__global const TYPE *restrict content, __constant float *weights,                              \
                       __global float *restrict planes, const int pixels)                                             \
    {                                                                                                                 \
        const int first = get_global_id(0) * CHUNK, own = min(CHUNK, pixels - first), whole = own / WIDTH;            \
        real sums[CHUNK / WIDTH][PLANES];                                                                             \
        for (int i = 0; i < whole; ++i)                                                                               \
            for (int p = 0; p < PLANES; ++p) sums[i][p] = 0.0f;                                                       \
        for (int band = 0; band < BANDS; band += TOGETHER) {                                                          \
            __global const TYPE *from = content + (size_t)band * pixels + first;                                      \
            for (int i = 0; i < whole; ++i)                                                                           \
                _Pragma("unroll") for (int b = 0; b < TOGETHER; ++b) if (band + b < BANDS) {                          \
                    const real value = MANY(from + (size_t)b * pixels + i * WIDTH);                                   \
                    _Pragma("unroll") for (int p = 0; p < PLANES; ++p)                                                \
                        sums[i][p] += weights[p * BANDS + band + b] * value;                                          \
                }                                                                                                     \
        }                                                                                                             \
        for (int i = 0; i < whole; ++i)                                                                               \
            for (int p = 0; p < PLANES; ++p) vstore8(sums[i][p], i, planes + (size_t)p * pixels + first);             \
        for (int i = first + whole * WIDTH; i < first + own; ++i)                                                     \
            for (int p = 0; p < PLANES; ++p) {                                                                        \
                float sum = 0.0f;                                                                                     \
                for (int b = 0; b < BANDS; ++b)                                                                       \
                    sum += weights[p * BANDS + b] * ONE(content + (size_t)b * pixels + i);                            \
                planes[(size_t)p * pixels + i] = sum;                                                                 \
            }                                                                                                         \
    }

LINES(integrate, float, FROM_FLOAT, ONE_FLOAT)
LINES(integrate_half, half, FROM_HALF, ONE_HALF)
