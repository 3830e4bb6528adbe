"""The pyramid, the blocks' noise and the way back, as in multiscale.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})

LEFT = wp.constant(8)
TOP = wp.constant(3)


@wp.func
def mirror_index(i: int, size: int):
    """Return the pixel in place of one outside, mirrored with the end repeated."""
    j = int(i)
    if i < 0:
        j = -1 - i
    elif i >= size:
        j = 2 * size - 1 - i
    return wp.clamp(j, 0, size - 1)


@wp.func
def node_before(i: int, nodes: int, size: int):
    """Return the node before pixel i, of nodes that are even from edge to edge, and the fraction."""
    place = (2 * i + 1) * (nodes - 1)
    before = place / (2 * size)
    return before, float(place - before * 2 * size) / float(2 * size)


@wp.func
def gain_at(
    gains: wp.array2d[float],
    y: int,
    x: int,
    rows: int,
    cols: int,
    ny: int,
    nx: int,
    shaded: int,
):
    """Return the gain of the shading correction that was applied to a pixel."""
    gain = float(1.0)
    if shaded != 0:
        j, v = node_before(y, ny, rows)
        i, u = node_before(x, nx, cols)
        near = (1.0 - u) * gains[j, i] + u * gains[j, i + 1]
        far = (1.0 - u) * gains[j + 1, i] + u * gains[j + 1, i + 1]
        gain = (1.0 - v) * near + v * far
    return gain


@wp.kernel
def split(
    # in:
    planes: wp.array3d[float],
    gains: wp.array2d[float],
    axes: wp.array2d[float],
    # out:
    values: wp.array3d[float],
    # params:
    offset: float,
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    ny: int,
    nx: int,
    channels: int,
    shaded: int,
):
    y, x = wp.tid()
    v = mirror_index(y - TOP, rows)
    u = mirror_index(x - LEFT, cols)
    gain = gain_at(gains, v, u, rows, cols, ny, nx, shaded)
    for a in range(channels):
        sum = float(0.0)
        for c in range(channels):
            value = planes[c, v, u] / gain + offset
            root = wp.sqrt(wp.abs(value))
            sum += axes[a, c] * wp.where(value < 0.0, -root, root)
        values[a, y, x] = sum


@wp.kernel
def halve(
    # in:
    values: wp.array3d[float],
    # out:
    means: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    high: int,
    across: int,
    wide: int,
):
    axis, y, x = wp.tid()
    v = 2 * mirror_index(y - TOP, high)
    u = 2 * mirror_index(x - LEFT, across)
    w = wp.min(v + 1, rows - 1) + TOP
    t = wp.min(u + 1, cols - 1) + LEFT
    v += TOP
    u += LEFT
    upper = values[axis, v, u] + values[axis, v, t]
    means[axis, y, x] = 0.25 * (upper + (values[axis, w, u] + values[axis, w, t]))


@wp.func
def walsh(a: float, b: float, c: float, d: float):
    left = a + b
    right = c + d
    fall = a - b
    rise = c - d
    return wp.vec4(left + right, left - right, fall - rise, fall + rise)


@wp.func
def noise_part(coefficient: wp.vec4, scale: wp.vec4):
    squares = wp.cw_mul(coefficient, coefficient)
    part = wp.vec4(1.5, 1.5, 1.5, 1.5) - wp.cw_mul(squares, scale)
    part = wp.max(wp.min(part, wp.vec4(1.0, 1.0, 1.0, 1.0)), wp.vec4())
    return wp.cw_mul(coefficient, part)


@wp.func
def block_noise(first: wp.vec4, second: wp.vec4, third: wp.vec4, fourth: wp.vec4, scale: wp.mat44):
    """Return what a block of these four rows removes, a row of Walsh coefficients per row."""
    up = first + second
    low = third + fourth
    fall = first - second
    rise = third - fourth
    mean = noise_part(up + low, scale[0])
    mean[0] = 0.0
    half_part = noise_part(up - low, scale[1])
    bump = noise_part(fall - rise, scale[2])
    zigzag = noise_part(fall + rise, scale[3])
    same = mean + half_part
    other = mean - half_part
    one = bump + zigzag
    two = bump - zigzag
    return wp.matrix_from_rows(same + one, same - one, other - two, other + two)


@wp.kernel
def shrink(
    # in:
    values: wp.array3d[float],
    scales: wp.array3d[float],
    # out:
    parts: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    wide: int,
    band: int,
):
    axis, strip, x = wp.tid()
    y0 = strip * band
    u = 2 * x + LEFT - 4
    scale = wp.mat44()
    for k in range(4):
        for j in range(4):
            scale[k, j] = scales[axis, k, j]
    a1 = wp.vec4()
    a2 = wp.vec4()
    a3 = wp.vec4()
    b1 = wp.vec4()
    b2 = wp.vec4()
    b3 = wp.vec4()
    removed1 = wp.vec4()
    removed2 = wp.vec4()
    removed3 = wp.vec4()
    added1 = wp.vec4()
    added2 = wp.vec4()
    added3 = wp.vec4()
    last = wp.min(band, rows - y0) + TOP
    for y in range(-3, last):
        row = y0 + y + 3
        one = values[axis, row, u + 1]
        two = values[axis, row, u + 2]
        three = values[axis, row, u + 3]
        a4 = walsh(values[axis, row, u], one, two, three)
        b4 = walsh(one, two, three, values[axis, row, u + 4])
        if y >= 0:
            first = block_noise(a1, a2, a3, a4, scale)
            second = block_noise(b1, b2, b3, b4, scale)
            if y >= TOP:
                done = removed1 + first[0]
                more = added1 + second[0]
                done = walsh(done[0], done[1], done[2], done[3])
                more = walsh(more[0], more[1], more[2], more[3])
                to = y0 + y - TOP
                parts[5 * axis, to, x] = done[0]
                parts[5 * axis + 1, to, x] = done[1] + more[0]
                parts[5 * axis + 2, to, x] = done[2] + more[1]
                parts[5 * axis + 3, to, x] = done[3] + more[2]
                parts[5 * axis + 4, to, x] = more[3]
            removed1 = removed2 + first[1]
            removed2 = removed3 + first[2]
            removed3 = first[3]
            added1 = added2 + second[1]
            added2 = added3 + second[2]
            added3 = second[3]
        a1 = a2
        a2 = a3
        a3 = a4
        b1 = b2
        b2 = b3
        b3 = b4


@wp.kernel
def gather(
    # in:
    parts: wp.array3d[float],
    # out:
    noise: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    wide: int,
):
    axis, y, x = wp.tid()
    half_x = x / 2
    first = 5 * axis + x % 2
    sum = parts[first, y, half_x + 2] + parts[first + 2, y, half_x + 1]
    if x % 2 == 0:
        sum += parts[first + 4, y, half_x]
    noise[axis, y, x] = sum * (1.0 / 256.0)


@wp.kernel
def compare(
    # in:
    noise: wp.array3d[float],
    # inout:
    coarse: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    high: int,
    across: int,
    wide: int,
):
    axis, y, x = wp.tid()
    v = wp.min(2 * y + 1, rows - 1)
    u = wp.min(2 * x + 1, cols - 1)
    upper = noise[axis, 2 * y, 2 * x] + noise[axis, 2 * y, u]
    mean = 0.25 * (upper + (noise[axis, v, 2 * x] + noise[axis, v, u]))
    coarse[axis, y, x] = coarse[axis, y, x] - mean


@wp.func
def interpolate(coarse: wp.array3d[float], axis: int, y: int, x: int, high: int, across: int):
    """Return the bilinear interpolation from half the resolution."""
    v = y / 2
    u = x / 2
    far = wp.clamp(v - 1 + 2 * (y % 2), 0, high - 1)
    next = wp.clamp(u - 1 + 2 * (x % 2), 0, across - 1)
    near_sum = 0.75 * coarse[axis, v, u] + 0.25 * coarse[axis, v, next]
    far_sum = 0.75 * coarse[axis, far, u] + 0.25 * coarse[axis, far, next]
    return 0.75 * near_sum + 0.25 * far_sum


@wp.kernel
def merge(
    # in:
    coarse: wp.array3d[float],
    # inout:
    noise: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    high: int,
    across: int,
    wide: int,
):
    axis, y, x = wp.tid()
    noise[axis, y, x] = noise[axis, y, x] + interpolate(coarse, axis, y, x, high, across)


@wp.kernel
def join(
    # in:
    values: wp.array3d[float],
    noise: wp.array3d[float],
    coarse: wp.array3d[float],
    gains: wp.array2d[float],
    inverse: wp.array2d[float],
    share: wp.array[float],
    loss: wp.array[float],
    # out:
    planes: wp.array3d[float],
    # params:
    offset: float,
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    pitch: int,
    high: int,
    across: int,
    wide: int,
    ny: int,
    nx: int,
    channels: int,
    shaded: int,
):
    y, x = wp.tid()
    gain = gain_at(gains, y, x, rows, cols, ny, nx, shaded)
    for c in range(channels):
        root = float(0.0)
        for a in range(channels):
            clean = values[a, y + TOP, x + LEFT] - noise[a, y, x]
            root += inverse[c, a] * (clean - interpolate(coarse, a, y, x, high, across))
        near = wp.min(loss[1] / (loss[0] + root * root), 1.0)
        lost = (((loss[2] * near + loss[3]) * near + loss[4]) * near + loss[5]) * near + loss[6]
        planes[c, y, x] = gain * (root * wp.abs(root) - offset + share[c] * lost)
