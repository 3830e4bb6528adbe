"""What lies outside the frame, written out so that a transform can go over it."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def reflected(i: int, n: int):  # mirrored with the outermost pixel repeated, however far outside
    j = i % (2 * n)
    if j < 0:
        j += 2 * n
    if j >= n:
        j = 2 * n - 1 - j
    return j


@wp.kernel
def extend(
    # in:
    planes: wp.array3d[float],
    # out:
    extended: wp.array3d[float],
    # params:
    first: int,
    border: int,
    before_y: int,
    before_x: int,
    # sizes:
    rows: int,
    cols: int,
    size: int,
    period_y: int,
    period_x: int,
):
    k, y, x = wp.tid()
    v = y - before_y
    u = x - before_x
    value = float(0.0)
    if border == 2:
        value = planes[first + k, reflected(v, rows), reflected(u, cols)]
    elif border == 1 or (u >= 0 and u < cols and v >= 0 and v < rows):
        value = planes[first + k, wp.clamp(v, 0, rows - 1), wp.clamp(u, 0, cols - 1)]
    extended[k, y, x] = value
