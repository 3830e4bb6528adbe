"""A band of pixels of one column per thread, as denoise.cl on a GPU."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

BAND = wp.constant(4)
Band = wp.types.vector(length=4, dtype=float)
Squares = wp.types.vector(length=6, dtype=float)


@wp.func
def moved_inside(i: int, size: int, period: int):
    j = i
    if i < 0:
        j = i + (period - 1 - i) / period * period
    if i >= size:
        j = i - ((i - size) / period + 1) * period
    return j


@wp.kernel
def stabilise(
    # in:
    raw: wp.array2d[wp.uint16],
    # out:
    code: wp.array2d[float],
    # params:
    black_level: float,
    gain: float,
    constant_part: float,
    lowest: float,
    # sizes:
    period_y: int,
    period_x: int,
    margin_y: int,
    margin_x: int,
    rows: int,
    cols: int,
    code_rows: int,
    code_cols: int,
):
    y, x = wp.tid()
    number = raw[
        moved_inside(y - margin_y, rows, period_y), moved_inside(x - margin_x, cols, period_x)
    ]
    d = wp.max(float(number) - black_level, lowest)
    code[y, x] = 2.0 * d / (wp.sqrt(wp.max(gain * d + constant_part, 0.0)) + wp.sqrt(constant_part))


@wp.func
def column(code: wp.array2d[float], y: int, x: int, dy: int, dx: int):
    """Return the sum of squared differences of three rows."""
    squares = Squares()
    for r in range(6):
        difference = code[y + r - 1, x] - code[y + r - 1 + dy, x + dx]
        squares[r] = difference * difference
    sums = Band()
    for r in range(4):
        sums[r] = (squares[r] + squares[r + 2]) + squares[r + 1]
    return sums


@wp.func
def weigh(
    code: wp.array2d[float], y: int, x: int, dy: int, dx: int, most: float, per_square: float
):
    total = (column(code, y, x - 1, dy, dx) + column(code, y, x + 1, dy, dx)) + column(
        code, y, x, dy, dx
    )
    weights = Band()
    for r in range(4):
        root = wp.clamp(most - per_square * total[r], 0.0, 1.0)
        weights[r] = root * root
    return weights


@wp.func
def square(code: wp.array2d[float], y: int, x: int, dy: int, dx: int):
    difference = code[y, x] - code[y + dy, x + dx]
    return difference * difference


@wp.func
def weigh_twins(
    code: wp.array2d[float], y0: int, x: int, dy: int, dx: int, most: float, per_square: float
):
    """Return weights by patches of the nine nearest pixels on diagonals."""
    weights = Band()
    for r in range(4):
        y = y0 + r
        corners = (square(code, y - 1, x - 1, dy, dx) + square(code, y + 1, x + 1, dy, dx)) + (
            square(code, y - 1, x + 1, dy, dx) + square(code, y + 1, x - 1, dy, dx)
        )
        ends = (square(code, y - 2, x, dy, dx) + square(code, y + 2, x, dy, dx)) + (
            square(code, y, x - 2, dy, dx) + square(code, y, x + 2, dy, dx)
        )
        root = wp.clamp(
            most - per_square * ((corners + ends) + square(code, y, x, dy, dx)), 0.0, 1.0
        )
        weights[r] = root * root
    return weights


@wp.func
def weigh_values(code: wp.array2d[float], y: int, x: int, weights: Band):
    values = Band()
    for r in range(4):
        values[r] = weights[r] * code[y + r, x]
    return values


@wp.kernel
def denoise(
    # in:
    code: wp.array2d[float],
    # out:
    out: wp.array2d[wp.uint16],
    # params:
    most: float,
    per_square: float,
    quarter_gain: float,
    root: float,
    scale: float,
    new_black: float,
    even_twins: float,
    odd_twins: float,
    # sizes:
    period_y: int,
    period_x: int,
    margin_y: int,
    margin_x: int,
    rows: int,
    cols: int,
    stride: int,
):
    band, x0 = wp.tid()
    y = band * BAND + margin_y
    x = x0 + margin_x
    mean = Band()
    count = Band()
    for r in range(4):
        mean[r] = code[y + r, x]
        count[r] = 1.0
    for step in range(1, 9):
        dy = step / 3 * period_y
        dx = step % 3 * period_x
        first = weigh(code, y, x, dy, dx, most, per_square)
        second = weigh(code, y, x, -dy, -dx, most, per_square)
        more = weigh_values(code, y + dy, x + dx, first) + weigh_values(
            code, y - dy, x - dx, second
        )
        number = first + second
        if dy != 0 and dx != 0:
            third = weigh(code, y, x, dy, -dx, most, per_square)
            fourth = weigh(code, y, x, -dy, dx, most, per_square)
            more += weigh_values(code, y + dy, x - dx, third) + weigh_values(
                code, y - dy, x + dx, fourth
            )
            number += third + fourth
        mean += more
        count += number
    if even_twins > 0.0 or odd_twins > 0.0:
        twin_sum = Band()
        twin_count = Band()
        for step in range(4):
            down = 1 + step / 2 * 2
            right = 1 + step % 2 * 2
            a = weigh_twins(code, y, x, down, right, most, per_square)
            b = weigh_twins(code, y, x, -down, -right, most, per_square)
            c = weigh_twins(code, y, x, down, -right, most, per_square)
            d = weigh_twins(code, y, x, -down, right, most, per_square)
            twin_sum += (
                weigh_values(code, y + down, x + right, a)
                + weigh_values(code, y - down, x - right, b)
            ) + (
                weigh_values(code, y + down, x - right, c)
                + weigh_values(code, y - down, x + right, d)
            )
            twin_count += (a + b) + (c + d)
        for r in range(4):
            most_twin = wp.where((band * BAND + r + x0) % 2 == 0, even_twins, odd_twins)
            share = wp.min(most_twin, count[r] / wp.max(twin_count[r], 1.0e-6))
            mean[r] += share * twin_sum[r]
            count[r] += share * twin_count[r]
    for r in range(4):
        if band * BAND + r < rows:
            inverse = 1.0 / count[r]
            u = mean[r] * inverse
            signal = (quarter_gain * u + root) * u + quarter_gain * (1.0 - inverse)
            out[band * BAND + r, x0] = wp.uint16(
                int(wp.clamp(signal * scale + new_black, 0.0, 65535.0) + 0.5)
            )
