// denoise.py has the formulas. A work-item of `denoise` makes BAND rows of CHUNK columns: 64 on CPUs, eight by eight, 1
// on GPUs. It makes SPARE more columns of its sums; four are needed. Opposite and mirrored displacements are added
// first, and nothing is contracted: a mirrored mosaic then gives the mirrored result bit for bit. Columns are 64-bit:
// see bayer.clh.
#pragma OPENCL FP_CONTRACT OFF

#if CHUNK == 1
#define WIDTH 1
#define COLUMNS _Pragma("unroll")
typedef float real;
#define TWINS(first, second) (first)
#define LOAD(from) (*(from))
#define STORE(value, to) *(to) = (value)
#else
#define WIDTH 8
#define COLUMNS _Pragma("nounroll")  // no faster unrolled, but built in seconds
typedef float8 real;
#define TWINS(first, second) (float8)(first, second, first, second, first, second, first, second)
#define LOAD(from) vload8(0, from)
#define STORE(value, to) vstore8(value, 0, to)
#endif

// Index outside 0 .. size - 1 moved inside by whole periods.
inline int moved_inside(const int i, const int size, const int period)
{
    if (i < 0) return i + (period - 1 - i) / period * period;
    return i < size ? i : i - ((i - size) / period + 1) * period;
}

inline float stable(const ushort number, const float black_level, const float gain, const float constant_part,
                    const float lowest, const float root)
{
    const float d = fmax((float)number - black_level, lowest);
    return 2.0f * d / (sqrt(fmax(gain * d + constant_part, 0.0f)) + root);
}

// Squared difference of a pixel, or several, and that displaced by `offset`.
inline real square_at(__global const float *restrict at, const long offset)
{
    const real difference = LOAD(at) - LOAD(at + offset);
    return difference * difference;
}

inline real weight_of(const real total, const float most, const float per_square)
{
    const real soft = most - per_square * total, above = soft > 0.0f ? soft : (real)0.0f;
    const real root = above < 1.0f ? above : (real)1.0f;
    return root * root;
}

__kernel void stabilise(
    // in:
    __global const ushort *restrict raw,  // [rows][cols]
    // out:
    __global float *restrict code,        // [code_rows][code_cols], the frame margin_y, margin_x from its corner
    // params:
    const float black_level, const float gain, const float constant_part, const float lowest,
    // sizes:
    const int period_y, const int period_x, const int margin_y, const int margin_x, const int rows, const int cols,
    const int code_rows, const int code_cols)
{
    const int y = get_global_id(1);
    const float root = sqrt(constant_part);
#if CHUNK == 1
    const int x = get_global_id(0);
    GUARD(y >= code_rows || x >= code_cols)
    const long from = (long)moved_inside(y - margin_y, rows, period_y) * cols;
    code[(long)y * code_cols + x] = stable(raw[from + moved_inside(x - margin_x, cols, period_x)], black_level, gain,
                                           constant_part, lowest, root);
#else
    __global const ushort *from = raw + (long)moved_inside(y - margin_y, rows, period_y) * cols;
    __global float *to = code + (long)y * code_cols + margin_x;
    for (long x = 0; x < cols; ++x) to[x] = stable(from[x], black_level, gain, constant_part, lowest, root);
    for (long x = -margin_x; x < 0; ++x) to[x] = to[moved_inside(x, cols, period_x)];
    for (long x = cols; x < code_cols - margin_x; ++x) to[x] = to[moved_inside(x, cols, period_x)];
#endif
}

// Weights of the pixels displaced by `offset`, for BAND x CHUNK pixels from `here` on.
inline void weigh(__global const float *restrict here, const long offset, const long stride, const float most,
                  const float per_square, real weight[BAND][CHUNK / WIDTH])
{
    float sums[BAND][CHUNK + SPARE];  // of squared differences in three rows, from the column left of `here` on
    COLUMNS
    for (int i = 0; i < CHUNK + SPARE; i += WIDTH) {
        real square[BAND + 2];
#pragma unroll
        for (int r = 0; r < BAND + 2; ++r) square[r] = square_at(here + (r - 1) * stride + i - 1, offset);
#pragma unroll
        for (int r = 0; r < BAND; ++r) STORE((square[r] + square[r + 2]) + square[r + 1], &sums[r][i]);
    }
#pragma unroll
    for (int r = 0; r < BAND; ++r)
        COLUMNS
        for (int i = 0; i < CHUNK; i += WIDTH)
            weight[r][i / WIDTH] = weight_of((LOAD(&sums[r][i]) + LOAD(&sums[r][i + 2])) + LOAD(&sums[r][i + 1]), most,
                                             per_square);
}

// The same by patches of the nine pixels next to one another on diagonals.
inline void weigh_twins(__global const float *restrict here, const long offset, const long stride, const float most,
                        const float per_square, real weight[BAND][CHUNK / WIDTH])
{
    float squares[BAND + 4][CHUNK + SPARE];  // of differences, from two rows and columns before `here` on
#pragma unroll
    for (int r = 0; r < BAND + 4; ++r)
        COLUMNS
        for (int i = 0; i < CHUNK + SPARE; i += WIDTH)
            STORE(square_at(here + (r - 2) * stride + i - 2, offset), &squares[r][i]);
#pragma unroll
    for (int r = 0; r < BAND; ++r)
        COLUMNS
        for (int i = 0; i < CHUNK; i += WIDTH) {
#define AT(down, right) LOAD(&squares[r + 2 + (down)][i + 2 + (right)])
            const real corners = (AT(-1, -1) + AT(1, 1)) + (AT(-1, 1) + AT(1, -1));
            const real ends = (AT(-2, 0) + AT(2, 0)) + (AT(0, -2) + AT(0, 2));
            weight[r][i / WIDTH] = weight_of((corners + ends) + AT(0, 0), most, per_square);
#undef AT
        }
}

