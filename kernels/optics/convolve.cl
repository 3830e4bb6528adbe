// Direct convolution of planes by tables of coefficients table[v][j][r] = coefficient (v - r, j), zero where there is
// none, so that one value read goes into the sums of ROWS rows.

#ifdef WIDTH
#define JOIN(a, b) a##b
#define LOAD(width, p) JOIN(vload, width)(0, p)
#define STORE(width, value, p) JOIN(vstore, width)(value, 0, p)

// Row v of the source into the sums FROM .. TO
#define ROW(v, FROM, TO) do { \
    __global const float *source = corner + (size_t)(v) * pitch; \
    __global const float *factor = coefficients + (size_t)(v) * taps_x * ROWS; \
    for (int j = 0; j < taps_x; ++j, factor += ROWS) { \
        VECTOR values[BLOCK]; \
        _Pragma("unroll") for (int b = 0; b < BLOCK; ++b) values[b] = LOAD(WIDTH, source + j + b * WIDTH); \
        _Pragma("unroll") for (int r = FROM; r <= TO; ++r) \
            _Pragma("unroll") for (int b = 0; b < BLOCK; ++b) sums[r][b] = factor[r] * values[b] + sums[r][b]; \
    } } while (0)

// CPU: a work-item is ROWS rows, ROWS x (BLOCK x WIDTH) sums at a time in registers. The first and the last
// ROWS - 1 source rows go into some of the sums only. Away from the frame's edges the planes themselves are read.
__kernel void direct(
    // in:
    __global const float *restrict planes,    // [count][rows][cols]
    __global const float *restrict extended,  // [count][period_y][period_x]
    __global const float *restrict table,      // [1 or count][taps_y + ROWS - 1][taps_x][ROWS]
    // out:
    __global float *restrict out,             // [count][rows][cols]
    // params:
    const int own, const int before_y, const int before_x,
    // sizes:
    const int count, const int taps_y, const int taps_x, const int rows, const int cols, const int period_y,
    const int period_x)
{
    const int y = get_global_id(0) * ROWS, k = get_global_id(1);
    __global const float *coefficients = table + (size_t)(own * k) * (taps_y + ROWS - 1) * taps_x * ROWS;
    const int within = y >= before_y && y + ROWS + taps_y - 1 - before_y <= rows;
    for (int x = 0; x < cols; x += BLOCK * WIDTH) {
        const int straight = within && x >= before_x && x + BLOCK * WIDTH + taps_x - 1 - before_x <= cols;
        const int pitch = straight ? cols : period_x;
        __global const float *corner = straight ? planes + ((size_t)k * rows + y - before_y) * cols + x - before_x
                                                : extended + ((size_t)k * period_y + y) * period_x + x;
        VECTOR sums[ROWS][BLOCK];
#pragma unroll
        for (int r = 0; r < ROWS; ++r)
#pragma unroll
            for (int b = 0; b < BLOCK; ++b) sums[r][b] = 0;
#pragma unroll
        for (int v = 0; v < ROWS - 1; ++v) ROW(v, 0, v);
        for (int v = ROWS - 1; v < taps_y; ++v) ROW(v, 0, ROWS - 1);
#pragma unroll
        for (int v = 0; v < ROWS - 1; ++v) ROW(taps_y + v, v + 1, ROWS - 1);
#pragma unroll
        for (int r = 0; r < ROWS; ++r) {
            if (y + r < rows) {
                __global float *target = out + ((size_t)k * rows + y + r) * cols + x;
#pragma unroll
                for (int b = 0; b < BLOCK; ++b) {
                    if (x + (b + 1) * WIDTH <= cols) {
                        STORE(WIDTH, sums[r][b], target + b * WIDTH);
                    } else {
                        float last[WIDTH];
                        STORE(WIDTH, sums[r][b], last);
                        for (int i = 0; x + b * WIDTH + i < cols; ++i) target[b * WIDTH + i] = last[i];
                    }
                }
            }
        }
    }
}
#endif

#ifdef ROWS
#ifdef GPU
#define LOCAL_ROWS (GROUP_Y * ROWS + PART_Y - 1)
#define LOCAL_COLS (GROUP_X + PART_X - 1)

// GPU: a group makes GROUP_Y * ROWS x GROUP_X pixels, a thread ROWS of one column; a part of the kernel at a time, with
// the values that it meets, lies in local memory.
__kernel void direct(
    // in:
    __global const float *restrict extended,  // [count][period_y][period_x]
    __global const REAL *restrict table,      // [1 or count][taps_y][taps_x], whole parts
    // out:
    __global float *restrict out,             // [count][rows][cols]
    // params:
    const int own,
    // sizes:
    const int count, const int taps_y, const int taps_x, const int rows, const int cols, const int period_y,
    const int period_x)
{
    __local REAL values[LOCAL_ROWS][LOCAL_COLS], factors[PART_Y][PART_X];
    const int tx = get_local_id(0), ty = get_local_id(1), k = get_global_id(2), thread = ty * GROUP_X + tx;
    const int left = get_group_id(0) * GROUP_X, top = get_group_id(1) * GROUP_Y * ROWS;
    REAL sums[ROWS];
#pragma unroll
    for (int r = 0; r < ROWS; ++r) sums[r] = 0;
    for (int i = 0; i < taps_y; i += PART_Y)
        for (int j = 0; j < taps_x; j += PART_X) {
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int n = thread; n < LOCAL_ROWS * LOCAL_COLS; n += GROUP_Y * GROUP_X) {
                const int y = n / LOCAL_COLS, x = n % LOCAL_COLS;
                values[y][x] = extended[((size_t)k * period_y + top + i + y) * period_x + left + j + x];
            }
            for (int n = thread; n < PART_Y * PART_X; n += GROUP_Y * GROUP_X)
                factors[n / PART_X][n % PART_X] =
                    table[((size_t)(own * k) * taps_y + i + n / PART_X) * taps_x + j + n % PART_X];
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int b = 0; b < PART_X; ++b) {
#pragma unroll
                for (int v = 0; v < PART_Y + ROWS - 1; ++v) {
                    const REAL value = values[ty * ROWS + v][tx + b];
#pragma unroll
                    for (int r = 0; r < ROWS; ++r)
                        if (v - r >= 0 && v - r < PART_Y) sums[r] += factors[v - r][b] * value;
                }
            }
        }
    const int x = left + tx;
    if (x >= cols) return;
#pragma unroll
    for (int r = 0; r < ROWS; ++r) {
        const int y = top + ty * ROWS + r;
        if (y < rows) out[((size_t)k * rows + y) * cols + x] = sums[r];
    }
}
#endif
#endif
