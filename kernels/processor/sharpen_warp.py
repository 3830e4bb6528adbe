"""Luminance with repeated edges, then its blur and what this has lost: as sharpen.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def measure_light(
    # in:
    rgb: wp.array3d[float],
    luminance: wp.array1d[float],
    # out:
    light: wp.array2d[float],
    # sizes:
    rows: int,
    cols: int,
    reach: int,
):
    y, x = wp.tid()
    row = wp.clamp(y - reach, 0, rows - 1)
    col = wp.clamp(x - reach, 0, cols - 1)
    pair = luminance[0] * rgb[0, row, col] + luminance[1] * rgb[1, row, col]
    light[y, x] = pair + luminance[2] * rgb[2, row, col]


@wp.kernel
def sharpen(
    # in:
    rgb: wp.array3d[float],
    light: wp.array2d[float],
    taps: wp.array2d[float],
    noise: wp.array1d[float],
    # out:
    out: wp.array3d[float],
    # params:
    strength: float,
    # sizes:
    rows: int,
    cols: int,
    reach: int,
):
    y, x = wp.tid()
    blurred = float(0.0)
    for v in range(2 * reach + 1):
        for u in range(2 * reach + 1):
            blurred += taps[v, u] * light[y + v, x + u]
    detail = light[y + reach, x + reach] - blurred
    threshold = noise[0] * wp.max(blurred, 0.0) + noise[1]
    part = float(1.0)
    if threshold > 0.0:
        part = 1.0 / (1.0 + threshold / (detail * detail))
    added = float(0.0)
    if wp.isfinite(detail):
        added = strength * (detail * part)
    for p in range(3):
        out[p, y, x] = rgb[p, y, x] + added
