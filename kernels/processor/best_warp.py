"""The steps of best.cl as kernels, one pair of columns (2 q, 2 q + 1) of the scratch planes per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own, mirror, own_plane

wp.set_module_options({"enable_backward": False, "fuse_fp": False})  # mirrored mosaic, mirrored picture

MARGIN = wp.constant(14)
EDGE = wp.constant(5.0 / 255.0)
STEEP = wp.constant(1.0e4)
DARK = wp.constant(10.0 / 255.0)
ALIKE = wp.constant(2.0 / 255.0)
COLORED = wp.constant(0.3)
KEPT_REACH = wp.constant(3.0)
PLANE = wp.array2d[float]


@wp.func
def encode(x: float, root: int):
    if root == 0:
        return x
    return wp.where(x < 0.0, -wp.sqrt(-x), wp.sqrt(x))


@wp.func
def decode(code: float, offset: float, variance: float, root: int):
    """Most of the noise's share of the square is gone."""
    return wp.where(root == 0, code, code * wp.abs(code) - (offset - 0.75 * variance))


@wp.func
def noise_of(level: float, variance: float, shot: float):
    return variance + shot * wp.max(level, 0.0)


@wp.func
def draw(value: float, smooth: float, noise: float, kept: float, reach: float):
    """Return `value` drawn towards `smooth`, the more the less their difference exceeds the noise."""
    change = value - smooth
    square = change * change
    return smooth + change * (square + kept * noise) / (square + reach * noise + 1.0e-20)


@wp.func
def blend(p: float, q: float, r: float, s: float, limit: float):
    """Mean of (p, q) and (r, s) with weights 1 / (|p - q| + limit), 1 / (|r - s| + limit)."""
    first = wp.abs(r - s) + limit
    second = wp.abs(p - q) + limit
    return 0.5 * ((p + q) * first + (r + s) * second) / (first + second)


@wp.func
def at(plane: PLANE, y: int, x: int):
    """Return column x of a row that is its even columns, then its odd ones."""
    return plane[y, (x >> 1) + (x & 1) * (plane.shape[1] / 2)]


@wp.func
def along(plane: PLANE, y: int, x: int, i: int, j: int, vertical: int):
    """Return the pixel i steps along and j across."""
    if vertical == 1:
        return at(plane, y + i, x + j)
    return at(plane, y + j, x + i)


@wp.func
def own_bend(code: PLANE, y: int, x: int, i: int, vertical: int):
    return 2.0 * along(code, y, x, i, 0, vertical) - (
        along(code, y, x, i - 2, 0, vertical) + along(code, y, x, i + 2, 0, vertical))


@wp.func
def other_bend(code: PLANE, y: int, x: int, i: int, vertical: int):
    return 0.5 * ((along(code, y, x, i - 1, 0, vertical) + along(code, y, x, i + 1, 0, vertical))
                  - (along(code, y, x, i - 3, 0, vertical) + along(code, y, x, i + 3, 0, vertical)))


@wp.func
def difference(code: PLANE, y: int, x: int, vertical: int, variance: float, shot: float, prior: float):
    """Return the interpolated other colour of the row (column) minus the own one."""
    before = other_bend(code, y, x, -1, vertical)
    after = other_bend(code, y, x, 1, vertical)
    sides = along(code, y, x, -1, 0, vertical) + along(code, y, x, 1, 0, vertical)
    product = own_bend(code, y, x, -1, vertical) * before + own_bend(code, y, x, 1, vertical) * after
    damping = 2.0 * prior + 10.0 * noise_of(0.5 * sides, variance, shot)
    gain = wp.clamp((product + 2.0 * prior) / (before * before + after * after + damping), 0.0, 1.0)
    return 0.5 * sides + 0.25 * gain * own_bend(code, y, x, 0, vertical) - at(code, y, x)


@wp.func
def step(d: PLANE, y: int, x: int, i: int, vertical: int):
    """Return how d changes across pixel i, over three lines."""
    first = wp.abs(along(d, y, x, i - 1, -1, vertical) - along(d, y, x, i + 1, -1, vertical))
    last = wp.abs(along(d, y, x, i - 1, 1, vertical) - along(d, y, x, i + 1, 1, vertical))
    return (first + last) + wp.abs(along(d, y, x, i - 1, 0, vertical) - along(d, y, x, i + 1, 0, vertical))


