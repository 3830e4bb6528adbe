"""A thread makes four pixels of a column: each value read goes into four sums."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import reflected

wp.set_module_options({"enable_backward": False})


@wp.kernel
def surround(
    # in:
    planes: wp.array3d[float],
    # out:
    extended: wp.array3d[float],
    # params:
    border: int,
    before_y: int,
    before_x: int,
    top: int,
    bottom: int,
    left: int,
    right: int,
    # sizes:
    count: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    k, y, x = wp.tid()
    if y >= top and y < bottom and x >= left and x < right:
        return
    v = y - before_y
    u = x - before_x
    value = float(0.0)
    if border == 2:
        value = planes[k, reflected(v, rows), reflected(u, cols)]
    elif border == 1 or (u >= 0 and u < cols and v >= 0 and v < rows):
        value = planes[k, wp.clamp(v, 0, rows - 1), wp.clamp(u, 0, cols - 1)]
    extended[k, y, x] = value


@wp.kernel
def direct(
    # in:
    extended: wp.array3d[float],
    table: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # params:
    own: int,
    # sizes:
    count: int,
    taps_y: int,
    taps_x: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    k, strip, x = wp.tid()
    y = 4 * strip
    at = int(0)
    sum0 = float(0.0)
    sum1 = float(0.0)
    sum2 = float(0.0)
    sum3 = float(0.0)
    for v in range(taps_y + 3):
        for j in range(taps_x):
            value = float(extended[k, y + v, x + j])
            sum0 += table[own * k, at] * value
            sum1 += table[own * k, at + 1] * value
            sum2 += table[own * k, at + 2] * value
            sum3 += table[own * k, at + 3] * value
            at += 4
    out[k, y, x] = float(sum0)
    if y + 1 < rows:
        out[k, y + 1, x] = float(sum1)
    if y + 2 < rows:
        out[k, y + 2, x] = float(sum2)
    if y + 3 < rows:
        out[k, y + 3, x] = float(sum3)


@wp.kernel
def direct_double(
    # in:
    extended: wp.array3d[float],
    table: wp.array2d[wp.float64],
    # out:
    out: wp.array3d[float],
    # params:
    own: int,
    # sizes:
    count: int,
    taps_y: int,
    taps_x: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    k, strip, x = wp.tid()
    y = 4 * strip
    at = int(0)
    sum0 = wp.float64(0.0)
    sum1 = wp.float64(0.0)
    sum2 = wp.float64(0.0)
    sum3 = wp.float64(0.0)
    for v in range(taps_y + 3):
        for j in range(taps_x):
            value = wp.float64(extended[k, y + v, x + j])
            sum0 += table[own * k, at] * value
            sum1 += table[own * k, at + 1] * value
            sum2 += table[own * k, at + 2] * value
            sum3 += table[own * k, at + 3] * value
            at += 4
    out[k, y, x] = float(sum0)
    if y + 1 < rows:
        out[k, y + 1, x] = float(sum1)
    if y + 2 < rows:
        out[k, y + 2, x] = float(sum2)
    if y + 3 < rows:
        out[k, y + 3, x] = float(sum3)
