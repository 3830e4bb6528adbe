"""Blocks, sums of four, colours from coarse to fine, pixels: as highlights.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.nodes_warp import between

wp.set_module_options({"enable_backward": False})


@wp.func
def part_clipped(value: float, per_top: float, first: float, span: float):
    return wp.clamp((value * per_top - first) * span, 0.0, 1.0)


@wp.kernel
def measure_blocks(
    # in:
    camera: wp.array3d[float],
    # out:
    sums: wp.array3d[float],
    # params:
    per_top: float,
    first: float,
    span: float,
    # sizes:
    rows: int,
    cols: int,
    ny: int,
    nx: int,
    channels: int,
    block: int,
):
    j, i = wp.tid()
    for c in range(channels + 1):
        sums[c, j, i] = 0.0
    for y in range(j * block, wp.min((j + 1) * block, rows)):
        for x in range(i * block, wp.min((i + 1) * block, cols)):
            total = float(0.0)
            most = float(0.0)
            known = float(1.0)
            for c in range(channels):
                value = camera[c, y, x]
                light = value
                if value < 0.0:
                    light = 0.0
                total += light
                most = wp.max(most, light)
                known *= 1.0 - part_clipped(value, per_top, first, span)
            share = wp.min(most * per_top, 1.0)
            weight = share * share * share * share * known
            if total > 0.0 and wp.isfinite(total) and weight > 0.0:
                for c in range(channels):
                    sums[c, j, i] = sums[c, j, i] + weight * (wp.max(camera[c, y, x], 0.0) / total)
                sums[channels, j, i] = sums[channels, j, i] + weight


@wp.kernel
def add_up(
    # in:
    fine: wp.array3d[float],
    # out:
    coarse: wp.array3d[float],
    # sizes:
    fine_y: int,
    fine_x: int,
    planes: int,
    ny: int,
    nx: int,
):
    p, j, i = wp.tid()
    total = fine[p, 2 * j, 2 * i]
    if 2 * i + 1 < fine_x:
        total += fine[p, 2 * j, 2 * i + 1]
    if 2 * j + 1 < fine_y:
        total += fine[p, 2 * j + 1, 2 * i]
        if 2 * i + 1 < fine_x:
            total += fine[p, 2 * j + 1, 2 * i + 1]
    coarse[p, j, i] = total


@wp.kernel
def fill(
    # in:
    sums: wp.array3d[float],
    colors: wp.array3d[float],
    # out:
    filled: wp.array3d[float],
    # params:
    trust: float,
    # sizes:
    coarse_y: int,
    coarse_x: int,
    planes: int,
    ny: int,
    nx: int,
):
    p, j, i = wp.tid()
    y = (float(j) + 0.5) * 0.5 - 0.5
    x = (float(i) + 0.5) * 0.5 - 0.5
    around = between(colors, p, coarse_y, coarse_x, y, x)
    filled[p, j, i] = (sums[p, j, i] + trust * around) / (sums[planes, j, i] + trust)


@wp.kernel
def rebuild(
    # in:
    camera: wp.array3d[float],
    colors: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    per_top: float,
    first: float,
    span: float,
    dark: float,
    most: float,
    # sizes:
    rows: int,
    cols: int,
    ny: int,
    nx: int,
    channels: int,
    block: int,
):
    row, col = wp.tid()
    total = float(0.0)
    any = float(0.0)
    for c in range(channels):
        total += camera[c, row, col]
        any = wp.max(any, part_clipped(camera[c, row, col], per_top, first, span))
    t = float(0.0)
    y = (float(row) + 0.5) / float(block) - 0.5
    x = (float(col) + 0.5) / float(block) - 0.5
    is_rebuilt = any > 0.0 and wp.isfinite(total)
    if is_rebuilt:
        above = float(0.0)
        below = float(dark)
        brightest = float(0.0)
        for c in range(channels):
            rho = between(colors, c, ny, nx, y, x)
            value = camera[c, row, col]
            known = 1.0 - part_clipped(value, per_top, first, span)
            above += known * wp.max(value, 0.0)
            below += known * rho
            brightest = wp.max(brightest, wp.max(value, 0.0) / rho)
        t = (above + dark * brightest) / below
    for c in range(channels):
        value = camera[c, row, col]
        if is_rebuilt:
            rebuilt = wp.max(wp.min(t * between(colors, c, ny, nx, y, x), most), value)
            value += part_clipped(value, per_top, first, span) * (rebuilt - value)
        out[c, row, col] = value