__kernel void denoise(
    // in:
    __global const float *restrict code,  // [..][stride]
    // out:
    __global ushort *restrict out,        // [rows][cols]
    // params:
    const float most, const float per_square, const float quarter_gain, const float root, const float scale,
    const float new_black,
    const float even_twins, const float odd_twins,  // most a diagonal neighbour weighs where x + y is even, odd
    // sizes:
    const int period_y, const int period_x, const int margin_y, const int margin_x, const int rows, const int cols,
    const int stride)
{
    const long x = (long)get_global_id(0) * CHUNK, y = (long)get_global_id(1) * BAND;
    GUARD(x >= cols || y >= rows)
    __global const float *here = code + (y + margin_y) * stride + x + margin_x;
    real mean[BAND][CHUNK / WIDTH], count[BAND][CHUNK / WIDTH];
#define EACH                                   \
    _Pragma("unroll") for (int r = 0; r < BAND; ++r) \
    COLUMNS for (int i = 0; i < CHUNK / WIDTH; ++i)
#define THERE(offset) LOAD(here + r * (long)stride + i * WIDTH + (offset))
    EACH {
        mean[r][i] = THERE(0);
        count[r][i] = 1.0f;
    }
    for (int step = 1; step < 9; ++step) {
        const long down = (long)(step / 3) * period_y * stride, right = (long)(step % 3) * period_x;
        real first[BAND][CHUNK / WIDTH], second[BAND][CHUNK / WIDTH];
        weigh(here, down + right, stride, most, per_square, first);
        weigh(here, -down - right, stride, most, per_square, second);
        if (down == 0 || right == 0) {
            EACH {
                mean[r][i] += first[r][i] * THERE(down + right) + second[r][i] * THERE(-down - right);
                count[r][i] += first[r][i] + second[r][i];
            }
        } else {
            real third[BAND][CHUNK / WIDTH], fourth[BAND][CHUNK / WIDTH];
            weigh(here, down - right, stride, most, per_square, third);
            weigh(here, right - down, stride, most, per_square, fourth);
            EACH {
                mean[r][i] += (first[r][i] * THERE(down + right) + second[r][i] * THERE(-down - right))
                              + (third[r][i] * THERE(down - right) + fourth[r][i] * THERE(right - down));
                count[r][i] += (first[r][i] + second[r][i]) + (third[r][i] + fourth[r][i]);
            }
        }
    }
    const bool has_twins = even_twins > 0.0f || odd_twins > 0.0f;
    real twin_sum[BAND][CHUNK / WIDTH], twin_count[BAND][CHUNK / WIDTH];
    EACH twin_sum[r][i] = twin_count[r][i] = 0.0f;
    for (int step = 0; has_twins && step < 4; ++step) {
        const long down = (1 + step / 2 * 2) * stride, right = 1 + step % 2 * 2;
        real first[BAND][CHUNK / WIDTH], second[BAND][CHUNK / WIDTH], third[BAND][CHUNK / WIDTH],
            fourth[BAND][CHUNK / WIDTH];
        weigh_twins(here, down + right, stride, most, per_square, first);
        weigh_twins(here, -down - right, stride, most, per_square, second);
        weigh_twins(here, down - right, stride, most, per_square, third);
        weigh_twins(here, right - down, stride, most, per_square, fourth);
        EACH {
            twin_sum[r][i] += (first[r][i] * THERE(down + right) + second[r][i] * THERE(-down - right))
                              + (third[r][i] * THERE(down - right) + fourth[r][i] * THERE(right - down));
            twin_count[r][i] += (first[r][i] + second[r][i]) + (third[r][i] + fourth[r][i]);
        }
    }
    if (has_twins)
        EACH {
            const bool is_odd = (x + y + r) & 1;  // of the first of WIDTH columns
            const real most_twin = TWINS(is_odd ? odd_twins : even_twins, is_odd ? even_twins : odd_twins);
            const real share = fmin(most_twin, count[r][i] / fmax(twin_count[r][i], 1e-6f));
            mean[r][i] += share * twin_sum[r][i];
            count[r][i] += share * twin_count[r][i];
        }
    EACH {
        const real inverse = 1.0f / count[r][i], u = mean[r][i] * inverse;
        const real d = (quarter_gain * u + root) * u + quarter_gain * (1.0f - inverse);
        mean[r][i] = fmin(fmax(d * scale + new_black, 0.0f), 65535.0f) + 0.5f;
    }
#undef EACH
    const int lanes = min((long)CHUNK, cols - x);
    for (int r = 0; r < BAND && y + r < rows; ++r)
        for (int i = 0; i < lanes; ++i) out[(y + r) * cols + x + i] = (ushort)(int)((float *)mean[r])[i];
}
