"""One binned pixel per thread; charges and digital numbers by the type of the arrays."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.kernel
def bin(
    # in:
    pixels: wp.array2d[Any],
    # out:
    out: wp.array2d[Any],
    # params:
    binning_y: int,
    stride_y: int,
    average: int,
    # sizes:
    cols: int,
    out_rows: int,
    out_cols: int,
    # what OpenCL has at compile time:
    binning_x: int,
    stride_x: int,
    digital: int,
):
    y, x = wp.tid()
    top = y / stride_y * stride_y * binning_y + y % stride_y
    left = x / stride_x * stride_x * binning_x + x % stride_x
    total = float(0.0)
    for i in range(binning_x):
        column = float(pixels[top, left + i * stride_x])
        for j in range(1, binning_y):
            column += float(pixels[top + j * stride_y, left + i * stride_x])
        if i == 0:
            total = column
        else:
            total += column
    if average != 0:
        total = wp.rint(total / float(binning_y * binning_x))
    if digital != 0:
        total = wp.min(total, 65535.0)
    out[y, x] = out.dtype(total)


for _type in (wp.float32, wp.uint16):
    wp.overload(bin, {"pixels": wp.array2d[_type], "out": wp.array2d[_type]})
