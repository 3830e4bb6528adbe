"""A thread makes four pixels of a column: each value read goes into four sums."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def direct(
    # in:
    extended: wp.array3d[float],
    table: wp.array2d(dtype=Any),  # the sums are of its type
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
    sum0 = table.dtype(0.0)
    sum1 = table.dtype(0.0)
    sum2 = table.dtype(0.0)
    sum3 = table.dtype(0.0)
    for v in range(taps_y + 3):
        for j in range(taps_x):
            value = table.dtype(extended[k, y + v, x + j])
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


for real in (float, wp.float64):
    wp.overload(direct, {"table": wp.array2d(dtype=real)})
