// survey.cl for GPUs: a work-item takes one column, a work-group THREADS of them. Their sums are added in local memory,
// in one order, and the sums of a row's groups in another kernel: a group per row would leave most of a GPU idle.
// From the host: PROJECTIONS, THREADS (a multiple of SEGMENTS).
// OpenCL C that is also CUDA C++, see gpusim/backends/native.py.
#ifndef PAIR
#define PAIR(x, y) ((float2)(x, y))
#define FLOATS(at) ((__local float *)(at))
#endif

#define COUNT (PROJECTIONS + 1)            // the squares of the entries themselves are last
#define SEGMENTS 8                         // of a sum over the group
#define APART (THREADS + SEGMENTS)         // of a sum's terms: what neighbours read is in different banks
#define FOURS ((PROJECTIONS + 3) / 4)
#define ENTRIES 64                         // of the table in local memory at a time

// Sums over the group of own[3 COUNT] of every work-item: segments of every SEGMENTS-th item, then of these.
#define SUM_UP \
    _Pragma("unroll") for (int q = 0; q < 3 * COUNT; ++q) memory[q * APART + item] = own[q]; \
    barrier(CLK_LOCAL_MEM_FENCE); \
    for (int k = item; k < 3 * COUNT * SEGMENTS; k += THREADS) { \
        const int place = k / SEGMENTS * APART + k % SEGMENTS; \
        float sum = 0.0f; \
        _Pragma("unroll") for (int j = 0; j < THREADS; j += SEGMENTS) sum += memory[place + j]; \
        memory[place] = sum; \
    } \
    barrier(CLK_LOCAL_MEM_FENCE); \
    for (int q = item; q < 3 * COUNT; q += THREADS) { \
        float sum = 0.0f; \
        _Pragma("unroll") for (int j = 0; j < SEGMENTS; ++j) sum += memory[q * APART + j]; \
        parts[(size_t)get_group_id(0) * (3 * COUNT) + q] = sum; \
    }

// From projections to their squares; columns outside the row, and the last one's step to the right, count nothing.
#define SQUARE_UP \
    _Pragma("unroll") for (int q = 0; q < 3 * COUNT; ++q) { \
        const int is_used = q / COUNT == 1 ? x + 1 < cols : x < cols; \
        const float square = q % COUNT == PROJECTIONS ? own[q] : own[q] * own[q]; \
        own[q] = is_used ? square : 0.0f; \
    }

__kernel void mixed_groups(
    // in:
    __global const float *restrict content,  // [entries][rows][cols]
    __global const float *restrict table,    // [PROJECTIONS][entries]
    __global const int *restrict first,
    // out:
    __global float *restrict parts,          // [pairs][chunks][3][COUNT]
    // sizes:
    const int entries, const int rows, const int cols, const int chunks, const float unit)
{
    __local float memory[3 * COUNT * APART];
    __local float4 weights[ENTRIES * FOURS];
    const int item = get_local_id(0), x = get_group_id(0) % chunks * THREADS + item;
    const int y = min(max(first[get_group_id(0) / chunks], 0), rows - 1), column = min(x, cols - 1);
    const size_t frame = (size_t)rows * cols;
    __global const float *at = content + (size_t)y * cols + column;
    const int to_right = column + 1 < cols ? 1 : 0, to_below = y + 1 < rows ? cols : 0;
    float own[3 * COUNT];
    _Pragma("unroll") for (int q = 0; q < 3 * COUNT; ++q) own[q] = 0.0f;
    for (int begin = 0; begin < entries; begin += ENTRIES) {
        const int length = min(ENTRIES, entries - begin);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = item; k < PROJECTIONS * length; k += THREADS)
            FLOATS(weights)[k % length * (4 * FOURS) + k / length] = table[k / length * entries + begin + k % length];
        barrier(CLK_LOCAL_MEM_FENCE);
        _Pragma("unroll 4") for (int e = 0; e < length; ++e, at += frame) {
            const float here = at[0], right = at[to_right] - here, below = at[to_below] - here;
            _Pragma("unroll") for (int k = 0; k < FOURS; ++k) {
                const float4 four = weights[e * FOURS + k];
                _Pragma("unroll") for (int j = 0; j < 4; ++j) {
                    const int p = 4 * k + j;
                    if (p < PROJECTIONS) {
                        const float weight = j == 0 ? four.x : j == 1 ? four.y : j == 2 ? four.z : four.w;
                        own[p] += weight * here;
                        own[COUNT + p] += weight * right;
                        own[2 * COUNT + p] += weight * below;
                    }
                }
            }
            own[PROJECTIONS] += unit * here * (unit * here);
            own[COUNT + PROJECTIONS] += unit * right * (unit * right);
            own[2 * COUNT + PROJECTIONS] += unit * below * (unit * below);
        }
    }
    SQUARE_UP
    SUM_UP
}

__kernel void labelled_groups(
    // in:
    __global const ushort *restrict ids,     // [rows][cols]
    __global const float *restrict content,  // [rows][cols], shading
    __global const float *restrict table,    // [PROJECTIONS][entries]
    __global const int *restrict first,
    // out:
    __global float *restrict parts,          // [pairs][chunks][3][COUNT]
    // sizes:
    const int entries, const int rows, const int cols, const int chunks, const float unit)
{
    __local float memory[3 * COUNT * APART];
    const int item = get_local_id(0), x = get_group_id(0) % chunks * THREADS + item;
    const int y = min(max(first[get_group_id(0) / chunks], 0), rows - 1), column = min(x, cols - 1);
    const size_t at = (size_t)y * cols + column;
    const size_t right = column + 1 < cols ? at + 1 : at, below = y + 1 < rows ? at + cols : at;
    const int id = ids[at], id_right = ids[right], id_below = ids[below];
    const float here = content[at], to_right = content[right] - here, to_below = content[below] - here;
    float own[3 * COUNT];
    _Pragma("unroll") for (int p = 0; p < PROJECTIONS; ++p) {
        __global const float *row = table + (size_t)p * entries;
        const float weight = row[id];
        own[p] = weight * here;
        // samples of one entry have the difference without cancellation
        own[COUNT + p] = id_right == id ? weight * to_right : row[id_right] * content[right] - weight * here;
        own[2 * COUNT + p] = id_below == id ? weight * to_below : row[id_below] * content[below] - weight * here;
    }
    const float value = unit * here, its_right = unit * content[right], its_below = unit * content[below];
    const float step = unit * to_right, fall = unit * to_below;
    own[PROJECTIONS] = value * value;
    own[COUNT + PROJECTIONS] = id_right == id ? step * step : value * value + its_right * its_right;
    own[2 * COUNT + PROJECTIONS] = id_below == id ? fall * fall : value * value + its_below * its_below;
    SQUARE_UP
    SUM_UP
}

// The parts of a row, from the left.
__kernel void finish(
    // in:
    __global const float *restrict parts,  // [pairs][chunks][3][COUNT]
    // out:
    __global float *restrict out,          // [pairs][3][COUNT]
    // sizes:
    const int items, const int chunks, const int cols)
{
    const int i = get_group_id(0) * THREADS + get_local_id(0);
    if (i >= items) return;
    const int pair = i / (3 * COUNT), q = i % (3 * COUNT), steps = cols > 1 ? cols - 1 : 1;
    __global const float *from = parts + (size_t)pair * chunks * (3 * COUNT) + q;
    float sum = 0.0f;
    for (int j = 0; j < chunks; ++j) sum += from[(size_t)j * (3 * COUNT)];
    out[i] = sum / (float)(q / COUNT == 1 ? steps : cols);
}
