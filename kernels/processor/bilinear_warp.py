"""One run of pairs (own colour, green) of one row per thread, as in bilinear.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own, mirror, own_plane

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
    y, item = wp.tid()
    own = own_plane(y, red_row)
    first = first_own(y, red_row, red_col)
    up = mirror(y - 1, rows)
    down = mirror(y + 1, rows)
    for q in range(item * run, wp.min(item * run + run, (cols + first + 1) / 2)):
        x = 2 * q - first
        a = mirror(x - 1, cols)
        b = mirror(x, cols)
        c = mirror(x + 1, cols)
        d = mirror(x + 2, cols)
        up_c = float(raw[up, c])
        here_b = float(raw[y, b])
        here_c = float(raw[y, c])
        down_c = float(raw[down, c])
        if x >= 0:
            cross = float(raw[y, a]) + here_c + float(raw[up, b]) + float(raw[down, b])
            corners = float(raw[up, a]) + up_c + float(raw[down, a]) + down_c
            rgb[own, y, b] = (here_b - black_level) * scale
            rgb[1, y, b] = (0.25 * cross - black_level) * scale
            rgb[2 - own, y, b] = (0.25 * corners - black_level) * scale
        if x + 1 < cols:
            rgb[own, y, c] = (0.5 * (here_b + float(raw[y, d])) - black_level) * scale
            rgb[1, y, c] = (here_c - black_level) * scale
            rgb[2 - own, y, c] = (0.5 * (up_c + down_c) - black_level) * scale
