"""One pixel of one plane per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def falloff(
    # in:
    planes: wp.array3d[float],
    gains: wp.array3d[float],
    base: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    own: int,
    add_base: int,
    # sizes:
    count: int,
    rows: int,
    cols: int,
):
    p, y, x = wp.tid()
    value = gains[own * p, y, x] * planes[p, y, x]
    if add_base != 0:
        value += base[p, y, x]
    out[p, y, x] = value
