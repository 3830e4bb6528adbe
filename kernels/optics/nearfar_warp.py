"""A thread makes sixteen pixels of a column, so that each horizontal sum is made twice and not `taps` times."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import value_at

wp.set_module_options({"enable_backward": False})
vec16 = wp.types.vector(length=16, dtype=float)


@wp.kernel
def shrink(
    # in:
    source: wp.array3d[float],
    # out:
    image: wp.array3d[float],
    # params:
    border: int,
    before: int,
    margin: int,
    # sizes:
    count: int,
    rows: int,
    cols: int,
    low_rows: int,
    low_cols: int,
    factor: int,
):
    k, y, x = wp.tid()
    total = float(0.0)
    for i in range(factor):
        for j in range(factor):
            v = factor * (y - margin) + i + before
            u = factor * (x - margin) + j + before
            total += value_at(source, k, v, u, rows, cols, border)
    image[k, y, x] = total


@wp.kernel
def enlarge(
    # in:
    low: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    margin: int,
    low_margin: int,
    # sizes:
    count: int,
    rows: int,
    cols: int,
    low_rows: int,
    low_cols: int,
    factor: int,
):
    c, y, x = wp.tid()
    v = (float(y - margin) + 0.5) / float(factor) - 0.5
    u = (float(x - margin) + 0.5) / float(factor) - 0.5
    b = v - wp.floor(v)
    a = u - wp.floor(u)
    row = int(wp.floor(v)) + low_margin
    col = int(wp.floor(u)) + low_margin
    above = low[c, row, col] + a * (low[c, row, col + 1] - low[c, row, col])
    below = low[c, row + 1, col] + a * (low[c, row + 1, col + 1] - low[c, row + 1, col])
    out[c, y, x] = out[c, y, x] + above + b * (below - above)


@wp.kernel
def separable(
    # in:
    planes: wp.array3d[float],
    columns: wp.array3d[float],
    across: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    skip: int,
    diagonal: int,
    rank: int,
    taps: int,
    # sizes:
    groups: int,
    count: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    c, strip, x = wp.tid()
    y = 16 * strip
    sums = vec16()
    first = int(0)
    last = int(count)
    if diagonal != 0:
        first = c
        last = c + 1
    for k in range(first, last):
        n = k - first
        for t in range(rank):
            for v in range(taps + 15):
                line = float(0.0)
                for j in range(taps):
                    line += across[c, n, j * rank + t] * planes[k, y + v + skip, x + j + skip]
                for r in range(wp.max(v - taps + 1, 0), wp.min(v, 15) + 1):
                    sums[r] += columns[c, n, t * taps + v - r] * line
    for r in range(wp.min(16, rows - y)):
        out[c, y + r, x] = sums[r]
