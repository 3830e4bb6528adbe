// RUN neighbouring frequencies of one band per work-item, RUN from the host: on a CPU the innermost loop goes over
// them and is vectorised, on a GPU it is 1. Replicas that are wholly beyond the cutoff are left out.

// O(s) = (1 - s)^(3/2) R(s): R has its nearest singularity at s = -1, so eight powers of s give O to 4e-10 without
// the cancellation of acos(s) - s sqrt(1 - s^2); interpolated at the Chebyshev nodes of [0, 1].
__attribute__((always_inline)) inline float transfer(const float s)
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

__attribute__((always_inline)) inline void add_replica(
    float *restrict sum, __global const float *restrict sinc_x, const float u, const float weight, const float first,
    const float step)
{
    for (int r = 0; r < RUN; ++r) {
        const float v = first + r * step;
        sum[r] += weight * sinc_x[r] * transfer(fmin(sqrt(u * u + v * v), 1.0f));
    }
}

__kernel void airy(
    // in:
    __global const float *restrict q,
    __global const float *restrict sinc_y,  // [replicas][rows]
    __global const float *restrict sinc_x,  // [replicas][runs * RUN]
    // out:
    __global float *restrict tables,        // [bands][rows][cols]
    // params:
    const float step_y, const float step_x, const int low, const int high,
    // sizes:
    const int bands, const int rows, const int cols)
{
    const int x = get_global_id(0) * RUN, y = get_global_id(1), band = get_global_id(2);
    GUARD(x >= cols || y >= rows || band >= bands)
    const int width = (cols + RUN - 1) / RUN * RUN;
    const float scale = q[band];
    float sum[RUN];
    for (int r = 0; r < RUN; ++r) sum[r] = 0.0f;
    for (int a = low; a <= high; ++a) {
        const float u = scale * (y * step_y + a);
        if (fabs(u) >= 1.0f) continue;
        for (int b = low; b <= high; ++b) {
            const float first = scale * (x * step_x + b), last = scale * ((x + RUN - 1) * step_x + b);
            const float nearest = fmax(fmax(first, -last), 0.0f);
            if (u * u + nearest * nearest >= 1.0f) continue;
            add_replica(sum, sinc_x + (size_t)(b - low) * width + x, u, sinc_y[(a - low) * rows + y], first,
                        scale * step_x);
        }
    }
    __global float *out = tables + ((size_t)band * rows + y) * cols + x;
    for (int r = 0; r < RUN && x + r < cols; ++r) out[r] = sum[r];
}