@wp.func
def taps(d: PLANE, y: int, x: int, vertical: int):
    """Return one axis's estimates of green - own by short and long taps, their weight, and its denominator."""
    middle = step(d, y, x, 0, vertical)
    before = EDGE + (((middle + step(d, y, x, -1, vertical)) + step(d, y, x, -2, vertical))
                     + step(d, y, x, -3, vertical))
    after = EDGE + (((middle + step(d, y, x, 1, vertical)) + step(d, y, x, 2, vertical))
                    + step(d, y, x, 3, vertical))
    before = wp.min(before, STEEP)
    after = wp.min(after, STEEP)
    before = before * before
    after = after * after
    here = at(d, y, x)  # signs alternate with the colour
    last = along(d, y, x, -1, 0, vertical)
    following = along(d, y, x, 1, 0, vertical)
    long_before = ((here - last) + along(d, y, x, -2, 0, vertical)) + (
        along(d, y, x, -4, 0, vertical) - along(d, y, x, -3, 0, vertical))
    long_after = ((here - following) + along(d, y, x, 2, 0, vertical)) + (
        along(d, y, x, 4, 0, vertical) - along(d, y, x, 3, 0, vertical))
    return wp.vec4(after * (0.6 * here - 0.4 * last) + before * (0.6 * here - 0.4 * following),
                   0.2 * (after * long_before + before * long_after), before + after, before * after)


@wp.func
def ring(plane: PLANE, y: int, x: int, j: int, i: int):
    """Return the sum of the four pixels at (+-j, +-i)."""
    return (at(plane, y - j, x - i) + at(plane, y + j, x + i)) + (at(plane, y - j, x + i) + at(plane, y + j, x - i))


@wp.func
def cross(plane: PLANE, y: int, x: int, n: int):
    """Return the sum of the four pixels n steps away along the axes."""
    return (at(plane, y - n, x) + at(plane, y + n, x)) + (at(plane, y, x - n) + at(plane, y, x + n))


@wp.func
def gain_of(product: float, square: float, sites: float, noise: float, prior: float):
    damping = sites * prior + 5.0 * sites * noise
    return wp.clamp((product + sites * prior) / (square + damping), 0.0, 1.0)


@wp.func
def line(plane: PLANE, y: int, x: int, j: int, vertical: int):
    return (along(plane, y, x, -3, j, vertical) + along(plane, y, x, 3, j, vertical)) + (
        along(plane, y, x, -1, j, vertical) + along(plane, y, x, 1, j, vertical))


@wp.func
def sites_along(plane: PLANE, y: int, x: int, vertical: int):
    return (line(plane, y, x, -2, vertical) + line(plane, y, x, 2, vertical)) + line(plane, y, x, 0, vertical)


@wp.func
def rest(plane: PLANE, green: PLANE, y: int, x: int, gain: float):
    return at(plane, y, x) - gain * at(green, y, x)


@wp.func
def axial_at(code: PLANE, other: PLANE, green: PLANE, square: PLANE, product: PLANE, y: int, x: int, vertical: int,
             variance: float, shot: float, prior: float):
    """Return, at a green site, the colour that is measured along one axis, and was found across it."""
    level = at(green, y, x)
    noise = noise_of(level, variance, shot)
    gain = gain_of(sites_along(product, y, x, vertical), sites_along(square, y, x, vertical), 12.0, noise, prior)
    dy = vertical
    dx = 1 - vertical
    return gain * level + blend(rest(code, green, y - dy, x - dx, gain), rest(code, green, y + dy, x + dx, gain),
                                rest(other, green, y - dx, x - dy, gain), rest(other, green, y + dx, x + dy, gain),
                                ALIKE + 2.0 * wp.sqrt(noise))


@wp.kernel
def encode_all(raw: wp.array2d[wp.uint16], code: PLANE, low: int,
               black_level: float, scale: float, offset: float, variance: float, shot: float,
               longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
               rows: int, cols: int, root: int, noisy: int):
    y, q = wp.tid()
    row = mirror(y - MARGIN, rows)
    for e in range(2):
        number = float(raw[row, mirror(2 * q + e - MARGIN, cols)])
        code[y, q + e * half] = encode((number - black_level) * scale + offset, root)


@wp.kernel
def differences(code: PLANE, across: PLANE, down: PLANE, low: int,
                black_level: float, scale: float, offset: float, variance: float, shot: float,
                longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
                rows: int, cols: int, root: int, noisy: int):
    i, j = wp.tid()
    y = i + low
    q = j + low / 2
    for e in range(2):
        across[y, q + e * half] = difference(code, y, 2 * q + e, 0, variance, shot, prior)
        down[y, q + e * half] = difference(code, y, 2 * q + e, 1, variance, shot, prior)


