"""The steps of best.cl: codes and differences by pixel, others by columns 2 q and 2 q + 1."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import first_own, mirror, own_plane
from gpusim.kernels.processor.adaptive_warp import blend, encode

# mirrored mosaic, mirrored picture
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MARGIN = wp.constant(14)
EDGE = wp.constant(5.0 / 255.0)
STEEP = wp.constant(1.0e4)
DARK = wp.constant(10.0 / 255.0)
ALIKE = wp.constant(2.0 / 255.0)
COLORED = wp.constant(0.3)
KEPT_REACH = wp.constant(3.0)
GREEN_REACH = wp.constant(3.5)
KEPT_FOUND = wp.constant(0.34)
KEPT_GREEN = wp.constant(0.45)
# rows of `width`, one after the other: pixel c has neighbours at c +- 1 and c +- width
PLANE = wp.array[float]


@wp.func
def decode(code: float, offset: float, root: int):
    return wp.where(root == 0, code, code * wp.abs(code) - offset)


@wp.func
def deficit(square: float, loss: wp.array[float]):
    """Return the mean minus the square of a mean root, for means without noise."""
    near = wp.min(loss[1] / (loss[0] + wp.abs(square)), 1.0)
    return (((loss[2] * near + loss[3]) * near + loss[4]) * near + loss[5]) * near + loss[6]


@wp.func
def decode_found(code: float, offset: float, loss: wp.array[float], root: int, noisy: int):
    """Return a value interpolated from codes of others: a mean that keeps a part of the noise."""
    value = decode(code, offset, root)
    if root != 0 and noisy != 0:
        value += (1.0 - KEPT_FOUND) * deficit(code * code, loss)
    return value


@wp.func
def noise_of(level: float, factor: float, variance: float, shot: float):
    return factor * (factor * variance + shot * wp.max(level, 0.0))


@wp.func
def signal_of(code: float, root: int):
    """Return the signal of a code: means of signals stay."""
    return wp.where(root == 0, code, code * wp.abs(code))


@wp.func
def draw(
    value: float,
    mean: float,
    factor: float,
    kept: float,
    reach: float,
    offset: float,
    variance: float,
    shot: float,
    root: int,
):
    """Return the code of `value` drawn towards `mean` (signals), less if they differ more."""
    change = value - mean
    apart = change
    noise = noise_of(mean, factor, variance, shot)
    if root != 0:
        noise = factor * factor * variance
        level = wp.max(0.2 * (4.0 * mean + value), noise)
        photons = wp.max(level - factor * factor * offset, 0.0) / wp.max(
            level - 1.5 * noise, 1.0e-20
        )
        power = photons * (2.0 / 3.0)
        apart = (1.0 - power) * (change / (2.0 * wp.sqrt(level))) + power * (
            encode(value, root) - encode(mean, root)
        )
    square = apart * apart
    return encode(
        mean + change * ((square + kept * noise) / (square + reach * noise + 1.0e-20)), root
    )


@wp.func
def along(plane: PLANE, c: int, width: int, i: int, j: int, vertical: int):
    """Return the pixel i steps along and j across."""
    if vertical == 1:
        return plane[c + i * width + j]
    return plane[c + j * width + i]


@wp.func
def own_bend(code: PLANE, c: int, width: int, i: int, vertical: int):
    return 2.0 * along(code, c, width, i, 0, vertical) - (
        along(code, c, width, i - 2, 0, vertical) + along(code, c, width, i + 2, 0, vertical)
    )


@wp.func
def other_bend(code: PLANE, c: int, width: int, i: int, vertical: int):
    return 0.5 * (
        (along(code, c, width, i - 1, 0, vertical) + along(code, c, width, i + 1, 0, vertical))
        - (along(code, c, width, i - 3, 0, vertical) + along(code, c, width, i + 3, 0, vertical))
    )


@wp.func
def difference(
    code: PLANE,
    c: int,
    width: int,
    vertical: int,
    factor: float,
    variance: float,
    shot: float,
    prior: float,
):
    """Return the interpolated other colour of the row (column) minus the own one."""
    before = other_bend(code, c, width, -1, vertical)
    after = other_bend(code, c, width, 1, vertical)
    sides = along(code, c, width, -1, 0, vertical) + along(code, c, width, 1, 0, vertical)
    product = (
        own_bend(code, c, width, -1, vertical) * before
        + own_bend(code, c, width, 1, vertical) * after
    )
    damping = 2.0 * prior + 10.0 * noise_of(0.5 * sides, factor, variance, shot)
    gain = wp.clamp((product + 2.0 * prior) / (before * before + after * after + damping), 0.0, 1.0)
    return 0.5 * sides + 0.25 * gain * own_bend(code, c, width, 0, vertical) - code[c]


@wp.func
def step(d: PLANE, c: int, width: int, i: int, vertical: int):
    """Return how d changes across pixel i, over three lines."""
    first = wp.abs(
        along(d, c, width, i - 1, -1, vertical) - along(d, c, width, i + 1, -1, vertical)
    )
    last = wp.abs(along(d, c, width, i - 1, 1, vertical) - along(d, c, width, i + 1, 1, vertical))
    return (first + last) + wp.abs(
        along(d, c, width, i - 1, 0, vertical) - along(d, c, width, i + 1, 0, vertical)
    )


@wp.func
def taps(d: PLANE, c: int, width: int, vertical: int):
    """Return an axis's estimates of green - own by short and long taps, weight, and denominator."""
    middle = step(d, c, width, 0, vertical)
    before = EDGE + (
        (middle + step(d, c, width, -1, vertical))
        + (step(d, c, width, -2, vertical) + step(d, c, width, -3, vertical))
    )
    after = EDGE + (
        (middle + step(d, c, width, 1, vertical))
        + (step(d, c, width, 2, vertical) + step(d, c, width, 3, vertical))
    )
    before = wp.min(before, STEEP)
    after = wp.min(after, STEEP)
    before = before * before
    after = after * after
    here = d[c]  # signs alternate with the colour
    last = along(d, c, width, -1, 0, vertical)
    following = along(d, c, width, 1, 0, vertical)
    long_before = ((here - last) + along(d, c, width, -2, 0, vertical)) + (
        along(d, c, width, -4, 0, vertical) - along(d, c, width, -3, 0, vertical)
    )
    long_after = ((here - following) + along(d, c, width, 2, 0, vertical)) + (
        along(d, c, width, 4, 0, vertical) - along(d, c, width, 3, 0, vertical)
    )
    return wp.vec4(
        after * (0.6 * here - 0.4 * last) + before * (0.6 * here - 0.4 * following),
        0.2 * (after * long_before + before * long_after),
        before + after,
        before * after,
    )


