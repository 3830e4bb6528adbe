// One sample per work-item. float16 in memory is core OpenCL: no extension is needed to load it.
__kernel void widen(
    // in:
    __global const half *restrict content,  // [entries][rows][cols]
    __global const int *restrict chosen,    // [count]
    // out:
    __global float *restrict out,           // [entries][count][cols]
    // sizes:
    const int lines, const int count, const int rows, const int cols)
{
    const int x = get_global_id(0), line = get_global_id(1);
    GUARD(line >= lines || x >= cols)
    const int entry = line / count, y = clamp(chosen[line % count], 0, rows - 1);
    out[(size_t)line * cols + x] = vload_half(((size_t)entry * rows + y) * cols + x, content);
}
