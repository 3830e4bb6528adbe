"""The world outside the frame, and planes with their surroundings."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def inside(
    i: int, n: int, border: int
):  # the pixel that stands for pixel i; some pixel in the dark
    j = wp.clamp(i, 0, n - 1)
    if border == 2:  # mirrored with the outermost pixel repeated, however far outside
        j = i % (2 * n)
        if j < 0:
            j += 2 * n
        if j >= n:
            j = 2 * n - 1 - j
    return j


@wp.func
def value_at(planes: wp.array3d[float], k: int, y: int, x: int, rows: int, cols: int, border: int):
    value = float(0.0)
    if border != 0 or (y >= 0 and y < rows and x >= 0 and x < cols):
        value = planes[k, inside(y, rows, border), inside(x, cols, border)]
    return value


@wp.kernel
def extend(
    # in:
    planes: wp.array3d[float],
    # out:
    extended: wp.array3d[float],
    # params:
    border: int,
    first: int,
    before_y: int,
    before_x: int,
    # sizes:
    count: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    k, y, x = wp.tid()
    extended[k, y, x] = value_at(planes, first + k, y - before_y, x - before_x, rows, cols, border)