@wp.func
def ring(plane: PLANE, c: int, width: int, j: int, i: int):
    """Return the sum of the four pixels at (+-j, +-i)."""
    return (plane[c - j * width - i] + plane[c + j * width + i]) + (
        plane[c - j * width + i] + plane[c + j * width - i]
    )


@wp.func
def sites_around(plane: PLANE, c: int, width: int):
    """Return the sum of the 16 pixels 1 or 3 rows and 1 or 3 columns away."""
    return (ring(plane, c, width, 1, 1) + ring(plane, c, width, 3, 3)) + (
        ring(plane, c, width, 1, 3) + ring(plane, c, width, 3, 1)
    )


@wp.func
def cross(plane: PLANE, c: int, width: int, n: int):
    """Return the sum of the four pixels n steps away along the axes."""
    return (plane[c - n * width] + plane[c + n * width]) + (plane[c - n] + plane[c + n])


@wp.func
def cross_signal(code: PLANE, c: int, width: int, n: int, root: int):
    """Return the mean of their signals."""
    up = signal_of(code[c - n * width], root)
    left = signal_of(code[c - n], root)
    return 0.25 * (
        (up + signal_of(code[c + n * width], root)) + (left + signal_of(code[c + n], root))
    )


@wp.func
def corner_signal(code: PLANE, c: int, width: int, root: int):
    """Return the mean signal of the four diagonal neighbours."""
    first = signal_of(code[c - width - 1], root) + signal_of(code[c + width + 1], root)
    return 0.25 * (
        first + (signal_of(code[c - width + 1], root) + signal_of(code[c + width - 1], root))
    )


@wp.func
def factor_of(y: int, x: int, red_row: int, red_col: int, red: float, blue: float):
    """Return the factor of the codes of the pixel at this row and column."""
    if (x ^ first_own(y, red_row, red_col)) & 1 == 1:
        return 1.0
    return wp.where(own_plane(y, red_row) == 0, red, blue)


@wp.func
def gain_of(product: float, square: float, sites: float, noise: float, prior: float):
    damping = sites * prior + 5.0 * sites * noise
    return wp.clamp((product + sites * prior) / (square + damping), 0.0, 1.0)


