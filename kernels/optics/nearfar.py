"""Blur of every plane by its own kernel, summed into channels, without a transform: a pyramid of separable kernels.

Ports: planes (planes, rows, cols) float32, levels of (columns, rows), each (groups, planes, products, taps) float32,
mix (channels, planes) float32 -> channels (channels, rows, cols) float32:

    e_c = sum over k of  mix[c, k] B(planes_k, 0),
    B(I, n) = sum over t of  columns[n, t] * (rows[n, t] * I)  +  enlarged(B(blocks of I, n + 1)),

where * convolves along one axis, blocks are sums over factor x factor pixels from the frame's corner, and enlarging is
linear between the centres of the blocks. planner/nearfar.py makes the levels of a kernel. groups is 1, every channel
with the same kernels, or the number of channels. What is outside the frame is as `border` says, as far as the kernels
reach: nothing wraps around.
"""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.kernels.optics.convolve import vector_defines
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.stage import Case, stage

TILE, ROWS, BLOCK = 64, 8, 2  # rows of a CPU work-item, of them in registers, and vectors side by side
GPU_GROUP, GPU_ROWS = (8, 32), 4
WARP_ROWS = 16


@stage
def nearfar(device, planes, levels, mix, border, factor=2):
    """Convolve each plane with its kernel and add up per channel.

    planes: shape (planes, rows, cols). levels: pairs (columns, rows) from the finest to the coarsest, each of shape
    (1 or channels, planes, products, taps), taps odd. mix: shape (channels, planes). border: "zero", "edge" or
    "reflect" (the outermost pixel is repeated). factor: pixels of a level per pixel of the next, along an axis.
    Returns shape (channels, rows, cols).
    Raises BadData for levels that are empty, not finite or do not fit the planes and mix; UnknownName for another
    border; OutOfRange for a factor below 2.
    """
    mix = np.asarray(device.numpy(mix), np.float32)
    levels = [tuple(np.asarray(device.numpy(part), np.float32) for part in level) for level in levels]
    check(planes.shape, levels, mix, border, factor)
    planes = device.array(planes)
    own = levels[0][0].shape[0] > 1
    if own:  # each channel's kernels carry its mix
        levels = [(columns, rows * mix[:, :, None, None]) for columns, rows in levels]
    else:
        levels = [(columns[0, :, None], rows[0, :, None]) for columns, rows in levels]  # (planes, 1, products, taps)
    sizes, margins, around = geometry(planes.shape[1:], [columns.shape[3] for columns, _ in levels], factor)
    tile = _tile(device)
    defines = {"FACTOR": factor} | ({"GPU": 1} if device.is_gpu else {})
    own_factor = () if device.kind == "opencl" else (factor,)
    by_row = (1, 1) if device.kind == "opencl" and not device.is_gpu else None

    def grid(array):
        return array.shape[:2] if by_row else array.shape

    images = [planes]
    for n in range(1, len(levels)):
        # a tile more, because whole tiles are read; what is there goes into no result
        image = device.empty((planes.shape[0], *(size + 2 * around[n] + more for size, more in
                                                 zip(sizes[n], tile, strict=True))))
        device.launch("optics.nearfar", "shrink", grid(image), images[-1], image, BORDERS[border] if n == 1 else 1,
                      around[n - 1] if n > 1 else 0, around[n], planes.shape[0], *images[-1].shape[1:],
                      *image.shape[1:], *own_factor, defines=defines, group=by_row)
        images.append(image)
    low = None
    for n in reversed(range(len(levels))):
        shape = tuple(size + 2 * margins[n] for size in sizes[n])
        out = _separable(device, images[n], *levels[n], shape, border, None if n == 0 else around[n] - margins[n], own)
        if low is not None:
            device.launch("optics.nearfar", "enlarge", grid(out), low, out, margins[n], margins[n + 1], *out.shape,
                          *low.shape[1:], *own_factor, defines=defines, group=by_row)
        low = out
    return low if own else integrate(low, device.array(mix), device=device)


def check(shape, levels, mix, border, factor):
    """Refuse what cannot be blurred; raises as `nearfar`."""
    if border not in BORDERS:
        raise UnknownName("border", border, BORDERS)
    if int(factor) != factor or factor < 2:
        raise OutOfRange("factor", factor, "a whole number from 2")
    if len(shape) != 3 or 0 in shape:
        raise BadData(f"planes of shape {shape}: must be (planes, rows, cols), none of them zero")
    if mix.ndim != 2 or mix.shape[1] != shape[0] or not len(mix):
        raise BadData(f"mix of shape {mix.shape}: must be (channels, {shape[0]}), one per plane")
    if not levels:
        raise BadData("no levels: the pyramid needs one at least")
    groups = levels[0][0].shape[0]
    for n, (columns, rows) in enumerate(levels):
        if columns.shape != rows.shape or columns.ndim != 4 or 0 in columns.shape:
            raise BadData(f"level {n}: columns of shape {columns.shape}, rows {rows.shape}: must be equal, (groups, "
                          "planes, products, taps), none of them zero")
        if columns.shape[0] != groups or groups not in (1, len(mix)) or columns.shape[1] != shape[0]:
            raise BadData(f"level {n} is for {columns.shape[0]} channels and {columns.shape[1]} planes: must be 1 or "
                          f"{len(mix)}, the same at every level, and {shape[0]}")
        if columns.shape[3] % 2 == 0:
            raise BadData(f"level {n} has {columns.shape[3]} taps: must be odd, so that there is a centre")
        if not (np.isfinite(columns).all() and np.isfinite(rows).all()):
            raise BadData(f"level {n}: every tap must be finite")


