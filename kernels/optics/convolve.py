"""Convolution of planes with given kernels, term by term in the image, in float32 or with float64 sums.

Ports: planes (planes, rows, cols) float32, kernels (1 or planes, kh, kw), both odd -> (planes, rows, cols) float32:

    out_k(y, x) = sum over i, j of  kernels_k[i, j] planes_k(y + kh // 2 - i, x + kw // 2 - j),

what is outside the frame as `border` says. No error spreads beyond the kernel's reach. precision "single" errs by some
1e-7 of the sum of |kernel x plane| at the pixel; "double" is the exact mode: float64 sums, so that the result is the
truth rounded to float32 (6e-8 of its own value) wherever no highlight is within the kernel's reach, and next to one.

Three ways are taken, by measurement: sums of five rows in registers on CPUs, half to two thirds of the multiplications'
peak at 15 x 15; tiles in local memory on GPUs; and, for float64 on OpenCL CPUs, vertical transforms in the cache
(common/columns.cl) whose cost is 2 kw and not kh kw products a pixel, where 63 x 63 tap by tap would be 4000.
"""

import numpy as np

from gpusim.domain.errors import BadData, UnknownName
from gpusim.kernels.common import columns
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.kernels.stage import Case, stage

PRECISIONS = {"single": np.float32, "double": np.float64}
ROWS, BLOCK = 5, 4  # rows, and vectors side by side, of sums in registers
GPU_ROWS = 8
GPU_GROUP = (4, 64)  # threads; each makes GPU_ROWS pixels of a column
GPU_PART = (
    16,
    16,
)  # coefficients at a time: 47 x 79 values are 15 KB of local memory, 30 in float64
WARP_ROWS = 4


@stage
def convolve(device, planes, kernels, border="edge", precision="single"):
    """Convolve each plane with its kernel, or all with one.

    planes: shape (planes, rows, cols). kernels: shape (1 or planes, kh, kw), host or device array, kh and kw odd.
    border: "zero", "edge" or "reflect" (the outermost pixel is repeated). precision: "single" or "double", of the sums
    and of the kernels. Returns shape (planes, rows, cols), float32.
    Raises BadData for kernels that are empty, even-sized, not finite, not one per plane, or larger than the planes;
    UnknownName for another border or precision.
    """
    kernels = np.asarray(device.numpy(kernels))
    check(planes.shape, kernels, border, precision)
    flipped = kernels[:, ::-1, ::-1].astype(PRECISIONS[precision])
    planes = device.array(planes)
    if precision == "double" and device.kind == "opencl" and not device.is_gpu:
        return columns.convolve(
            device, planes.shape, flipped, lambda *place: extend(device, planes, border, *place)
        )
    return _direct(device, planes, flipped, border)


def check(shape, kernels, border, precision="single"):
    """Refuse what cannot be convolved; raises as `convolve`."""
    if border not in BORDERS:
        raise UnknownName("border", border, BORDERS)
    if precision not in PRECISIONS:
        raise UnknownName("precision", precision, PRECISIONS)
    if len(shape) != 3 or 0 in shape:
        raise BadData(f"planes of shape {shape}: must be (planes, rows, cols), none of them zero")
    if kernels.ndim != 3 or 0 in kernels.shape:
        raise BadData(
            f"kernels of shape {kernels.shape}: must be (1 or {shape[0]}, kh, kw), none of them zero"
        )
    if len(kernels) not in (1, shape[0]):
        raise BadData(f"{len(kernels)} kernels for {shape[0]} planes: must be 1 or one per plane")
    size = kernels.shape[1:]
    if not all(n % 2 for n in size):
        raise BadData(
            f"kernels of {size[0]} x {size[1]}: both sizes must be odd, so that there is a centre"
        )
    if any(n > m for n, m in zip(size, shape[1:], strict=True)):
        raise BadData(
            f"kernels of {size[0]} x {size[1]} exceed the planes, {shape[1]} x {shape[2]}: crop them"
        )
    if not np.isfinite(kernels).all():
        k, i, j = np.argwhere(~np.isfinite(kernels))[0]
        raise BadData(f"kernel {k} is {kernels[k, i, j]} at ({i}, {j}): every value must be finite")


def coefficients(flipped, rows):
    """table[k, v, j, r] = flipped[k, v - r, j], zero where there is none."""
    count, kh, kw = flipped.shape
    table = np.zeros((count, kh + rows - 1, kw, rows), flipped.dtype)
    for r in range(rows):
        table[:, r : r + kh, :, r] = flipped
    return table


