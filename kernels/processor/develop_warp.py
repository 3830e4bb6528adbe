"""ROWS rows of one column per thread, as in develop.cl on GPUs."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own
from gpusim.kernels.common.bilinear_warp import ROWS, interpolate, line
from gpusim.kernels.common.codes_warp import code

wp.set_module_options({"enable_backward": False})


@wp.kernel
def develop(
    # in:
    raw: wp.array2d[Any],
    matrix: wp.array2d[float],
    ceiling: wp.array1d[float],
    entries: wp.array1d[wp.uint32],
    # out:
    out: wp.array3d[wp.uint8],
    # params:
    gain: float,
    offset: float,
    most: float,
    black_level: float,
    scale: float,
    red_row: int,
    red_col: int,
    bottom: float,
    top: float,
    shift: int,
    # sizes:
    run: int,
    rows: int,
    cols: int,
):
    item, x = wp.tid()
    first_row = item * ROWS
    converter = wp.vec3(gain, offset, most)
    up = line(raw, converter, first_row - 1, x)
    here = line(raw, converter, first_row, x)
    for i in range(ROWS):
        y = first_row + i
        if y < rows:
            down = line(raw, converter, y + 1, x)
            camera = interpolate(
                up,
                here,
                down,
                (x & 1) == first_own(y, red_row, red_col),
                ((y ^ red_row) & 1) == 0,
                black_level,
                scale,
            )
            sums = wp.vec3(0.0, 0.0, 0.0)
            for c in range(3):
                sums += wp.min(camera[c], ceiling[c]) * wp.vec3(
                    matrix[0, c], matrix[1, c], matrix[2, c]
                )
            for p in range(3):
                out[y, x, p] = code(sums[p], entries, bottom, top, shift)
            up = here
            here = down