def geometry(shape, taps, factor):
    """Per level: sizes of the frame, pixels that the result needs around it, pixels that the image has around it."""
    sizes, margins = [tuple(shape)], [0]
    for _ in taps[1:]:
        sizes.append(tuple(-(-n // factor) for n in sizes[-1]))
        margins.append(-(-margins[-1] // factor) + 1)
    around = [margins[-1] + taps[-1] // 2]
    for margin, count in zip(margins[-2::-1], taps[-2::-1], strict=True):
        around.insert(0, max(margin + count // 2, factor * around[0] + factor - 1))
    return sizes, margins, around


def _separable(device, image, columns, rows, shape, border, skip, own):
    """Sum of products over the planes; skip: first pixel of the result in the image, None: the image is the frame."""
    groups, count, rank, taps = columns.shape
    columns, rows = columns[..., ::-1], rows[..., ::-1]  # what convolves is turned around
    tile = _tile(device)
    tiles = [-(-n // t) for n, t in zip(shape, tile, strict=True)]
    start = 0 if skip is None else skip - taps // 2
    if skip is None:
        needed = [n * t + taps - 1 for n, t in zip(tiles, tile, strict=True)]
        image = extend(device, image, border, (taps // 2,) * 2, needed)
    work, group, defines = (1, 1), None, {}
    if device.kind == "opencl" and device.is_gpu:
        work, group = GPU_GROUP, (1, *GPU_GROUP)
        defines = {"GPU": 1, "ROWS": GPU_ROWS, "GROUP_Y": GPU_GROUP[0], "GROUP_X": GPU_GROUP[1]}
    elif device.kind == "opencl":
        group = (1, 1, 1)
        defines = vector_defines(device) | {"TILE": TILE, "ROWS": ROWS, "BLOCK": BLOCK}
    out = device.empty((groups, *shape))
    across = rows.transpose(0, 1, 3, 2)
    if defines:
        arrays = device.array(columns), device.array(across)
    else:
        arrays = device.array(columns.reshape(groups, count, -1)), device.array(across.reshape(groups, count, -1))
    device.launch("optics.nearfar", "separable", (groups, tiles[0] * work[0], tiles[1] * work[1]), image, *arrays, out,
                  start, int(not own), *(() if defines else (rank, taps)), groups, count, *shape, *image.shape[1:],
                  group=group, defines=defines | {"RANK": rank, "TAPS": taps})
    return out


def _tile(device):
    """Rows and columns of the result that a work-item, a group or a thread makes."""
    if device.kind == "opencl" and device.is_gpu:
        return GPU_GROUP[0] * GPU_ROWS, GPU_GROUP[1]
    if device.kind == "opencl":
        return TILE, BLOCK * vector_defines(device)["WIDTH"]
    return WARP_ROWS, 1


def cases():
    """All borders, kernels shared and own, one to four levels, factors 2 to 4, sizes that nothing divides."""
    random = np.random.default_rng(9)
    why = ("two passes of `taps` products per level and plane: random roundings of 6e-8 of the sum of |products|, that "
           "is below 4 of the result; sqrt(2 taps planes) of them, 9 at most, with 4 sigma: 6e-8 x 4 x 4 x 9")
    for rows, cols, count, channels, own, border, factor, shapes in (
            (1, 1, 1, 1, 0, "zero", 2, ((1, 1),)), (5, 3, 2, 3, 1, "edge", 2, ((2, 5), (2, 3))),
            (70, 131, 3, 3, 1, "reflect", 2, ((3, 15), (2, 5), (2, 5), (2, 5))),
            (65, 50, 4, 2, 0, "zero", 4, ((3, 15), (2, 5))), (33, 90, 2, 1, 0, "edge", 3, ((2, 5), (1, 1), (2, 3)))):
        levels = [tuple(random.uniform(-0.2, 1, (channels if own else 1, count, *shape)).astype(np.float32) / shape[1]
                        / factor**n for _ in range(2)) for n, shape in enumerate(shapes)]
        yield Case(f"{rows}x{cols}x{count} to {channels}, {len(shapes)} levels of {factor}, {border}",
                   {"planes": random.random((count, rows, cols), np.float32), "levels": levels,
                    "mix": random.random((channels, count), np.float32), "border": border, "factor": factor},
                   8.6e-6, why)


def bench(rows, cols):
    """Three planes, own kernels for three channels, reach of 250 pixels."""
    random = np.random.default_rng(9)
    shapes = ((3, 15), (4, 15), (4, 15), (4, 15), (4, 15), (4, 17))
    return {"planes": random.random((3, rows, cols), np.float32),
            "levels": [tuple(random.random((3, 3, *shape), np.float32) / shape[1] for _ in range(2))
                       for shape in shapes],
            "mix": random.random((3, 3), np.float32), "border": "edge"}
