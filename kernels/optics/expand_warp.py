"""One pixel of one term or channel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def chebyshev(degree: int, x: float):  # degree 1 or more
    before = float(1.0)
    now = float(x)
    for _n in range(2, degree + 1):
        following = 2.0 * x * now - before
        before = now
        now = following
    return now


@wp.func
def circle(cover: float, weighted: float, low: float, high: float):
    # of confusion of a pixel, which its coverage multiplies
    away = float(0.0)
    if wp.abs(cover) > 1.0e-6:
        away = weighted / cover
    return wp.clamp(low + away, low, high)


@wp.kernel
def terms(
    # in:
    cover: wp.array3d[float],
    tile_y: wp.array[int],
    tile_x: wp.array[int],
    term_y: wp.array2d[float],
    term_x: wp.array2d[float],
    spans: wp.array2d[float],
    degrees: wp.array[int],
    # out:
    out: wp.array3d[float],
    # params:
    low: float,
    high: float,
    # sizes:
    count: int,
    rows: int,
    cols: int,
    tiles_x: int,
):
    k, y, x = wp.tid()
    tile = tile_y[y] * tiles_x + tile_x[x]
    degree = degrees[k]
    value = term_y[k, y] * term_x[k, x]
    if degree > 0:
        away = circle(cover[0, y, x], cover[1, y, x], low, high) - spans[tile, 0]
        value *= chebyshev(degree, wp.clamp(away * spans[tile, 1], -1.0, 1.0))
    out[k, y, x] = value


@wp.kernel
def gains(
    # in:
    cover: wp.array3d[float],
    tile_y: wp.array[int],
    tile_x: wp.array[int],
    along_y: wp.array[float],
    along_x: wp.array[float],
    spans: wp.array2d[float],
    even: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    low: float,
    high: float,
    # sizes:
    terms_: int,
    channels: int,
    rows: int,
    cols: int,
    tiles_x: int,
    tiles: int,
):
    c, y, x = wp.tid()
    tile = tile_y[y] * tiles_x + tile_x[x]
    away = circle(cover[0, y, x], cover[1, y, x], low, high) - spans[tile, 0]
    flat = 1.0 + even[c, tile, 0] + even[c, tile, 1] * along_y[y] + even[c, tile, 2] * along_x[x]
    out[terms_ + c, y, x] = 1.0 / (flat + even[c, tile, 3] * wp.clamp(away, -2.0, 2.0))
