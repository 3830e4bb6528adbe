// From the host: PIXEL (float or ushort), DIGITAL as 0 or 1, BINNING_X, STRIDE_X, and BLOCKS, 0 on a GPU.
// Sums of numbers are below 2^24, exact in float32. A mean is a half exactly or at least 1/98 from one (49 pixels), and
// the division moves it by 2^-9 at most, a half not at all. Adding 2^23 rounds to a whole number, halves to even; rint()
// does, too, but it keeps PoCL from vectorising.
#pragma OPENCL FP_CONTRACT OFF

#define MEAN(sum, pixels) ((sum) / (pixels) + 8388608.0f - 8388608.0f)
#define CUT(sum) ((sum) < 65535.0f ? (sum) : 65535.0f)
#define BLOCK_X (STRIDE_X * BINNING_X)

__kernel void bin(
    // in:
    __global const PIXEL *restrict pixels,  // [rows][cols]
    // out:
    __global PIXEL *restrict out,           // [out_rows][out_cols]
    // params:
    const int binning_y, const int stride_y, const int average,
    // sizes:
    const int cols, const int out_rows, const int out_cols)
{
    const int y = get_global_id(1);
    if (y >= out_rows) return;
    const size_t step = (size_t)stride_y * cols;
    __global const PIXEL *restrict top = pixels + (size_t)(y / stride_y * stride_y * binning_y + y % stride_y) * cols;
    __global PIXEL *restrict to = out + (size_t)y * out_cols;
    const float count = binning_y * BINNING_X;
#if BLOCKS
    // A row per work-item, some blocks at a time: columns are adjacent in memory, so whole vectors of them are added,
    // and the columns of one colour, which must be gathered, are in the nearest cache.
    float columns[BLOCKS * BLOCK_X], sums[BLOCKS * STRIDE_X];
    for (int first = 0; first < out_cols; first += BLOCKS * STRIDE_X) {
        const int length = min(BLOCKS * STRIDE_X, out_cols - first);
        __global const PIXEL *restrict from = top + first * BINNING_X;
        if (binning_y == 1)
            for (int i = 0; i < length * BINNING_X; ++i) columns[i] = from[i];
        else  // two rows in one pass over the columns: 15 % less time
            for (int i = 0; i < length * BINNING_X; ++i) columns[i] = (float)from[i] + (float)from[step + i];
        for (int j = 2; j < binning_y; ++j)
            for (int i = 0; i < length * BINNING_X; ++i) columns[i] += from[j * step + i];
        // the period of a wide mosaic fills a vector by itself; across its blocks LLVM would gather
#if STRIDE_X > 3
#pragma clang loop vectorize(disable)
#endif
        for (int b = 0; b < length / STRIDE_X; ++b)
#pragma unroll
            for (int a = 0; a < STRIDE_X; ++a) {
                float sum = columns[b * BLOCK_X + a];
#pragma unroll
                for (int i = 1; i < BINNING_X; ++i) sum += columns[b * BLOCK_X + a + i * STRIDE_X];
                sums[b * STRIDE_X + a] = sum;
            }
#if DIGITAL
        if (average)
            for (int i = 0; i < length; ++i) sums[i] = MEAN(sums[i], count);
        for (int i = 0; i < length; ++i) to[first + i] = (PIXEL)CUT(sums[i]);
#else
        for (int i = 0; i < length; ++i) to[first + i] = sums[i];
#endif
    }
#else
    const int x = get_global_id(0);
    if (x >= out_cols) return;
    top += x / STRIDE_X * BLOCK_X + x % STRIDE_X;
    float total = 0.0f;
#pragma unroll
    for (int i = 0; i < BINNING_X; ++i) {
        float column = top[i * STRIDE_X];
        for (int j = 1; j < binning_y; ++j) column += top[j * step + i * STRIDE_X];
        total = i ? total + column : column;
    }
#if DIGITAL
    to[x] = (PIXEL)CUT(average ? MEAN(total, count) : total);
#else
    to[x] = total;
#endif
#endif
}
