// Weighted spectra, folded as the mosaic samples them; the transforms are elsewhere (common/fft.py).
// SIZE, CHANNELS, PERIOD_Y, PERIOD_X and CFA, the channel of each phase of the period, come from the host, and COMPLEX:
// tables are halves of complex values.

float2 times(const float2 a, const float2 b) { return (float2)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x); }

__kernel void fold(
    // in:
    __global const float2 *restrict spectra,  // [SIZE][rows * PERIOD_Y][pitch]
    __global const float *restrict tables,    // [1 or CHANNELS][count][rows * PERIOD_Y / 2 + 1][cols * PERIOD_X / 2 + 1]
                                              // or [1 or CHANNELS][count][rows * PERIOD_Y][cols * PERIOD_X / 2 + 1][2]
    __constant float *mix,                    // [CHANNELS][SIZE]
    __global const float2 *restrict turns_y,  // [rows * PERIOD_Y][PERIOD_Y]
    __global const float2 *restrict turns_x,  // [cols * PERIOD_X][PERIOD_X]
    // out:
    __global float2 *restrict folded,         // [PERIOD_Y * PERIOD_X][rows][out_pitch]
    // params:
    const int is_first, const int first, const int count, const int own_tables,
    // sizes:
    const int rows, const int cols, const int half_x, const int pitch, const int out_pitch)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= half_x || y >= rows)
    const int cfa[] = {CFA};
    const int period_y = rows * PERIOD_Y, period_x = cols * PERIOD_X, table_pitch = period_x / 2 + 1;
    const size_t plane = (size_t)period_y * pitch, size = (size_t)(COMPLEX ? 2 * period_y : period_y / 2 + 1) * table_pitch;
    float2 sums[PERIOD_Y * PERIOD_X];
#pragma unroll
    for (int p = 0; p < PERIOD_Y * PERIOD_X; ++p)
        sums[p] = is_first ? (float2)(0.0f, 0.0f) : folded[((size_t)p * rows + y) * out_pitch + x];
#pragma unroll
    for (int a = 0; a < PERIOD_Y; ++a) {
        const int fy = y + a * rows;
#pragma unroll
        for (int b = 0; b < PERIOD_X; ++b) {
            const int fx = x + b * cols;
            // Columns beyond the half that is stored are the conjugates of the opposite frequency.
            const int mirrored = PERIOD_X > 1 && 2 * b >= PERIOD_X;
            const int column = mirrored ? period_x - fx : fx;
            const int row = mirrored && fy > 0 ? period_y - fy : fy;
            const size_t at = (size_t)row * pitch + column;
#if COMPLEX
            const size_t entry = 2 * ((size_t)row * table_pitch + column);
#else
            const size_t entry = (size_t)min(fy, period_y - fy) * table_pitch + column;
#endif
            float2 total[CHANNELS];
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) total[c] = (float2)(0.0f, 0.0f);
#pragma unroll
            for (int k = 0; k < SIZE; ++k) {
                const float2 value = spectra[k * plane + at];
#pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    __global const float *table = tables + ((own_tables * c * count + first + k) * size + entry);
#if COMPLEX
                    total[c] += mix[c * SIZE + k] * times((float2)(table[0], table[1]), value);
#else
                    total[c] += mix[c * SIZE + k] * table[0] * value;
#endif
                }
            }
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) total[c].y = mirrored ? -total[c].y : total[c].y;
#pragma unroll
            for (int dy = 0; dy < PERIOD_Y; ++dy)
#pragma unroll
                for (int dx = 0; dx < PERIOD_X; ++dx)
                    sums[dy * PERIOD_X + dx] += times(total[cfa[dy * PERIOD_X + dx]],
                                                      times(turns_y[fy * PERIOD_Y + dy], turns_x[fx * PERIOD_X + dx]));
        }
    }
#pragma unroll
    for (int p = 0; p < PERIOD_Y * PERIOD_X; ++p) folded[((size_t)p * rows + y) * out_pitch + x] = sums[p];
}

__kernel void interleave(
    // in:
    __global const float *restrict pixels,  // [PERIOD_Y * PERIOD_X][small_y][small_x]
    // out:
    __global float *restrict out,
    // params:
    const int start_y, const int start_x,
    // sizes:
    const int rows, const int cols, const int small_y, const int small_x)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const int v = y + start_y, u = x + start_x, phase = v % PERIOD_Y * PERIOD_X + u % PERIOD_X;
    out[y * cols + x] = pixels[((size_t)phase * small_y + v / PERIOD_Y) * small_x + u / PERIOD_X];
}
