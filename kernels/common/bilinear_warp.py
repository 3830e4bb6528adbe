"""Bilinear demosaicking as in bilinear.clh, one column at a time."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import mirror

ROWS = 4  # of a thread, as the host counts them


@wp.func_native("""
#ifdef __CUDA_ARCH__
return __fmul_rn(a, b);
#else
return a * b;
#endif
""")
def rounded_product(a: float, b: float) -> float:
    """Return a b, never contracted with a sum that follows."""
    ...


@wp.func
def digitise(sample: wp.uint16, converter: wp.vec3):
    """Return a digital number as it is."""
    return int(sample)


@wp.func
def digitise(electrons: float, converter: wp.vec3):  # noqa: F811  chosen by type
    """Return the number that a converter (gain, offset, most) makes of electrons."""
    level = rounded_product(converter[0], electrons) + converter[1]  # as in sensor/noise_warp.py
    if not level > 0.0:  # NaN too
        level = 0.0
    return int(wp.rint(wp.min(level, converter[2])))


@wp.func
def line(raw: wp.array2d[Any], converter: wp.vec3, y: int, x: int):
    """Return a row's number at x, and the sum of its two neighbours in it."""
    row = mirror(y, raw.shape[0])
    cols = raw.shape[1]
    sides = digitise(raw[row, mirror(x - 1, cols)], converter) + digitise(
        raw[row, mirror(x + 1, cols)], converter
    )
    return wp.vec2i(digitise(raw[row, x], converter), sides)


@wp.func
def interpolate(
    up: wp.vec2i,
    here: wp.vec2i,
    down: wp.vec2i,
    is_own: bool,
    is_red_row: bool,
    black_level: float,
    scale: float,
):
    """Return red, green and blue of a pixel from its line and its two neighbours."""
    vertical = up[0] + down[0]
    own = 2 * here[1]
    green = 4 * here[0]
    other = 2 * vertical
    if is_own:
        own = 4 * here[0]
        green = here[1] + vertical
        other = up[1] + down[1]
    colors = wp.vec3(
        (0.25 * float(own) - black_level) * scale,
        (0.25 * float(green) - black_level) * scale,
        (0.25 * float(other) - black_level) * scale,
    )
    if is_red_row:
        return colors
    return wp.vec3(colors[2], colors[1], colors[0])
