"""A run of pixels per thread, three look-ups each."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.codes_warp import code

wp.set_module_options({"enable_backward": False})


@wp.kernel
def encode(
    # in:
    rgb: wp.array3d[float],
    entries: wp.array1d[wp.uint32],
    # out:
    out: wp.array3d[wp.uint8],
    # params:
    bottom: float,
    top: float,
    shift: int,
    # sizes:
    run: int,
    pixels: int,
):
    item = wp.tid()
    cols = rgb.shape[2]
    for i in range(item * run, wp.min(item * run + run, pixels)):
        y = i // cols
        x = i - y * cols
        for p in range(3):
            out[y, x, p] = code(rgb[p, y, x], entries, bottom, top, shift)
