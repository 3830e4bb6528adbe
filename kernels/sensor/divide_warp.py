"""One pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def divide(
    # in:
    whole: wp.array2d[float],
    parts: wp.array3d[float],
    shares: wp.array3d[float],
    # out:
    diodes: wp.array3d[float],
    # sizes:
    count: int,
    rows: int,
    cols: int,
    high: int,
    wide: int,
):
    y, x = wp.tid()
    left = whole[y, x]
    for k in range(count):
        own = wp.min(wp.max(shares[k, y % high, x % wide] * parts[k, y, x], 0.0), left)
        diodes[k, y, x] = own
        left -= own
    diodes[count, y, x] = left
