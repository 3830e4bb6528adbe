"""Five passes as in guided.cl, one pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

LARGEST = wp.constant(131071.0)


@wp.func
def repeated(i: int, n: int, period: int):
    """Return the pixel in place of pixel i: mirrored for periods up to 2, else periods away."""
    j = i
    if period <= 2:
        span = wp.max(2 * n - 2, 1)
        j = (i % span + span) % span
        if j >= n:
            j = span - j
    elif i < 0:
        j = (i % period + period) % period
    elif i >= n:
        j = n - period + (i - n) % period
    return j


@wp.func
def place(i: int, period: int):
    return (i % period + period) % period


@wp.kernel
def encode(
    # in:
    raw: wp.array2d[wp.uint16],
    factors: wp.array[float],
    # out:
    codes: wp.array2d[int],
    # params:
    shift: float,
    zero: float,
    steps: float,
    root: int,
    reach: int,
    shift_y: int,
    shift_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
    high: int,
    wide: int,
):
    y, x = wp.tid()
    v = repeated(y - reach, rows, period_y)
    u = repeated(x - reach, cols, period_x)
    value = float(raw[v, u]) + shift
    if root != 0:
        size = wp.sqrt(wp.abs(value))
        value = wp.where(value < 0.0, -size, size) - zero
    factor = factors[(v + shift_y) % period_y * period_x + (u + shift_x) % period_x]
    codes[y, x] = int(wp.clamp(wp.floor(value * factor * steps + 0.5), -LARGEST, LARGEST))


@wp.kernel
def first(
    # in:
    codes: wp.array2d[int],
    taps: wp.array2d[int],
    weights: wp.array3d[int],
    # out:
    pictures: wp.array3d[int],
    # params:
    inner: int,
    outer: int,
    shift_y: int,
    shift_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    count: int,
    rows: int,
    cols: int,
    wide: int,
):
    y, x = wp.tid()
    position = place(y - outer + shift_y, period_y) * period_x + place(
        x - outer + shift_x, period_x
    )
    sum = wp.vec4i(1024, 1024, 1024, 1024)
    for t in range(count):
        code = codes[y + inner + taps[t, 0], x + inner + taps[t, 1]]
        for o in range(4):
            sum[o] = sum[o] + weights[position, t, o] * code
    for o in range(4):
        pictures[y, x, o] = sum[o] >> 11


@wp.func
def light(pictures: wp.array3d[int], y: int, x: int, guide: int):
    sum = pictures[y, x, guide]
    for c in range(4):
        sum += pictures[y, x, c]
    return sum


@wp.func
def tint(pictures: wp.array3d[int], v: int, u: int, w: int, t: int, guide: int, channels: int):
    """Return the contrast of colour between two pixels."""
    own = pictures[v, u, guide] - pictures[w, t, guide]
    sum = int(0)
    for c in range(channels):
        sum += wp.abs(pictures[v, u, c] - pictures[w, t, c] - own)
    return sum


@wp.func
def step(pictures: wp.array3d[int], v: int, u: int, dy: int, dx: int, guide: int):
    """Return the contrast of light between the pixels ahead and behind."""
    ahead = light(pictures, v + dy, u + dx, guide)
    return wp.abs(ahead - light(pictures, v - dy, u - dx, guide))


@wp.kernel
def contrast(
    # in:
    pictures: wp.array3d[int],
    # out:
    contrasts: wp.array3d[int],
    tints: wp.array2d[int],
    # params:
    reach: int,
    # sizes:
    rows: int,
    cols: int,
    wide: int,
    channels: int,
    guide: int,
):
    y, x = wp.tid()
    v = y + reach
    u = x + reach
    across = tint(pictures, v, u + 1, v, u - 1, guide, channels)
    tints[y, x] = across + tint(pictures, v + 1, u, v - 1, u, guide, channels)
    contrasts[y, x, 0] = step(pictures, v, u, 0, 1, guide)
    contrasts[y, x, 1] = step(pictures, v, u, 1, 0, guide)
    contrasts[y, x, 2] = step(pictures, v, u, 1, 1, guide)
    contrasts[y, x, 3] = step(pictures, v, u, 1, -1, guide)


@wp.func
def exceeds(one: int, two: int, ratio: int, least: int):
    """Return 1 if `one` exceeds `two` by the ratio [1/8], both above the floor."""
    more = wp.int64(ratio - 8) * wp.int64(least)
    return wp.where(wp.int64(8) * wp.int64(one) > wp.int64(ratio) * wp.int64(two) + more, 1, 0)


@wp.kernel
def classify(
    # in:
    contrasts: wp.array3d[int],
    tints: wp.array2d[int],
    limits: wp.array[int],
    # out:
    units: wp.array2d[int],
    # params:
    least: int,
    shift_y: int,
    shift_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    ratios: int,
    diagonals: int,
    shares: int,
    strengths: int,
    box: int,
    rows: int,
    cols: int,
):
    y, x = wp.tid()
    sum = wp.vec4i()
    colors = wp.int64(0)
    for v in range(2 * box + 1):
        for u in range(2 * box + 1):
            colors += wp.int64(tints[y + v, x + u])
            for k in range(4):
                sum[k] = sum[k] + contrasts[y + v, x + u, k]
    direction = int(ratios)
    for i in range(ratios):
        ratio = limits[strengths + i]
        direction += exceeds(sum[0], sum[1], ratio, least) - exceeds(sum[1], sum[0], ratio, least)
    diagonal = int(diagonals)
    for i in range(diagonals):
        ratio = limits[strengths + ratios + i]
        diagonal += exceeds(sum[2], sum[3], ratio, least) - exceeds(sum[3], sum[2], ratio, least)
    share = int(0)
    for i in range(shares):
        ratio = limits[strengths + ratios + diagonals + i]
        more = wp.int64(ratio - 8) * wp.int64(least)
        if wp.int64(16) * colors > wp.int64(ratio) * wp.int64(sum[0] + sum[1]) + more:
            share += 1
    strength = int(0)
    for i in range(strengths):
        if sum[0] + sum[1] > limits[i]:
            strength += 1
    position = (y + shift_y) % period_y * period_x + (x + shift_x) % period_x
    kind = (position * (2 * ratios + 1) + direction) * (2 * diagonals + 1) + diagonal
    units[y, x] = (kind * (shares + 1) + share) * (strengths + 1) + strength


@wp.kernel
def apply(
    # in:
    codes: wp.array2d[int],
    pictures: wp.array3d[int],
    units: wp.array2d[int],
    code_taps: wp.array2d[int],
    guide_taps: wp.array2d[int],
    weights: wp.array3d[float],
    share: wp.array2d[float],
    loss: wp.array[float],
    # out:
    out: wp.array3d[float],
    # params:
    unit: float,
    zero: float,
    offset: float,
    scale: float,
    root: int,
    reach: int,
    outer: int,
    # sizes:
    codes_count: int,
    guides_count: int,
    rows: int,
    cols: int,
    wide: int,
    broad: int,
    channels: int,
):
    y, x = wp.tid()
    row = units[y, x]
    sum = wp.vec4()
    for t in range(codes_count):
        code = float(codes[y + reach + code_taps[t, 0], x + reach + code_taps[t, 1]])
        for o in range(4):
            sum[o] = sum[o] + weights[row, t, o] * code
    for t in range(guides_count):
        v = y + outer + guide_taps[t, 0]
        u = x + outer + guide_taps[t, 1]
        for c in range(channels):
            color = float(pictures[v, u, c])
            for o in range(4):
                sum[o] = sum[o] + weights[row, codes_count + channels * t + c, o] * color
    for o in range(channels):
        value = sum[o] * unit
        if root != 0:
            value += zero
            missing = float(0.0)
            if loss[0] > 0.0:
                near = wp.min(loss[1] / (loss[0] + value * value), 1.0)
                missing = (
                    ((loss[2] * near + loss[3]) * near + loss[4]) * near + loss[5]
                ) * near + loss[6]
                missing *= share[row, o]
            value = value * wp.abs(value) - offset + missing
        out[o, y, x] = value * scale
