// Tiles where neither vectors nor local memory hold them: cut out, transformed by common/fft.py, folded, put together.
#include "border.clh"

float2 times(const float2 a, const float2 b) { return (float2)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x); }

__kernel void cut(
    // in:
    __global const float *restrict planes,  // [count][rows][cols]
    // out:
    __global float *restrict parts,         // [tiles][count][side][side]
    // params:
    const int border, const int first, const int valid, const int before,
    // sizes:
    const int all_parts, const int count, const int rows, const int cols, const int side, const int across)
{
    const int x = get_global_id(0), y = get_global_id(1), part = get_global_id(2);
    GUARD(x >= side || y >= side || part >= all_parts)
    const int tile = first + part / count, v = tile / across * valid - before + y, u = tile % across * valid - before + x;
    const int dark = border == 0 && (v < 0 || v >= rows || u < 0 || u >= cols);
    const size_t row = (size_t)(part % count) * rows + inside(v, rows, border);
    parts[((size_t)part * side + y) * side + x] = dark ? 0.0f : planes[row * cols + inside(u, cols, border)];
}

__kernel void fold(
    // in:
    __global const float2 *restrict spectra,  // [tiles][count][side][pitch]
    __global const float *restrict tables,    // [1 or channels][count][side / 2 + 1][side / 2 + 1]
    __global const float *restrict mix,       // [channels][count]
    __global const float2 *restrict roots,    // [side]
    __global const int *restrict of,          // [outputs]
    // out:
    __global float2 *restrict folded,         // [tiles][outputs][side / phases_y][out_pitch]
    // params:
    const int own_tables,
    // sizes:
    const int tiles, const int count, const int channels, const int outputs, const int phases_y, const int phases_x,
    const int side, const int pitch, const int out_pitch)
{
    const int rows = side / phases_y, cols = side / phases_x, quarter = side / 2 + 1;
    const int x = get_global_id(0), y = get_global_id(1), tile = get_global_id(2);
    GUARD(x > cols / 2 || y >= rows || tile >= tiles)
    for (int o = 0; o < outputs; ++o) folded[((size_t)(tile * outputs + o) * rows + y) * out_pitch + x] = 0.0f;
    for (int a = 0; a < phases_y; ++a)
        for (int b = 0; b < phases_x; ++b) {
            // columns beyond the half that is stored are the conjugates of the opposite frequency
            const int fy = y + a * rows, fx = x + b * cols, mirrored = 2 * fx > side;
            const int row = mirrored ? (side - fy) % side : fy, column = mirrored ? side - fx : fx;
            for (int c = 0; c < channels; ++c) {
                float2 total = 0.0f;
                for (int k = 0; k < count; ++k) {
                    const int entry = ((own_tables * c * count + k) * quarter + min(fy, side - fy)) * quarter + column;
                    total += mix[c * count + k] * tables[entry]
                             * spectra[((size_t)(tile * count + k) * side + row) * pitch + column];
                }
                total.y = mirrored ? -total.y : total.y;
                for (int o = 0; o < outputs; ++o)
                    if (of[o] == c) {
                        const int is_mosaic = phases_y * phases_x > 1;
                        const int dy = is_mosaic ? o / phases_x : 0, dx = is_mosaic ? o % phases_x : 0;
                        folded[((size_t)(tile * outputs + o) * rows + y) * out_pitch + x] +=
                            times(total, times(roots[fy * dy % side], roots[fx * dx % side]));
                    }
            }
        }
}

__kernel void place(
    // in:
    __global const float *restrict pixels,  // [tiles][outputs][side / phases_y][side / phases_x]
    // out:
    __global float *restrict out,           // [images][out_rows][out_cols]
    // params:
    const int first, const int valid, const int overlap, const float scale,
    // sizes:
    const int parts, const int images, const int outputs, const int out_rows, const int out_cols, const int phases_y,
    const int phases_x, const int side, const int across)
{
    const int u = get_global_id(0), v = get_global_id(1), part = get_global_id(2);
    GUARD(u >= valid || v >= valid || part >= parts)
    const int tile = first + part / images, image = part % images;
    const int y = tile / across * valid + v, x = tile % across * valid + u;
    if (y < out_rows && x < out_cols) {
        const int fy = v + overlap, fx = u + overlap, rows = side / phases_y, cols = side / phases_x;
        const int o = images == 1 && phases_y * phases_x > 1 ? fy % phases_y * phases_x + fx % phases_x : image;
        const size_t at = ((size_t)(part / images * outputs + o) * rows + fy / phases_y) * cols + fx / phases_x;
        out[((size_t)image * out_rows + y) * out_cols + x] = scale * pixels[at];
    }
}
