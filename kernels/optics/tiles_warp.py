"""Tiles that local memory does not hold: cut, transformed by `common.fft`, folded, placed."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import value_at
from gpusim.kernels.optics.mosaic_warp import times

wp.set_module_options({"enable_backward": False})


@wp.kernel
def cut(
    # in:
    planes: wp.array3d[float],
    # out:
    parts: wp.array3d[float],
    # params:
    border: int,
    first: int,
    valid: int,
    before: int,
    # sizes:
    all_parts: int,
    count: int,
    rows: int,
    cols: int,
    side: int,
    across: int,
):
    part, y, x = wp.tid()
    tile = first + part // count
    v = tile // across * valid - before + y
    u = tile % across * valid - before + x
    parts[part, y, x] = value_at(planes, part % count, v, u, rows, cols, border)


@wp.kernel
def fold(
    # in:
    spectra: wp.array4d[float],
    tables: wp.array4d[float],
    mix: wp.array2d[float],
    roots: wp.array2d[float],
    of: wp.array[int],
    # out:
    folded: wp.array4d[float],
    # params:
    own_tables: int,
    # sizes:
    tiles: int,
    count: int,
    channels: int,
    outputs: int,
    phases_y: int,
    phases_x: int,
    side: int,
    pitch: int,
    out_pitch: int,
):
    tile, y, x = wp.tid()
    rows = side // phases_y
    cols = side // phases_x
    for o in range(outputs):
        folded[tile * outputs + o, y, x, 0] = 0.0
        folded[tile * outputs + o, y, x, 1] = 0.0
    for a in range(phases_y):
        fy = y + a * rows
        for b in range(phases_x):
            fx = x + b * cols
            # Columns beyond the half that is stored are the conjugates of the opposite frequency.
            row = fy
            column = fx
            sign = float(1.0)
            if 2 * fx > side:
                column = side - fx
                row = (side - fy) % side
                sign = float(-1.0)
            for c in range(channels):
                total = wp.vec2(0.0, 0.0)
                for k in range(count):
                    weight = mix[c, k] * tables[own_tables * c, k, wp.min(fy, side - fy), column]
                    total += weight * wp.vec2(
                        spectra[tile * count + k, row, column, 0],
                        sign * spectra[tile * count + k, row, column, 1],
                    )
                for o in range(outputs):
                    if of[o] == c:
                        dy = int(0)
                        dx = int(0)
                        if phases_y * phases_x > 1:
                            dy = o // phases_x
                            dx = o % phases_x
                        v = fy * dy % side
                        u = fx * dx % side
                        turn = times(
                            wp.vec2(roots[v, 0], roots[v, 1]), wp.vec2(roots[u, 0], roots[u, 1])
                        )
                        value = times(total, turn)
                        folded[tile * outputs + o, y, x, 0] = (
                            folded[tile * outputs + o, y, x, 0] + value[0]
                        )
                        folded[tile * outputs + o, y, x, 1] = (
                            folded[tile * outputs + o, y, x, 1] + value[1]
                        )


@wp.kernel
def place(
    # in:
    pixels: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    first: int,
    valid: int,
    overlap: int,
    scale: float,
    # sizes:
    parts: int,
    images: int,
    outputs: int,
    out_rows: int,
    out_cols: int,
    phases_y: int,
    phases_x: int,
    side: int,
    across: int,
):
    part, v, u = wp.tid()
    tile = first + part // images
    image = part % images
    y = tile // across * valid + v
    x = tile % across * valid + u
    if y < out_rows and x < out_cols:
        fy = v + overlap
        fx = u + overlap
        o = image
        if images == 1 and phases_y * phases_x > 1:
            o = fy % phases_y * phases_x + fx % phases_x
        out[image, y, x] = (
            scale * pixels[part // images * outputs + o, fy // phases_y, fx // phases_x]
        )
