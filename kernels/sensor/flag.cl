// One pixel of the map per work-item. The bits of dark currents are compared as numbers of 32 bits: positive floats are
// ordered as their bits, and denormals count even if the device treats them as 0.

inline int ordered(const float value)
{
    const int bits = as_int(value);
    return bits < 0 ? (int)0x80000000 - bits : bits;
}

__kernel void flag(
    // in:
    __global const float *restrict response,  // [rows][cols], if use_response
    __global const float *restrict dark,      // [rows][cols], if use_dark
    // out:
    __global uchar *restrict flags,           // [out_rows][out_cols]
    // params:
    const int use_response, const int use_dark, const float least, const int binning_y, const int binning_x,
    const int stride_y, const int stride_x,
    // sizes:
    const int cols, const int out_rows, const int out_cols)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(y >= out_rows || x >= out_cols)
    const int top = y / stride_y * stride_y * binning_y + y % stride_y;
    const int left = x / stride_x * stride_x * binning_x + x % stride_x;
    bool is_defect = false;
    for (int j = 0; j < binning_y; ++j)
        for (int i = 0; i < binning_x; ++i) {
            const size_t at = (size_t)(top + j * stride_y) * cols + left + i * stride_x;
            if (use_response) is_defect |= (as_int(response[at]) & 0x7fffffff) == 0;
            if (use_dark) is_defect |= !isnan(dark[at]) && ordered(dark[at]) > ordered(least);
        }
    flags[(size_t)y * out_cols + x] = is_defect ? 255 : 0;
}
