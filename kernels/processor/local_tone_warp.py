"""Blocks in stops, a guided filter on them, and the gain of each pixel: as local_tone.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.nodes_warp import between

wp.set_module_options({"enable_backward": False})


@wp.kernel
def measure_blocks(
    # in:
    rgb: wp.array3d[float],
    luminance: wp.array1d[float],
    # out:
    base: wp.array2d[float],
    # params:
    darkest: float,
    # sizes:
    size: int,
    rows: int,
    cols: int,
    ny: int,
    nx: int,
):
    j, i = wp.tid()
    total = float(0.0)
    count = int(0)
    for y in range(j * size, wp.min((j + 1) * size, rows)):
        for x in range(i * size, wp.min((i + 1) * size, cols)):
            pair = luminance[0] * rgb[0, y, x] + luminance[1] * rgb[1, y, x]
            light = pair + luminance[2] * rgb[2, y, x]
            if wp.isfinite(light):
                total += light
                count += 1
    base[j, i] = wp.log2(wp.max(total / float(wp.max(count, 1)), 0.0) + darkest)


@wp.kernel
def add_rows(
    # in:
    base: wp.array2d[float],
    # out:
    lines: wp.array3d[float],
    # sizes:
    ny: int,
    nx: int,
    reach: int,
):
    j, i = wp.tid()
    first = wp.max(i - reach, 0)
    last = wp.min(i + reach, nx - 1)
    total = float(0.0)
    squares = float(0.0)
    for x in range(first, last + 1):
        value = base[j, x]
        total += value
        squares += value * value
    lines[0, j, i] = total / float(last - first + 1)
    lines[1, j, i] = squares / float(last - first + 1)


@wp.kernel
def fit(
    # in:
    lines: wp.array3d[float],
    # out:
    fitted: wp.array3d[float],
    # params:
    edge: float,
    # sizes:
    ny: int,
    nx: int,
    reach: int,
):
    j, i = wp.tid()
    first = wp.max(j - reach, 0)
    last = wp.min(j + reach, ny - 1)
    total = float(0.0)
    squares = float(0.0)
    for y in range(first, last + 1):
        total += lines[0, y, i]
        squares += lines[1, y, i]
    mean = total / float(last - first + 1)
    variance = wp.max(squares / float(last - first + 1) - mean * mean, 0.0)
    slope = variance / (variance + edge)
    fitted[0, j, i] = slope
    fitted[1, j, i] = (1.0 - slope) * mean


@wp.kernel
def mean_rows(
    # in:
    values: wp.array3d[float],
    # out:
    lines: wp.array3d[float],
    # sizes:
    planes: int,
    ny: int,
    nx: int,
    reach: int,
):
    p, j, i = wp.tid()
    first = wp.max(i - reach, 0)
    last = wp.min(i + reach, nx - 1)
    total = float(0.0)
    for x in range(first, last + 1):
        total += values[p, j, x]
    lines[p, j, i] = total / float(last - first + 1)


@wp.kernel
def mean_columns(
    # in:
    lines: wp.array3d[float],
    # out:
    smooth: wp.array3d[float],
    # sizes:
    planes: int,
    ny: int,
    nx: int,
    reach: int,
):
    p, j, i = wp.tid()
    first = wp.max(j - reach, 0)
    last = wp.min(j + reach, ny - 1)
    total = float(0.0)
    for y in range(first, last + 1):
        total += lines[p, y, i]
    smooth[p, j, i] = total / float(last - first + 1)


@wp.kernel
def lift(
    # in:
    rgb: wp.array3d[float],
    luminance: wp.array1d[float],
    smooth: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    strength: float,
    per_shadow: float,
    dark: float,
    darkest: float,
    # sizes:
    size: int,
    rows: int,
    cols: int,
    ny: int,
    nx: int,
):
    y, x = wp.tid()
    pair = luminance[0] * rgb[0, y, x] + luminance[1] * rgb[1, y, x]
    light = pair + luminance[2] * rgb[2, y, x]
    down = (float(y) + 0.5) / float(size) - 0.5
    across = (float(x) + 0.5) / float(size) - 0.5
    gain = float(1.0)
    if wp.isfinite(light):
        slope = between(smooth, 0, ny, nx, down, across)
        offset = between(smooth, 1, ny, nx, down, across)
        base = slope * wp.log2(wp.max(light, 0.0) + darkest) + offset
        around = wp.max(wp.pow(2.0, base) - darkest, 0.0)
        square = around * around
        seen = float(1.0)
        if square + dark > 0.0:
            seen = square / (square + dark)
        relative = around * per_shadow
        gain += strength / (1.0 + relative * relative) * seen
    for p in range(3):
        out[p, y, x] = gain * rgb[p, y, x]
