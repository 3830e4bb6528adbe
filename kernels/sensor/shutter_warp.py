"""One pixel per thread, its instants one after the other."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def shutter(
    # in:
    rates: wp.array3d[float],
    weights: wp.array2d[float],
    spans: wp.array2d[int],
    # out:
    mean: wp.array2d[float],
    # sizes:
    instants: int,
    rows: int,
    cols: int,
):
    y, x = wp.tid()
    total = float(0.0)
    for k in range(spans[y, 0], spans[y, 1]):
        total += weights[y, k] * rates[k, y, x]
    mean[y, x] = total
