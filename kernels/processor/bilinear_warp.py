"""ROWS rows of one column per thread, as in bilinear.cl on GPUs."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own
from gpusim.kernels.common.bilinear_warp import ROWS, interpolate, line

wp.set_module_options({"enable_backward": False})


@wp.kernel
def bilinear(
    # in:
    raw: wp.array2d[wp.uint16],
    # out:
    rgb: wp.array3d[float],
    # params:
    black_level: float,
    scale: float,
    red_row: int,
    red_col: int,
    # sizes:
    run: int,
    rows: int,
    cols: int,
):
    item, x = wp.tid()
    top = item * ROWS
    none = wp.vec3(0.0, 0.0, 0.0)
    up = line(raw, none, top - 1, x)
    here = line(raw, none, top, x)
    for i in range(ROWS):
        y = top + i
        if y < rows:
            down = line(raw, none, y + 1, x)
            colors = interpolate(
                up,
                here,
                down,
                (x & 1) == first_own(y, red_row, red_col),
                ((y ^ red_row) & 1) == 0,
                black_level,
                scale,
            )
            rgb[0, y, x] = colors[0]
            rgb[1, y, x] = colors[1]
            rgb[2, y, x] = colors[2]
            up = here
            here = down
