"""One pixel per thread, all its products."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def products(
    maps: wp.array3d[float],
    coefficients: wp.array3d[Any],
    out: wp.array3d[float],
    y: int,
    x: int,
    lights: int,
    surfaces: int,
):
    """Write all products of a pixel."""
    for k in range(lights):
        light = maps[k, y, x]
        for j in range(surfaces):
            out[k * surfaces + j, y, x] = light * float(coefficients[j, y, x])


@wp.kernel
def illuminate(
    # in:
    maps: wp.array3d[float],
    coefficients: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    lights: int,
    surfaces: int,
):
    y, x = wp.tid()
    products(maps, coefficients, out, y, x, lights, surfaces)


@wp.kernel
def illuminate_half(
    # in:
    maps: wp.array3d[float],
    coefficients: wp.array3d[wp.float16],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    lights: int,
    surfaces: int,
):
    y, x = wp.tid()
    products(maps, coefficients, out, y, x, lights, surfaces)
