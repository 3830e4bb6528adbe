"""One sample per thread."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def column(chosen_cols: wp.array2d[int], window: int, x: int, cols: int, whole: int):
    if whole != 0:
        return x
    return wp.clamp(chosen_cols[window, x], 0, cols - 1)


@wp.kernel
def take(
    # in:
    content: wp.array3d[Any],
    chosen_rows: wp.array2d[int],
    chosen_cols: wp.array2d[int],
    # out:
    out: wp.array4d[Any],
    # sizes:
    entries: int,
    rows: int,
    cols: int,
    lines: int,
    height: int,
    width: int,
    whole: int,
):
    entry, line, x = wp.tid()
    window = line // height
    i = line - window * height
    y = wp.clamp(chosen_rows[window, i], 0, rows - 1)
    value = content[entry, y, column(chosen_cols, window, x, cols, whole)]
    out[window, entry, i, x] = out.dtype(value)


take_half = wp.overload(take, {"content": wp.array3d[wp.float16], "out": wp.array4d[float]})
take_numbers = wp.overload(take, {"content": wp.array3d[wp.uint16], "out": wp.array4d[wp.uint16]})
take = wp.overload(take, {"content": wp.array3d[float], "out": wp.array4d[float]})