@wp.kernel
def greens(code: PLANE, across: PLANE, down: PLANE, green: PLANE, low: int,
           black_level: float, scale: float, offset: float, variance: float, shot: float,
           longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
           rows: int, cols: int, root: int, noisy: int):
    i, j = wp.tid()
    y = i + low
    q = j + low / 2
    own = first_own(y - MARGIN, red_row, red_col)
    x = 2 * q + own
    here = at(code, y, x)
    axial = cross(code, y, x, 1)
    h = taps(across, y, x, 0)
    v = taps(down, y, x, 1)
    share = 1.0 / (h[2] * v[3] + v[2] * h[3])
    short_taps = (h[0] * v[3] + v[0] * h[3]) * share
    long_taps = (h[1] * v[3] + v[1] * h[3]) * share
    level = 0.25 * here + 0.125 * axial + 0.0625 * ring(code, y, x, 1, 1)
    alike = COLORED * (wp.max(level, 0.0) + DARK)
    alike = alike * alike
    apart = long_taps * long_taps
    alpha = (longest * alike + shortest * apart) / (alike + apart)
    value = here + (short_taps + alpha * (long_taps - short_taps))
    if noisy == 1:
        value = draw(value, 0.25 * axial, noise_of(0.25 * axial, variance, shot), 0.0, 4.0)
    green[y, q + own * half] = value
    x = 2 * q + 1 - own
    value = at(code, y, x)
    if noisy == 1:
        mean = 0.25 * ring(code, y, x, 1, 1)
        value = draw(value, mean, noise_of(mean, variance, shot), 0.2, KEPT_REACH)
    green[y, q + (1 - own) * half] = value


@wp.kernel
def slopes(code: PLANE, green: PLANE, square: PLANE, product: PLANE, low: int,
           black_level: float, scale: float, offset: float, variance: float, shot: float,
           longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
           rows: int, cols: int, root: int, noisy: int):
    i, j = wp.tid()
    y = i + low
    q = j + low / 2
    own = first_own(y - MARGIN, red_row, red_col)
    x = 2 * q + own
    green_h = own_bend(green, y, x, 0, 0)
    green_v = own_bend(green, y, x, 0, 1)
    square[y, q + own * half] = green_h * green_h + green_v * green_v
    product[y, q + own * half] = green_h * own_bend(code, y, x, 0, 0) + green_v * own_bend(code, y, x, 0, 1)


@wp.kernel
def diagonals(code: PLANE, green: PLANE, square: PLANE, product: PLANE, other: PLANE, low: int,
              black_level: float, scale: float, offset: float, variance: float, shot: float,
              longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
              rows: int, cols: int, root: int, noisy: int):
    i, j = wp.tid()
    y = i + low
    q = j + low / 2
    own = first_own(y - MARGIN, red_row, red_col)
    x = 2 * q + own
    level = at(green, y, x)
    noise = noise_of(level, variance, shot)
    gain = gain_of(
        (ring(product, y, x, 1, 1) + ring(product, y, x, 3, 3)) + (ring(product, y, x, 1, 3)
                                                                   + ring(product, y, x, 3, 1)),
        (ring(square, y, x, 1, 1) + ring(square, y, x, 3, 3)) + (ring(square, y, x, 1, 3) + ring(square, y, x, 3, 1)),
        16.0, noise, prior)
    other[y, q + own * half] = gain * level + blend(
        rest(code, green, y - 1, x - 1, gain), rest(code, green, y + 1, x + 1, gain),
        rest(code, green, y - 1, x + 1, gain), rest(code, green, y + 1, x - 1, gain), ALIKE + 2.0 * wp.sqrt(noise))


@wp.kernel
def colors(raw: wp.array2d[wp.uint16], code: PLANE, green: PLANE, square: PLANE, product: PLANE, other: PLANE,
           rgb: wp.array3d[float], low: int,
           black_level: float, scale: float, offset: float, variance: float, shot: float,
           longest: float, shortest: float, prior: float, red_row: int, red_col: int, half: int,
           rows: int, cols: int, root: int, noisy: int):
    row, pair = wp.tid()
    y = row + low
    first = own_plane(row, red_row)
    own = first_own(row, red_row, red_col)
    column = 2 * pair + own
    x = column + low
    if column < cols:
        value = (float(raw[row, column]) - black_level) * scale  # exactly what was measured, not a squared root
        if noisy == 1:
            mean = 0.25 * cross(code, y, x, 2)
            value = decode(draw(at(code, y, x), mean, noise_of(mean, variance, shot), 0.2, KEPT_REACH),
                           offset, variance, root)
        rgb[first, row, column] = value
        rgb[1, row, column] = decode(at(green, y, x), offset, variance, root)
        rgb[2 - first, row, column] = decode(at(other, y, x), offset, variance, root)
    column = 2 * pair + 1 - own
    x = column + low
    if column < cols:
        value = (float(raw[row, column]) - black_level) * scale
        if noisy == 1:
            value = decode(at(green, y, x), offset, variance, root)
        measured_along = axial_at(code, other, green, square, product, y, x, 0, variance, shot, prior)
        measured_across = axial_at(code, other, green, square, product, y, x, 1, variance, shot, prior)
        rgb[first, row, column] = decode(measured_along, offset, variance, root)
        rgb[1, row, column] = value
        rgb[2 - first, row, column] = decode(measured_across, offset, variance, root)
