"""As multiscale.cl, for Warp's CPU device; GPUs run multiscale_groups.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})

LEFT = wp.constant(8)
TOP = wp.constant(3)
CHUNK = wp.constant(128)  # columns of a work-item of `shrink`, as in multiscale.py
BEGINS = wp.constant(131)  # columns in which blocks begin that reach them
REACHED = wp.constant(134)  # columns that these blocks reach


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
    noise: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    wide: int,
    band: int,
):
    axis, strip, chunk = wp.tid()
    y0 = strip * band
    x0 = chunk * CHUNK
    scale = wp.mat44()
    for k in range(4):
        for j in range(4):
            scale[k, j] = scales[axis, k, j]
    along = wp.zeros(shape=(4, BEGINS), dtype=wp.vec4)  # rows of coefficients of four rows
    removed = wp.zeros(shape=(4, BEGINS), dtype=wp.vec4)  # the same of what blocks remove
    last = wp.min(band, rows - y0) + TOP
    for y in range(-3, last):
        row = y0 + y + 3
        fresh = (y + 3) % 4
        for i in range(BEGINS):
            u = x0 + i + LEFT - 3
            along[fresh, i] = walsh(
                values[axis, row, u],
                values[axis, row, u + 1],
                values[axis, row, u + 2],
                values[axis, row, u + 3],
            )
        if y >= 0:
            r0 = y % 4
            r1 = (y + 1) % 4
            r2 = (y + 2) % 4
            sums = wp.zeros(shape=(REACHED,), dtype=float)
            for i in range(BEGINS):
                part = block_noise(along[r0, i], along[r1, i], along[r2, i], along[fresh, i], scale)
                done = removed[r0, i] + part[0]
                removed[r0, i] = wp.vec4()
                removed[r1, i] = removed[r1, i] + part[1]
                removed[r2, i] = removed[r2, i] + part[2]
                removed[fresh, i] = removed[fresh, i] + part[3]
                done = walsh(done[0], done[1], done[2], done[3])
                for j in range(4):
                    sums[i + j] = sums[i + j] + done[j]
            if y >= TOP:
                for i in range(CHUNK):
                    noise[axis, y0 + y - TOP, x0 + i] = sums[i + 3] * (1.0 / 256.0)


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