@wp.func
def line(plane: PLANE, c: int, width: int, j: int, vertical: int):
    return (along(plane, c, width, -3, j, vertical) + along(plane, c, width, 3, j, vertical)) + (
        along(plane, c, width, -1, j, vertical) + along(plane, c, width, 1, j, vertical)
    )


@wp.func
def sites_along(plane: PLANE, c: int, width: int, vertical: int):
    sides = line(plane, c, width, -2, vertical) + line(plane, c, width, 2, vertical)
    return sides + line(plane, c, width, 0, vertical)


@wp.func
def rest(plane: PLANE, green: PLANE, c: int, gain: float):
    return plane[c] - gain * green[c]


@wp.func
def axial_at(
    code: PLANE,
    other: PLANE,
    green: PLANE,
    square: PLANE,
    product: PLANE,
    c: int,
    width: int,
    vertical: int,
    factor: float,
    variance: float,
    shot: float,
    prior: float,
):
    """Return, at a green site, the colour that one axis measures, interpolated across that axis."""
    level = green[c]
    noise = noise_of(level, 1.0, variance, shot)
    gain = gain_of(
        sites_along(product, c, width, vertical),
        sites_along(square, c, width, vertical),
        12.0,
        noise,
        prior,
    )
    measured = wp.where(vertical == 1, width, 1)
    found = width + 1 - measured
    return gain * level + blend(
        rest(code, green, c - measured, gain),
        rest(code, green, c + measured, gain),
        rest(other, green, c - found, gain),
        rest(other, green, c + found, gain),
        ALIKE + 2.0 * wp.sqrt(noise_of(level, factor, variance, shot)),
    )


@wp.kernel
def encode_all(
    raw: wp.array2d[wp.uint16],
    code: PLANE,
    low: int,
    width: int,
    black_level: float,
    scale: float,
    offset: float,
    red: float,
    blue: float,
    red_row: int,
    red_col: int,
    rows: int,
    cols: int,
    root: int,
):
    y, x = wp.tid()
    number = float(raw[mirror(y - MARGIN, rows), mirror(x - MARGIN, cols)])
    factor = factor_of(y - MARGIN, x - MARGIN, red_row, red_col, red, blue)
    code[y * width + x] = encode((number - black_level) * scale + offset, root) * factor


@wp.kernel
def differences(
    code: PLANE,
    across: PLANE,
    down: PLANE,
    low: int,
    width: int,
    variance: float,
    shot: float,
    red: float,
    blue: float,
    prior: float,
    red_row: int,
    red_col: int,
):
    i, j = wp.tid()
    c = (i + low) * width + j + low
    y = i + low - MARGIN
    x = j + low - MARGIN
    beside = factor_of(y, x + 1, red_row, red_col, red, blue)
    below = factor_of(y + 1, x, red_row, red_col, red, blue)
    across[c] = difference(code, c, width, 0, beside, variance, shot, prior)
    down[c] = difference(code, c, width, 1, below, variance, shot, prior)


@wp.kernel
def greens(
    code: PLANE,
    across: PLANE,
    down: PLANE,
    green: PLANE,
    low: int,
    width: int,
    loss: wp.array[float],
    offset: float,
    variance: float,
    shot: float,
    longest: float,
    shortest: float,
    red_row: int,
    red_col: int,
    root: int,
    noisy: int,
):
    i, j = wp.tid()
    y = i + low
    own = first_own(y - MARGIN, red_row, red_col)
    c = y * width + low + 2 * j + own
    here = code[c]
    axial = cross(code, c, width, 1)
    h = taps(across, c, width, 0)
    v = taps(down, c, width, 1)
    share = 1.0 / (h[2] * v[3] + v[2] * h[3])
    short_taps = (h[0] * v[3] + v[0] * h[3]) * share
    long_taps = (h[1] * v[3] + v[1] * h[3]) * share
    level = 0.25 * here + 0.125 * axial + 0.0625 * ring(code, c, width, 1, 1)
    alike = COLORED * (wp.max(level, 0.0) + DARK)
    alike = alike * alike
    apart = long_taps * long_taps
    alpha = (longest * alike + shortest * apart) / (alike + apart)
    value = here + (short_taps + alpha * (long_taps - short_taps))
    if noisy == 1:
        value_signal = signal_of(value, root)
        if root == 1:
            value_signal += (1.0 - KEPT_GREEN) * deficit(value * value, loss)
        value = draw(
            value_signal,
            cross_signal(code, c, width, 1, root),
            1.0,
            0.0,
            GREEN_REACH,
            offset,
            variance,
            shot,
            root,
        )
    green[c] = value
    c += 1 - 2 * own
    value = code[c]
    if noisy == 1:
        value = draw(
            signal_of(value, root),
            corner_signal(code, c, width, root),
            1.0,
            0.2,
            KEPT_REACH,
            offset,
            variance,
            shot,
            root,
        )
    green[c] = value


