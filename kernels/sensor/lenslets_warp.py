"""Squares along the pixels in two passes, eight lines per thread; other arrays by a gather."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})

BLOCK = wp.constant(8)
lanes = wp.types.vector(length=8, dtype=wp.float32)


@wp.kernel
def add_up(
    # in:
    values: wp.array3d[float],
    # out:
    sums: wp.array2d[float],
    # sizes:
    outer: int,
    count: int,
    inner: int,
):
    y, x = wp.tid()
    total = float(0.0)
    for k in range(count):
        total += values[y, k, x]
    sums[y, x] = total


@wp.kernel
def across(
    # in:
    rates: wp.array4d[float],
    totals: wp.array4d[float],
    weights: wp.array4d[float],
    far_weights: wp.array3d[float],
    first: wp.array2d[int],
    far_first: wp.array2d[int],
    pairs: wp.array2d[int],
    # out:
    lines: wp.array3d[float],
    # sizes:
    pair_count: int,
    cells_y: int,
    channels: int,
    rows: int,
    cols: int,
    positions: int,
    window: int,
    far_window: int,
    cells: int,
):
    index, k = wp.tid()
    groups = (rows + BLOCK - 1) / BLOCK
    top = index % groups * BLOCK
    j = index / groups % cells_y
    pair = index / groups / cells_y
    channel = pairs[pair, 1]
    begin = first[pair, k / BLOCK]
    total = lanes()
    for m in range(window):
        for i in range(cells):
            w = weights[pair, m, i, k]
            for d in range(8):
                total[d] += (
                    w * rates[j, i * channels + channel, wp.min(top + d, rows - 1), begin + m]
                )
    begin = far_first[pair, k / BLOCK]
    for m in range(far_window):
        w = far_weights[pair, m, k]
        for d in range(8):
            total[d] += w * totals[j, channel, wp.min(top + d, rows - 1), begin + m]
    for d in range(8):
        if top + d < rows:
            lines[pair, j * rows + top + d, k] = total[d]


@wp.kernel
def down(
    # in:
    lines: wp.array3d[float],
    totals: wp.array3d[float],
    weights: wp.array4d[float],
    far_weights: wp.array3d[float],
    first: wp.array2d[int],
    far_first: wp.array2d[int],
    column_pairs: wp.array2d[int],
    row_pairs: wp.array2d[int],
    # out:
    pixels: wp.array3d[float],
    # sizes:
    rows: int,
    positions_x: int,
    positions_y: int,
    window: int,
    far_window: int,
    pixel_rows: int,
    pixel_cols: int,
    period_y: int,
    period_x: int,
    cells: int,
):
    line, index = wp.tid()
    k = index % positions_x
    phase_x = index / positions_x
    blocks = positions_y / BLOCK
    block = line % blocks
    phase_y = line / blocks
    x = phase_x + period_x * k
    if x >= pixel_cols:
        return
    plane = column_pairs[phase_y, phase_x]
    pair = row_pairs[phase_y, phase_x]
    begin = first[pair, block]
    total = lanes()
    for m in range(window):
        for j in range(cells):
            value = lines[plane, j * rows + begin + m, k]
            for d in range(8):
                total[d] += weights[pair, m, j, block * BLOCK + d] * value
    begin = far_first[pair, block]
    for m in range(far_window):
        value = totals[plane, begin + m, k]
        for d in range(8):
            total[d] += far_weights[pair, m, block * BLOCK + d] * value
    for d in range(8):
        y = phase_y + period_y * (block * BLOCK + d)
        if y < pixel_rows:
            pixels[0, y, x] = total[d]


@wp.kernel
def bundle(
    # in:
    rates: wp.array2d[float],
    sample: wp.array2d[int],
    share: wp.array2d[float],
    # out:
    light: wp.array2d[float],
    # sizes:
    planes: int,
    samples: int,
    lenslets: int,
    parts: int,
):
    plane, lenslet = wp.tid()
    total = float(0.0)
    for j in range(parts):
        total += share[lenslet, j] * rates[plane, sample[lenslet, j]]
    light[plane, lenslet] = total


@wp.kernel
def gather(
    # in:
    light: wp.array4d[float],
    sample: wp.array2d[int],
    share: wp.array2d[float],
    places: wp.array3d[float],
    near_table: wp.array3d[float],
    far_light: wp.array3d[float],
    cfa: wp.array2d[int],
    inverse: wp.array2d[float],
    # out:
    pixels: wp.array3d[float],
    # params:
    has_far: int,
    origin_y: float,
    origin_x: float,
    axis_y: float,
    axis_x: float,
    tilt: float,
    radius: float,
    reach: float,
    # sizes:
    cells_y: int,
    cells_x: int,
    channels: int,
    samples: int,
    parts: int,
    low_a: int,
    low_b: int,
    count_a: int,
    count_b: int,
    around_a: int,
    around_b: int,
    side: int,
    period_y: int,
    period_x: int,
    layers: int,
    pixel_rows: int,
    pixel_cols: int,
    steps: int,
):
    layer, py, px = wp.tid()
    channel = layer
    if layers == 1:
        channel = cfa[py % period_y, px % period_x]
    y = float(py) - 0.5 * float(pixel_rows - 1)
    x = float(px) - 0.5 * float(pixel_cols - 1)
    # the lenslet whose image of the pupil's middle is nearest
    v = (y + tilt * axis_y) / (1.0 + tilt) - origin_y
    u = (x + tilt * axis_x) / (1.0 + tilt) - origin_x
    own_a = int(wp.rint(v * inverse[0, 0] + u * inverse[1, 0])) - low_a
    own_b = int(wp.rint(v * inverse[0, 1] + u * inverse[1, 1])) - low_b
    step_y = 2.0 * radius / float(cells_y)
    step_x = 2.0 * radius / float(cells_x)
    last = float(side) - 1.001
    total = float(0.0)
    if has_far != 0:
        total = far_light[channel, py, px]
    for a in range(wp.max(own_a - around_a, 0), wp.min(own_a + around_a, count_a - 1) + 1):
        for b in range(wp.max(own_b - around_b, 0), wp.min(own_b + around_b, count_b - 1) + 1):
            lenslet = a * count_b + b
            for part in range(parts):
                # distances of the pixel from the images of the first cells; they grow by a step with each cell
                first_y = y - places[lenslet, part, 0] - radius + 0.5 * step_y
                first_x = x - places[lenslet, part, 1] - radius + 0.5 * step_x
                j0 = wp.max(0, int(wp.ceil((-reach - first_y) / step_y)))
                j1 = wp.min(cells_y - 1, int(wp.floor((reach - first_y) / step_y)))
                i0 = wp.max(0, int(wp.ceil((-reach - first_x) / step_x)))
                i1 = wp.min(cells_x - 1, int(wp.floor((reach - first_x) / step_x)))
                if j0 <= j1 and i0 <= i1 and share[lenslet, part] != 0.0:
                    own = float(0.0)
                    at = sample[lenslet, part]
                    for j in range(j0, j1 + 1):
                        ty = wp.clamp(
                            (first_y + float(j) * step_y + reach) * float(steps), 0.0, last
                        )
                        row = int(ty)
                        fy = ty - float(row)
                        for i in range(i0, i1 + 1):
                            tx = wp.clamp(
                                (first_x + float(i) * step_x + reach) * float(steps), 0.0, last
                            )
                            col = int(tx)
                            fx = tx - float(col)
                            a0 = near_table[channel, row, col]
                            a1 = near_table[channel, row, col + 1]
                            b0 = near_table[channel, row + 1, col]
                            b1 = near_table[channel, row + 1, col + 1]
                            upper = a0 + fx * (a1 - a0)
                            lower = b0 + fx * (b1 - b0)
                            own += (upper + fy * (lower - upper)) * light[j, i, channel, at]
                    total += share[lenslet, part] * own
    pixels[layer, py, px] = total
