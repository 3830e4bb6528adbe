// One pixel per work-item, all its products: neighbouring items form the vector, every map and plane is read once a
// product at most, and the caches hold values that a row of items reads again. LIGHTS and SURFACES: from the host.
#define ILLUMINATE(LOAD) \
    const int x = get_global_id(0), y = get_global_id(1); \
    GUARD(y >= rows || x >= cols) \
    const size_t pixel = (size_t)y * cols + x, pixels = (size_t)rows * cols; \
    _Pragma("unroll") for (int k = 0; k < LIGHTS; ++k) { \
        const float light = maps[k * pixels + pixel]; \
        _Pragma("unroll") for (int j = 0; j < SURFACES; ++j) \
            out[((size_t)k * SURFACES + j) * pixels + pixel] = light * LOAD(coefficients, j * pixels + pixel); \
    }

#define FROM_FLOAT(coefficients, at) coefficients[at]
#define FROM_HALF(coefficients, at) vload_half(at, coefficients)  // core OpenCL: no extension is needed to load it

__kernel void illuminate(
    // in:
    __global const float *restrict maps,          // [LIGHTS][rows][cols]
    __global const float *restrict coefficients,  // [SURFACES][rows][cols]
    // out:
    __global float *restrict out,                 // [LIGHTS * SURFACES][rows][cols]
    // sizes:
    const int rows, const int cols)
{
    ILLUMINATE(FROM_FLOAT)
}

__kernel void illuminate_half(
    // in:
    __global const float *restrict maps,          // [LIGHTS][rows][cols]
    __global const half *restrict coefficients,   // [SURFACES][rows][cols]
    // out:
    __global float *restrict out,                 // [LIGHTS * SURFACES][rows][cols]
    // sizes:
    const int rows, const int cols)
{
    ILLUMINATE(FROM_HALF)
}
