"""Kernels as in network.cl; an item of `convolve` makes twelve outputs of a block."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import outside

wp.set_module_options({"enable_backward": False})

GUARD_COLUMNS = 8
outputs_at_once = wp.types.vector(length=12, dtype=float)


@wp.kernel
def encode(
    # in:
    raw: wp.array2d[wp.uint16],
    colors: wp.array2d[int],
    # out:
    samples: wp.array3d[float],
    # params:
    black_level: float,
    scale: float,
    offset: float,
    sigma: float,
    red: float,
    green: float,
    blue: float,
    root: int,
    margin: int,
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
    height: int,
    width: int,
):
    y, x = wp.tid()
    v = outside(y - margin, rows, period_y)
    u = outside(x - margin, cols, period_x)
    color = colors[v % period_y, u % period_x]
    factor = red
    if color == 1:
        factor = green
    if color == 2:
        factor = blue
    code = (float(raw[v, u]) - black_level) * scale
    noise = float(0.0)
    if root != 0:
        code = code + offset
        code = factor * wp.sign(code) * wp.sqrt(wp.abs(code))
        noise = factor * sigma
    for c in range(3):
        samples[c, y, x] = wp.where(c == color, code, 0.0)
        samples[3 + c, y, x] = wp.where(c == color, 1.0, 0.0)
    samples[6, y, x] = noise


@wp.kernel
def guess(
    # in:
    samples: wp.array3d[float],
    taps: wp.array[float],
    # out:
    planes: wp.array3d[float],
    # sizes:
    height: int,
    width: int,
):
    y, x = wp.tid()
    for c in range(3):
        sum = float(0.0)
        total = float(0.0)
        for dy in range(7):
            for dx in range(7):
                weight = taps[dy] * taps[dx]
                sum += weight * samples[c, y + dy, x + dx]
                total += weight * samples[3 + c, y + dy, x + dx]
        if samples[3 + c, y + 3, x + 3] > 0.0:
            planes[c, y, x] = samples[c, y + 3, x + 3]
        else:
            planes[c, y, x] = sum / total


@wp.kernel
def pack(
    # in:
    samples: wp.array3d[float],
    guess: wp.array3d[float],
    # out:
    blocks: wp.array3d[float],
    # sizes:
    high: int,
    wide: int,
    stride: int,
):
    y, x = wp.tid()
    for i in range(4):
        v = 2 * y + i // 2
        u = 2 * x + i % 2
        for c in range(3):
            blocks[4 * c + i, y + 1, x + GUARD_COLUMNS] = guess[c, v, u]
            blocks[12 + 4 * c + i, y + 1, x + GUARD_COLUMNS] = samples[3 + c, v + 3, u + 3]
        blocks[24 + i, y + 1, x + GUARD_COLUMNS] = samples[6, v + 3, u + 3]


@wp.kernel
def convolve(
    # in:
    blocks: wp.array3d[float],
    weights: wp.array4d[float],
    biases: wp.array[float],
    # out:
    out: wp.array3d[float],
    # params:
    kind: int,
    # sizes:
    inputs: int,
    outputs: int,
    high: int,
    stride: int,
):
    made, y, x = wp.tid()
    u = x + GUARD_COLUMNS
    sums = outputs_at_once()
    for o in range(12):
        sums[o] = biases[12 * made + o]
    for i in range(inputs):
        for k in range(9):
            value = blocks[i, y + k // 3, u + k % 3 - 1]
            for o in range(12):
                sums[o] += value * weights[made, i, k, o]
    for o in range(12):
        value = sums[o]
        if kind == 1:
            value += blocks[12 * made + o, y + 1, u]
        if kind != 2:
            value = wp.max(value, 0.0)
        out[12 * made + o, y + 1, u] = value


@wp.kernel
def decode(
    # in:
    guess: wp.array3d[float],
    blocks: wp.array3d[float],
    # out:
    rgb: wp.array3d[float],
    # params:
    offset: float,
    red: float,
    green: float,
    blue: float,
    root: int,
    margin: int,
    # sizes:
    high: int,
    wide: int,
    stride: int,
    rows: int,
    cols: int,
):
    y, x = wp.tid()
    v = y + margin
    u = x + margin
    for c in range(3):
        code = (
            guess[c, v, u] + blocks[4 * c + v % 2 * 2 + u % 2, v // 2 + 1, u // 2 + GUARD_COLUMNS]
        )
        if root != 0:
            factor = red
            if c == 1:
                factor = green
            if c == 2:
                factor = blue
            code = code / factor
            code = code * wp.abs(code) - offset
        rgb[c, y, x] = code
