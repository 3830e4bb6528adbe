"""One pixel per thread, all its products."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def illuminate(
    # in:
    maps: wp.array3d[float],
    coefficients: wp.array3d[Any],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    lights: int,
    surfaces: int,
):
    y, x = wp.tid()
    for k in range(lights):
        light = maps[k, y, x]
        for j in range(surfaces):
            out[k * surfaces + j, y, x] = light * float(coefficients[j, y, x])


illuminate_half = wp.overload(illuminate, {"coefficients": wp.array3d[wp.float16]})
illuminate = wp.overload(illuminate, {"coefficients": wp.array3d[float]})
