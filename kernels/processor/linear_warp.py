"""One pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def linear(
    # in:
    raw: wp.array2d[wp.uint16],
    # out:
    grey: wp.array3d[float],
    # params:
    black_level: float,
    scale: float,
    # sizes:
    cols: int,
    count: int,
):
    i = wp.tid()
    y = i // cols
    x = i - y * cols
    grey[0, y, x] = (float(raw[y, x]) - black_level) * scale