@wp.kernel
def slopes(
    code: PLANE,
    green: PLANE,
    square: PLANE,
    product: PLANE,
    low: int,
    width: int,
    red_row: int,
    red_col: int,
):
    i, j = wp.tid()
    y = i + low
    own = first_own(y - MARGIN, red_row, red_col)
    c = y * width + low + 2 * j + own
    green_h = own_bend(green, c, width, 0, 0)
    green_v = own_bend(green, c, width, 0, 1)
    square[c] = green_h * green_h + green_v * green_v
    product[c] = green_h * own_bend(code, c, width, 0, 0) + green_v * own_bend(code, c, width, 0, 1)


@wp.kernel
def diagonals(
    code: PLANE,
    green: PLANE,
    square: PLANE,
    product: PLANE,
    other: PLANE,
    low: int,
    width: int,
    variance: float,
    shot: float,
    red: float,
    blue: float,
    prior: float,
    red_row: int,
    red_col: int,
):
    i, j = wp.tid()
    y = i + low
    own = first_own(y - MARGIN, red_row, red_col)
    c = y * width + low + 2 * j + own
    level = green[c]
    noise = noise_of(level, 1.0, variance, shot)
    # of the colour that this row lacks
    factor = wp.where(own_plane(y - MARGIN, red_row) == 0, blue, red)
    limit = ALIKE + 2.0 * wp.sqrt(noise_of(level, factor, variance, shot))
    gain = gain_of(
        sites_around(product, c, width), sites_around(square, c, width), 16.0, noise, prior
    )
    other[c] = gain * level + blend(
        rest(code, green, c - width - 1, gain),
        rest(code, green, c + width + 1, gain),
        rest(code, green, c - width + 1, gain),
        rest(code, green, c + width - 1, gain),
        limit,
    )


@wp.kernel
def colors(
    raw: wp.array2d[wp.uint16],
    code: PLANE,
    green: PLANE,
    square: PLANE,
    product: PLANE,
    other: PLANE,
    rgb: wp.array3d[float],
    low: int,
    width: int,
    loss: wp.array[float],
    black_level: float,
    scale: float,
    offset: float,
    variance: float,
    shot: float,
    red: float,
    blue: float,
    prior: float,
    red_row: int,
    red_col: int,
    cols: int,
    root: int,
    noisy: int,
):
    row, pair = wp.tid()
    first = own_plane(row, red_row)
    own = first_own(row, red_row, red_col)
    own_factor = wp.where(first == 0, red, blue)
    other_factor = wp.where(first == 0, blue, red)
    own_inverse = 1.0 / own_factor
    other_inverse = 1.0 / other_factor
    column = 2 * pair + own
    c = (row + low) * width + column + low
    if column < cols:
        # exactly the measured sample, not a squared root
        value = (float(raw[row, column]) - black_level) * scale
        if noisy == 1:
            value = decode(
                draw(
                    signal_of(code[c], root),
                    cross_signal(code, c, width, 2, root),
                    own_factor,
                    0.2,
                    KEPT_REACH,
                    offset,
                    variance,
                    shot,
                    root,
                )
                * own_inverse,
                offset,
                root,
            )
        rgb[first, row, column] = value
        rgb[1, row, column] = decode(green[c], offset, root)
        rgb[2 - first, row, column] = decode_found(
            other[c] * other_inverse, offset, loss, root, noisy
        )
    column = 2 * pair + 1 - own
    c = (row + low) * width + column + low
    if column < cols:
        value = (float(raw[row, column]) - black_level) * scale
        if noisy == 1:
            value = decode(green[c], offset, root)
        measured_along = axial_at(
            code, other, green, square, product, c, width, 0, own_factor, variance, shot, prior
        )
        measured_across = axial_at(
            code, other, green, square, product, c, width, 1, other_factor, variance, shot, prior
        )
        rgb[first, row, column] = decode_found(
            measured_along * own_inverse, offset, loss, root, noisy
        )
        rgb[1, row, column] = value
        rgb[2 - first, row, column] = decode_found(
            measured_across * other_inverse, offset, loss, root, noisy
        )
