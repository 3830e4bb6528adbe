"""Two passes over pairs (own colour, green) of one row per thread, as in adaptive.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own, mirror, own_plane

# mirrored mosaic, mirrored picture
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def encode(x: float, root: int):
    """Return the code of a value: its signed root, or itself."""
    if root == 0:
        return x
    return wp.where(x < 0.0, -wp.sqrt(-x), wp.sqrt(x))


@wp.func
def decode(y: float, root: int):
    return wp.where(root == 0, y, y * wp.abs(y))


@wp.func
def blend(p: float, q: float, r: float, s: float, limit: float):
    """Return the mean of two pairs, weights 1 / (|p - q| + limit), 1 / (|r - s| + limit)."""
    first = wp.abs(r - s) + limit
    second = wp.abs(p - q) + limit
    return 0.5 * ((p + q) * first + (r + s) * second) / (first + second)


@wp.kernel
def green(
    # in:
    raw: wp.array2d[wp.uint16],
    # out:
    difference: wp.array2d[float],
    # params:
    black_level: float,
    limit: float,
    red: float,
    blue: float,
    red_row: int,
    red_col: int,
    # sizes:
    run: int,
    rows: int,
    cols: int,
    # params:
    root: int,
):
    y, item = wp.tid()
    first = first_own(y, red_row, red_col)
    factor = wp.where(own_plane(y, red_row) == 0, red, blue)
    up = mirror(y - 1, rows)
    down = mirror(y + 1, rows)
    up2 = mirror(y - 2, rows)
    down2 = mirror(y + 2, rows)
    for q in range(item * run, wp.min(item * run + run, (cols + first + 1) / 2)):
        x = 2 * q - first
        c = mirror(x, cols)
        here = factor * encode(float(raw[y, c]) - black_level, root)
        left = encode(float(raw[y, mirror(x - 1, cols)]) - black_level, root)
        right = encode(float(raw[y, mirror(x + 1, cols)]) - black_level, root)
        far_left = factor * encode(float(raw[y, mirror(x - 2, cols)]) - black_level, root)
        far_right = factor * encode(float(raw[y, mirror(x + 2, cols)]) - black_level, root)
        above = encode(float(raw[up, c]) - black_level, root)
        below = encode(float(raw[down, c]) - black_level, root)
        far_above = factor * encode(float(raw[up2, c]) - black_level, root)
        far_below = factor * encode(float(raw[down2, c]) - black_level, root)
        bend_h = 2.0 * here - (far_left + far_right)
        bend_v = 2.0 * here - (far_above + far_below)
        slope_h = wp.abs(left - right) + wp.abs(bend_h)
        slope_v = wp.abs(above - below) + wp.abs(bend_v)
        weight_h = slope_v * slope_v + limit * limit
        weight_v = slope_h * slope_h + limit * limit
        green_h = 0.5 * (left + right) + 0.25 * bend_h
        green_v = 0.5 * (above + below) + 0.25 * bend_v
        difference[y, q] = here - (weight_h * green_h + weight_v * green_v) / (weight_h + weight_v)


@wp.kernel
def colors(
    # in:
    raw: wp.array2d[wp.uint16],
    difference: wp.array2d[float],
    # out:
    rgb: wp.array3d[float],
    # params:
    scale: float,
    black_level: float,
    limit: float,
    of_red: float,
    of_blue: float,
    red_row: int,
    red_col: int,
    # sizes:
    run: int,
    rows: int,
    cols: int,
    # params:
    root: int,
):
    y, item = wp.tid()
    own = own_plane(y, red_row)
    other = 2 - own
    of_own = wp.where(own == 0, of_red, of_blue)
    own_part = 1.0 / of_own
    other_part = 1.0 / wp.where(own == 0, of_blue, of_red)
    first = first_own(y, red_row, red_col)
    up = mirror(y - 1, rows)
    down = mirror(y + 1, rows)
    up2 = mirror(y - 2, rows)
    down2 = mirror(y + 2, rows)
    for q in range(item * run, wp.min(item * run + run, (cols + first + 1) / 2)):
        x = 2 * q - first
        b = mirror(x, cols)
        e = mirror(x + 1, cols)
        k = (b + first) / 2
        last = (mirror(x + 2, cols) + first) / 2
        m = (mirror(x - 1, cols) + 1 - first) / 2
        n = (e + 1 - first) / 2
        o = (mirror(x + 3, cols) + 1 - first) / 2
        here_k = difference[y, k]
        here_l = difference[y, last]
        up_n = difference[up, n]
        down_n = difference[down, n]
        other_b = blend(difference[up, m], down_n, up_n, difference[down, m], limit)
        if x >= 0:
            value = float(raw[y, b]) - black_level
            code = of_own * encode(value, root) - here_k
            rgb[own, y, b] = value * scale
            rgb[1, y, b] = decode(code, root) * scale
            rgb[other, y, b] = decode((code + other_b) * other_part, root) * scale
        if x + 1 < cols:
            other_right = blend(up_n, difference[down, o], difference[up, o], down_n, limit)
            own_up = blend(difference[up2, k], here_l, difference[up2, last], here_k, limit)
            own_down = blend(here_k, difference[down2, last], here_l, difference[down2, k], limit)
            value = float(raw[y, e]) - black_level
            code = encode(value, root)
            own_e = blend(here_k, here_l, own_up, own_down, limit)
            other_e = blend(other_b, other_right, up_n, down_n, limit)
            rgb[own, y, e] = decode((code + own_e) * own_part, root) * scale
            rgb[1, y, e] = value * scale
            rgb[other, y, e] = decode((code + other_e) * other_part, root) * scale
