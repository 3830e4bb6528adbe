"""One sample per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def widen(
    # in:
    content: wp.array3d[wp.float16],
    chosen: wp.array1d[int],
    # out:
    out: wp.array3d[float],
    # sizes:
    lines: int, count: int, rows: int, cols: int,
):
    line, x = wp.tid()
    entry = line // count
    i = line - entry * count
    out[entry, i, x] = float(content[entry, wp.clamp(chosen[i], 0, rows - 1), x])
