// One sample per work-item; neighbours are adjacent if a window's columns are, and always in the result. WHOLE_ROWS:
// from the host, whether columns are in their order and not looked up. float16 in memory is core OpenCL: no extension
// is needed to load it.
#if WHOLE_ROWS
#define COLUMN x
#else
#define COLUMN clamp(chosen_cols[line / height * width + x], 0, cols - 1)
#endif

// The places that a work-item reads and writes.
#define PLACES \
    const int x = get_global_id(0), line = get_global_id(1), entry = get_global_id(2); \
    GUARD(x >= width || line >= lines || entry >= entries) \
    const size_t from = ((size_t)entry * rows + clamp(chosen_rows[line], 0, rows - 1)) * cols + COLUMN; \
    const size_t to = (((size_t)(line / height) * entries + entry) * height + line % height) * width + x;

__kernel void take(
    // in:
    __global const float *restrict content,   // [entries][rows][cols]
    __global const int *restrict chosen_rows, // [windows][height]
    __global const int *restrict chosen_cols, // [windows][width]
    // out:
    __global float *restrict out,             // [windows][entries][height][width]
    // sizes:
    const int entries, const int rows, const int cols, const int lines, const int height, const int width)
{
    PLACES
    out[to] = content[from];
}

__kernel void take_half(
    // in:
    __global const half *restrict content,    // [entries][rows][cols]
    __global const int *restrict chosen_rows, // [windows][height]
    __global const int *restrict chosen_cols, // [windows][width]
    // out:
    __global float *restrict out,             // [windows][entries][height][width]
    // sizes:
    const int entries, const int rows, const int cols, const int lines, const int height, const int width)
{
    PLACES
    out[to] = vload_half(from, content);
}

__kernel void take_numbers(
    // in:
    __global const ushort *restrict content,  // [entries][rows][cols]
    __global const int *restrict chosen_rows, // [windows][height]
    __global const int *restrict chosen_cols, // [windows][width]
    // out:
    __global ushort *restrict out,            // [windows][entries][height][width]
    // sizes:
    const int entries, const int rows, const int cols, const int lines, const int height, const int width)
{
    PLACES
    out[to] = content[from];
}
