"""One sample of one plane per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def begin(
    # in:
    planes: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    count: int,
    rows: int,
    cols: int,
):
    p, y, x = wp.tid()
    out[p, y, x] = planes[p, y, x]


@wp.kernel
def reveal(
    # in:
    planes: wp.array3d[float],
    index: wp.array2d[int],
    factor: wp.array[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    count: int,
    samples: int,
    pixels: int,
):
    p, k = wp.tid()
    cols = planes.shape[2]
    own = planes[p, index[1, k] / cols, index[1, k] % cols]
    other = planes[p, index[2, k] / cols, index[2, k] % cols]
    out[p, index[0, k] / cols, index[0, k] % cols] = own + factor[k] * (own - other)
