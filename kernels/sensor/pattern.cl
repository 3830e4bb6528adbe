// Fixed patterns of one chip, WIDTH pixels per work-item. pattern_ref.py has the formulas.
#include "philox.clh"
#include "exact.clh"

#define PIXEL 1u
#define ROW 2u
#define COLUMN 3u

__kernel void pattern(
    // out:
    __global float *restrict out,  // [rows][cols]
    // sizes and numbers:
    const int rows, const int cols, const int first_row, const int first_col, const int frame_cols, const int plane,
    const float mean, const float per_pixel, const float per_row, const float per_column, const int some_dead,
    const int dead, const int some_chosen, const int share, const float scale, const int seed_low, const int seed_high)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), lanes = min(WIDTH, cols - x);
    if (lanes <= 0 || y >= rows) return;
    const word row = (uint)(first_row + y), column = (uint)(first_col + x) + FIRST_LANES;
    const word place = row * (uint)frame_cols + column;
    const Words words = philox(place, plane, 0u, PIXEL, seed_low, seed_high);
    const Words of_row = philox(row, plane, 0u, ROW, seed_low, seed_high);
    const Words of_column = philox(column, plane, 0u, COLUMN, seed_low, seed_high);
    real value = mean + per_pixel * exact_normal_pair(words.a, words.b).first;
    value = value + per_row * exact_normal_pair(of_row.a, of_row.b).first;
    value = value + per_column * exact_normal_pair(of_column.a, of_column.b).first;
    if (some_dead) value = words.c <= (uint)dead ? (real)0.0f : value;
    if (some_chosen) {
        const real more = scale * -exact_log((TO_REAL(words.d) + 0.5f) * 0x1p-32f);
        value = philox(place, plane, 1u, PIXEL, seed_low, seed_high).a <= (uint)share ? value + more : value;
    }
    STORE(float, value, out + y * cols + x, lanes)
}