def _direct(device, planes, flipped, border):
    count, rows, cols = planes.shape
    middle = [n // 2 for n in flipped.shape[1:]]
    dtype = flipped.dtype.type
    if device.kind == "opencl" and device.is_gpu:
        # the kernel goes through local memory in parts; what fills up the last ones is zero
        flipped = np.pad(
            flipped,
            ((0, 0), *((0, -n % p) for n, p in zip(flipped.shape[1:], GPU_PART, strict=True))),
        )
        tile = GPU_GROUP[0] * GPU_ROWS, GPU_GROUP[1]
        table = device.array(flipped, dtype)
        defines = {
            "GPU": 1,
            "REAL": "float" if dtype == np.float32 else "double",
            "ROWS": GPU_ROWS,
            "GROUP_Y": GPU_GROUP[0],
            "GROUP_X": GPU_GROUP[1],
            "PART_Y": GPU_PART[0],
            "PART_X": GPU_PART[1],
        }
    elif device.kind == "opencl":
        # the sums of ROWS rows begin and end one after the other, which takes kernels of ROWS - 1
        flipped = np.pad(flipped, ((0, 0), (0, max(ROWS - 1 - flipped.shape[1], 0)), (0, 0)))
        defines = vector_defines(device)
        tile = ROWS, defines["BLOCK"] * defines["WIDTH"]
        table = device.array(coefficients(flipped, ROWS), dtype)
    else:
        tile = WARP_ROWS, 1
        table = device.array(coefficients(flipped, WARP_ROWS).reshape(len(flipped), -1), dtype)
    own, size = int(len(flipped) > 1), flipped.shape[1:]
    tiles = [-(-n // t) for n, t in zip((rows, cols), tile, strict=True)]
    period = [n * t + s - 1 for n, t, s in zip(tiles, tile, size, strict=True)]
    out = device.empty(planes.shape)
    if device.kind == "opencl" and not device.is_gpu:
        hole = [
            bound
            for axis in range(2)
            for bound in _hole((rows, cols)[axis], tile[axis], size[axis], middle[axis])
        ]
        extended = extend(device, planes, border, middle, period, hole=hole)
        device.launch(
            "optics.convolve",
            "direct",
            (count, tiles[0]),
            planes,
            extended,
            table,
            out,
            own,
            *middle,
            count,
            *size,
            rows,
            cols,
            *period,
            group=(1, 1),
            defines=defines,
        )
        return out
    extended = extend(device, planes, border, middle, period)
    arguments = (extended, table, out, own, count, *size, rows, cols, *period)
    if device.kind == "warp":
        device.launch("optics.convolve", "direct", (count, tiles[0], cols), *arguments)
    else:
        grid = (count, tiles[0] * GPU_GROUP[0], tiles[1] * GPU_GROUP[1])
        device.launch(
            "optics.convolve", "direct", grid, *arguments, group=(1, *GPU_GROUP), defines=defines
        )
    return out


def _hole(length, tile, taps, middle):
    """First and last + 1 pixel that only tiles read whose values are all of the frame."""
    first = -(-middle // tile)
    last = max(first, (length - taps + 1 + middle) // tile)  # tiles first .. last - 1 are inside
    return (0, 0) if last == first else (min(first * tile + taps - 1, last * tile), last * tile)


def vector_defines(device):
    """Defines: the widest vectors that compile (PoCL before 3.1 aborts on 16), and how many fill the registers."""
    driver = device.cl_device.driver_version
    wide = device.cl_device.native_vector_width_float >= 16 and not driver.startswith(
        ("1.", "2.", "3.0")
    )
    width = 16 if wide else 8
    return {"VECTOR": f"float{width}", "WIDTH": width, "ROWS": ROWS, "BLOCK": BLOCK}


def cases():
    """All borders, one kernel and one per plane, small and long kernels, frames that no block divides, highlights."""
    random = np.random.default_rng(8)
    why = (
        "a float32 sum of n positive terms errs by n half ulps at most, 6e-8 n of the pixel's own value; roundings "
        "are random, so sqrt(n) of them with 4 sigma and the two roundings of the terms: 6e-8 (4 sqrt(n) + 2)"
    )
    exact = "the float64 sum is rounded once to float32, 6e-8; sums and transforms err by 1e-15 of the 1e9 highlight"
    for rows, cols, count, own, kh, kw, border in (
        (1, 1, 1, 0, 1, 1, "zero"),
        (9, 7, 2, 1, 9, 7, "reflect"),
        (33, 41, 3, 1, 15, 15, "edge"),
        (70, 301, 2, 0, 5, 3, "zero"),
        (65, 130, 1, 0, 17, 33, "reflect"),
        (80, 70, 1, 0, 63, 63, "edge"),
    ):
        kernels = random.uniform(0.5, 1, (count if own else 1, kh, kw)) / (kh * kw)
        planes = random.uniform(0.5, 1.5, (count, rows, cols)).astype(np.float32)
        planes[0, rows // 2, cols // 2], planes[0, rows // 3, cols // 3] = 1e6, 1e9
        name = f"{rows}x{cols}x{count}, kernel {kh}x{kw}, {border}"
        for precision, tolerance, reason in (
            ("single", 6e-8 * (4 * np.sqrt(kh * kw) + 2), why),
            ("double", 1e-7, exact),
        ):
            given = kernels.astype(np.float32) if precision == "single" else kernels
            yield Case(
                f"{name}, {precision}",
                {"planes": planes, "kernels": given, "border": border, "precision": precision},
                tolerance,
                reason,
                metric="local",
            )


def bench(rows, cols):
    """One plane, 15 x 15."""
    random = np.random.default_rng(8)
    return {
        "planes": random.random((1, rows, cols), np.float32),
        "kernels": random.random((1, 15, 15)).astype(np.float32) / 225,
    }


def operations(planes, kernels):
    """A multiplication and an addition for each value and tap."""
    return 2 * planes.size * kernels[0].size
