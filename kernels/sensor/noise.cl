// From mean electrons to digital numbers, WIDTH pixels per work-item. noise_ref.py has the formulas.
// From the host: WIDTH, PHOTON (0 none, 1 fast, 2 exact), and as 0 or 1 READ_NOISE, OFFSET,
// TELEGRAPH, LINES, CONVERTER.
#if PHOTON == 2
#define DOUBLE
#endif
#include "philox.clh"
#include "poisson.clh"

#if CONVERTER
#define OUT ushort
#else
#define OUT float
#endif
#define MOST_EXPECTED 1e30f
#define TEMPORAL 0u
#define TELEGRAPH_STREAM 4u
#define ROW_STREAM 5u
#define COLUMN_STREAM 6u

#if TELEGRAPH
// State of a pixel's trap, 0 or 1, from the last frame in which it was drawn. Four frames share a call of Philox: a
// GPU's time is the longest chain of calls.
INLINE real trap_state(const word pixel, const integer traps, const uint frame, const uint switching,
                       const uint seed_low, const uint seed_high)
{
    real state = 0.0f;
    integer open = traps;
    for (uint four = frame >> 2;; --four) {
        const Words words = philox(pixel, 0u, four, TELEGRAPH_STREAM, seed_low, seed_high);
        const word each[4] = {words.a, words.b, words.c, words.d};
#pragma unroll
        for (int i = 3; i >= 0; --i) {
            const uint at = 4u * four + i;
            if (at > frame) continue;
            const integer drawn = at == 0u ? open : open & ((each[i] >> 1) <= switching);
            state = drawn ? ((each[i] & 1u) != 0u ? (real)1.0f : (real)0.0f) : state;
            open = open & ~drawn;
        }
        if (!ANY(open)) return state;
    }
}
#endif

__kernel void noise(
    // in:
    __global const float *restrict expected,   // [rows][cols]
    __global const float *restrict offset,     // [rows][cols], if OFFSET
    __global const float *restrict amplitude,  // [rows][cols], if TELEGRAPH
    __global const float *restrict lines,      // [frames][rows + cols], if LINES
    // out:
    __global OUT *restrict out,                // [frames][rows][cols]
    // sizes and numbers:
    const int rows, const int cols, const int first_pixel, const int frame_cols, const int switching,
    const float full_well, const float white_level, const int read,
    // numbers by name, which may change from frame to frame:
    const float dark_electrons, const float read_noise, const float gain, const float black_level,
    const int seed_low, const int seed_high, const int first_frame)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), number = get_global_id(2);
    const int lanes = min(WIDTH, cols - x), start = y * cols + x;
    if (lanes <= 0 || y >= rows) return;
    const uint frame = (uint)first_frame + number;
    const word pixel = (uint)first_pixel + (uint)y * (uint)frame_cols + (uint)x + FIRST_LANES;
#if PHOTON == 1 || READ_NOISE || PHOTON == 2
    const Words words = philox(pixel, read, frame, TEMPORAL, seed_low, seed_high);
#endif
#if PHOTON == 1 || READ_NOISE
    const Normals z = exact_normal_pair(words.a, words.b);
#endif
    real electrons = load(expected + start, lanes);
    electrons = electrons > MOST_EXPECTED ? (real)MOST_EXPECTED : electrons;
    electrons = (electrons < 0.0f ? (real)0.0f : electrons) + dark_electrons;
#if PHOTON == 1
    electrons = poisson(electrons, words.c, words.d, z.first);
#elif PHOTON == 2
    electrons = poisson_exact(electrons, words.c, words.d);
#endif
    electrons = electrons > full_well ? (real)full_well : electrons;
#if READ_NOISE
    electrons = electrons + read_noise * z.second;
#endif
#if OFFSET
    electrons = electrons + load(offset + start, lanes);
#endif
#if TELEGRAPH
    const real trap = load(amplitude + start, lanes);
    const integer traps = trap > 0.0f;
    if (ANY(traps)) {
        const real moved = electrons + trap * trap_state(pixel, traps, frame, switching, seed_low, seed_high);
        electrons = traps ? moved : electrons;
    }
#endif
#if LINES
    const int line = number * (rows + cols);
    electrons = electrons + lines[line + y];
    electrons = electrons + load(lines + line + rows + x, lanes);
#endif
    real level = gain * electrons + black_level;
#if CONVERTER
    level = level > 0.0f ? level : (real)0.0f;  // NaN too
    level = rint(level < white_level ? level : (real)white_level);
#endif
    __global OUT *restrict to = out + ((size_t)number * rows + y) * cols + x;
#if CONVERTER
    STORE(ushort, level, to, lanes)
#else
    STORE(float, level, to, lanes)
#endif
}

// What every row and every column of a frame have in common: rows first.
__kernel void lines(
    // out:
    __global float *restrict out,  // [frames][rows + cols]
    // sizes and numbers:
    const int frames, const int rows, const int cols, const int first_row, const int first_col, const float row_noise,
    const float column_noise, const int read,
    // numbers by name:
    const int seed_low, const int seed_high, const int first_frame)
{
    const int row_items = (rows + WIDTH - 1) / WIDTH, item = get_global_id(0), number = get_global_id(1);
    const bool down = item < row_items;
    const int start = (down ? item : item - row_items) * WIDTH, lanes = min(WIDTH, (down ? rows : cols) - start);
    if (lanes <= 0 || number >= frames) return;
    const word line = (uint)((down ? first_row : first_col) + start) + FIRST_LANES;
    const Words words = philox(line, read, (uint)first_frame + number, down ? ROW_STREAM : COLUMN_STREAM, seed_low,
                               seed_high);
    const real result = (down ? row_noise : column_noise) * exact_normal_pair(words.a, words.b).first;
    __global float *restrict to = out + number * (rows + cols) + (down ? 0 : rows) + start;
    STORE(float, result, to, lanes)
}
