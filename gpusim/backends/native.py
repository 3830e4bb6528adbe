"""OpenCL kernels on Warp's CUDA devices: the same text, as a native function of a Warp kernel.

It serves kernels whose work-items share local memory. Warp has that only inside tiles, whose
transforms refuse lengths like 1200. The text keeps to the common part of both languages, see
kernels/common/fft.clh.
"""

# mypy: ignore-errors
import linecache
import re

from gpusim.backends.launches import stage_source

# OpenCL C's names in CUDA C++; a structure with operators instead of the vector type.
DIALECT = """
#define __kernel
#define __global
#define __constant
#define __local __shared__
#define LOCAL(type, name, count) \\
    extern __shared__ float4 local_memory[]; \\
    static_assert(sizeof(type) * (count) <= LOCAL_BYTES, "LOCAL_BYTES is too small"); \\
    type *const name = (type *)local_memory
#define restrict __restrict__
#define barrier(fence) __syncthreads()
#define get_local_id(axis) (int)threadIdx.x
#define get_group_id(axis) (int)blockIdx.x
#define ushort unsigned short
#define uint unsigned int
#define PAIR(a, b) float2{a, b}
#define QUAD(a, b) quad(a, b)
#define FLOATS(at) ((float *)(at))
struct __align__(8) float2 {
    float x, y;
    float2 operator+(const float2 b) const { return {x + b.x, y + b.y}; }
    float2 operator-(const float2 b) const { return {x - b.x, y - b.y}; }
    float2 operator*(const float b) const { return {x * b, y * b}; }
    float2 &operator+=(const float2 b) { x += b.x; y += b.y; return *this; }
};
struct Kernels {
float4 quad(const float2 a, const float2 b) { return make_float4(a.x, a.y, b.x, b.y); }
"""

# Elements of arrays there and in Warp
ELEMENTS = {
    "float2": "float",
    "float4": "float",
    "float": "float",
    "int": "int",
    "ushort": "wp.uint16",
}


def native_kernel(wp, stage, kernel, defines, ranks):
    """Return a Warp kernel that runs `kernel` of the stage's OpenCL file.

    It is launched in whole groups along one axis.

    defines: compile-time constants. Among them, REGISTERS is the most that a work-item may use, and
    LOCAL_BYTES the size of the memory that LOCAL declares. That memory is a Warp tile, which may be
    as large as the device allows; arrays declared otherwise are limited to 48 KB less Warp's own 4
    bytes a work-item. ranks: number of axes of each argument that is an array, None for the others.
    """
    text = _include_files(stage)
    parameters = re.search(rf"__kernel void {kernel}\((.*?)\)\s*{{", text, re.DOTALL)[1]
    parameters = [p.split() for p in re.sub(r"//.*", "", parameters).replace("*", " * ").split(",")]
    names = [p[-1] for p in parameters]
    types = [next(t for t in ELEMENTS if t in p) for p in parameters]
    calls = [
        f"({t} *){p[-1]}.data" if "*" in p else p[-1]
        for p, t in zip(parameters, types, strict=True)
    ]
    kinds = [
        f"wp.array(dtype={ELEMENTS[t]}, ndim={rank})" if "*" in p else t
        for p, t, rank in zip(parameters, types, ranks, strict=True)
    ]
    macros = "".join(f"#define {name} {value}\n" for name, value in defines.items())
    used = re.findall(r"#define (\w+)", macros + DIALECT + text)
    snippet = (
        f"\n{macros}{DIALECT}{text}\n}};\nKernels().{kernel}({', '.join(calls)});\n"
        + "".join(f"#undef {name}\n" for name in used)
    )
    signature = ", ".join(f"{name}: {kind}" for name, kind in zip(names, kinds, strict=True))
    tile = f"    wp.tile_empty(shape={-(-defines.get('LOCAL_BYTES', 0) // 16)}, dtype=wp.vec4, storage='shared')\n"
    source = (
        f"@wp.func_native(snippet)\ndef native({signature}): ...\n\n"
        f"@wp.kernel(module='unique', enable_backward=False, cuda_max_registers={defines.get('REGISTERS')})\n"
        f"def {kernel}({signature}):\n"
        + (tile if "LOCAL_BYTES" in defines else "")
        + f"    native({', '.join(names)})\n"
    )
    file = f"<{stage} {kernel} {hash(snippet)}>"
    # Warp reads its kernels' source
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    namespace = {"wp": wp, "snippet": snippet, "__name__": f"{__name__}.{kernel}"}
    exec(compile(source, file, "exec"), namespace)
    return namespace[kernel]


def _include_files(stage):
    """Return the text of the stage's OpenCL file with its include files inserted."""
    text, folder = stage_source(stage)
    return re.sub(r'#include "(.*)"', lambda found: (folder / found[1]).read_text(), text)
