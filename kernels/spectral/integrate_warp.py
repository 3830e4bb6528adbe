"""One pixel per thread, every band read once per group of four planes."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def integrate(
    # in:
    content: wp.array3d[Any],
    weights: wp.array2d[float],
    # out:
    planes: wp.array3d[float],
    # sizes:
    pixels: int,
    bands: int,
    count: int,
):
    i = wp.tid()
    cols = content.shape[2]
    y = i // cols
    x = i - y * cols
    for first in range(0, count, 4):
        p1 = wp.min(first + 1, count - 1)
        p2 = wp.min(first + 2, count - 1)
        p3 = wp.min(first + 3, count - 1)
        sums = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for b in range(bands):
            sums += float(content[b, y, x]) * wp.vec4(
                weights[first, b], weights[p1, b], weights[p2, b], weights[p3, b]
            )
        planes[first, y, x] = sums[0]
        planes[p1, y, x] = sums[1]
        planes[p2, y, x] = sums[2]
        planes[p3, y, x] = sums[3]


integrate_half = wp.overload(integrate, {"content": wp.array3d[wp.float16]})
integrate = wp.overload(integrate, {"content": wp.array3d[float]})
