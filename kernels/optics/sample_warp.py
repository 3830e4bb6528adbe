"""One pixel along the axis that is reduced per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def columns(
    # in:
    planes: wp.array3d[float],
    start: wp.array1d[int],
    weights: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # params:
    taps: int,
    # sizes:
    count: int,
    fine_rows: int,
    rows: int,
    cols: int,
):
    p, y, x = wp.tid()
    total = float(0.0)
    for t in range(taps):
        total += weights[t, y] * planes[p, start[y] + t, x]
    out[p, y, x] = total


@wp.kernel
def rows(
    # in:
    planes: wp.array3d[float],
    start: wp.array1d[int],
    weights: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # params:
    taps: int,
    # sizes:
    count: int,
    height: int,
    fine_cols: int,
    cols: int,
):
    p, y, x = wp.tid()
    total = float(0.0)
    for t in range(taps):
        total += weights[t, x] * planes[p, y, start[x] + t]
    out[p, y, x] = total
