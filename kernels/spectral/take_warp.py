"""One sample per thread."""

# mypy: ignore-errors
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
    content: wp.array3d[float],
    chosen_rows: wp.array2d[int],
    chosen_cols: wp.array2d[int],
    # out:
    out: wp.array4d[float],
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
    out[window, entry, i, x] = content[entry, y, column(chosen_cols, window, x, cols, whole)]


@wp.kernel
def take_half(
    # in:
    content: wp.array3d[wp.float16],
    chosen_rows: wp.array2d[int],
    chosen_cols: wp.array2d[int],
    # out:
    out: wp.array4d[float],
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
    out[window, entry, i, x] = float(content[entry, y, column(chosen_cols, window, x, cols, whole)])


@wp.kernel
def take_numbers(
    # in:
    content: wp.array3d[wp.uint16],
    chosen_rows: wp.array2d[int],
    chosen_cols: wp.array2d[int],
    # out:
    out: wp.array4d[wp.uint16],
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
    out[window, entry, i, x] = content[entry, y, column(chosen_cols, window, x, cols, whole)]
