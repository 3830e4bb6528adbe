"""One run of pairs (own colour, green) of one row per thread, as in malvar.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own, mirror, own_plane

wp.set_module_options({"enable_backward": False})


@wp.func
def value(neighbours: int, laplacian: int, share: float, black_level: float, scale: float):
    return ((float(neighbours) + share * float(laplacian)) * 0.0625 - black_level) * scale


@wp.kernel
def malvar(
    # in:
    raw: wp.array2d[wp.uint16],
    # out:
    rgb: wp.array3d[float],
    # params:
    black_level: float,
    scale: float,
    of_red: float,
    of_blue: float,
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
    of_own = wp.where(own == 0, of_red, of_blue)
    of_other = wp.where(own == 0, of_blue, of_red)
    uu = mirror(y - 2, rows)
    u = mirror(y - 1, rows)
    w = mirror(y + 1, rows)
    ww = mirror(y + 2, rows)
    for q in range(item * run, wp.min(item * run + run, (cols + first + 1) / 2)):
        x = 2 * q - first
        b = mirror(x - 1, cols)
        c = mirror(x, cols)
        d = mirror(x + 1, cols)
        e = mirror(x + 2, cols)
        left = int(raw[y, b])
        here = int(raw[y, c])
        right = int(raw[y, d])
        next = int(raw[y, e])
        up_c = int(raw[u, c])
        up_d = int(raw[u, d])
        down_c = int(raw[w, c])
        down_d = int(raw[w, d])
        if x >= 0:
            cross = left + right + up_c + down_c
            corners = int(raw[u, b]) + up_d + int(raw[w, b]) + down_d
            far = int(raw[y, mirror(x - 2, cols)]) + next + int(raw[uu, c]) + int(raw[ww, c])
            rgb[own, y, c] = value(16 * here, 0, 0.0, black_level, scale)
            rgb[1, y, c] = value(4 * cross, 8 * here - 2 * far, of_own, black_level, scale)
            rgb[2 - own, y, c] = value(
                4 * corners, 12 * here - 3 * far, of_own / of_other, black_level, scale
            )
        if x + 1 < cols:
            diagonal = up_c + int(raw[u, e]) + down_c + int(raw[w, e])
            along = left + int(raw[y, mirror(x + 3, cols)])
            across = int(raw[uu, d]) + int(raw[ww, d])
            rgb[own, y, d] = value(
                8 * (here + next),
                10 * right - 2 * (along + diagonal) + across,
                1.0 / of_own,
                black_level,
                scale,
            )
            rgb[1, y, d] = value(16 * right, 0, 0.0, black_level, scale)
            rgb[2 - own, y, d] = value(
                8 * (up_d + down_d),
                10 * right - 2 * (across + diagonal) + along,
                1.0 / of_other,
                black_level,
                scale,
            )
