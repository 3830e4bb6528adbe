"""Warp kernel of channels.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def put_last(
    # in:
    planes: wp.array2d[float],
    # out:
    pixels: wp.array2d[float],
    # sizes:
    count: int,
    channels: int,
):
    i = wp.tid()
    for c in range(channels):
        pixels[i, c] = planes[c, i]
