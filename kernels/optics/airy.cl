// One frequency of one band per work-item; the replicas LOW..HIGH are unrolled so that neighbours form the vector.

// O(s) = (1 - s)^(3/2) R(s): R has its nearest singularity at s = -1, so eight powers of s give O to 4e-10 without
// the cancellation of acos(s) - s sqrt(1 - s^2); interpolated at the Chebyshev nodes of [0, 1].
float transfer(const float s)
{
    const float t = fmax(1.0f - s, 0.0f);
    float r = -7.876327168e-5f;
    r = r * s + 4.773317558e-4f;
    r = r * s - 1.425687022e-3f;
    r = r * s + 3.039790117e-3f;
    r = r * s - 5.856791600e-3f;
    r = r * s + 1.236298635e-2f;
    r = r * s - 3.485750074e-2f;
    r = r * s + 2.267603886e-1f;
    r = r * s + 1.0f;
    return t * sqrt(t) * r;
}

__kernel void airy(
    // in:
    __global const float *restrict q,       // [bands] of the launch
    __global const int *restrict which,     // [bands] where each stands in the tables
    __global const float *restrict sinc_y,  // [replicas][rows]
    __global const float *restrict sinc_x,  // [replicas][cols]
    // out:
    __global float *restrict tables,        // [all bands][rows][cols]
    // params:
    const float step_y, const float step_x,
    // sizes:
    const int bands, const int rows, const int cols)
{
    const int x = get_global_id(0), y = get_global_id(1), band = get_global_id(2);
    GUARD(x >= cols || y >= rows || band >= bands)
    const float fy = y * step_y, fx = x * step_x, scale = q[band];
    float sum = 0.0f;
#pragma unroll
    for (int a = LOW; a <= HIGH; ++a) {
        const float u = scale * (fy + a);
        float row = 0.0f;
#pragma unroll
        for (int b = LOW; b <= HIGH; ++b) {
            const float v = scale * (fx + b);
            row += transfer(fmin(sqrt(u * u + v * v), 1.0f)) * sinc_x[(b - LOW) * cols + x];
        }
        sum += row * sinc_y[(a - LOW) * rows + y];
    }
    tables[((size_t)which[band] * rows + y) * cols + x] = sum;
}
