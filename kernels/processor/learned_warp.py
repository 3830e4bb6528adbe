"""Three passes as in learned.cl, for CPUs; contrasts and taps are lists of the host.

`classify` goes along a run of columns.
"""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.bayer_warp import outside

# mirrored mosaic, mirrored picture
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

GRAIN = 4096.0
STEPS = 256.0
values = wp.types.vector(length=8, dtype=float)
ring = wp.types.vector(length=4 * 9, dtype=int)  # of the last columns of a box, at most 9 wide


@wp.kernel
def encode(
    # in:
    raw: wp.array2d[wp.uint16],
    factors: wp.array[float],
    # out:
    codes: wp.array2d[float],
    # params:
    shift: float,
    zero: float,
    shift_y: int,
    shift_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
    stride: int,
    # params:
    reach: int,
    root: int,
):
    y, x = wp.tid()
    v = outside(y - reach, rows, period_y)
    u = outside(wp.min(x - reach, cols + reach - 1), cols, period_x)
    number = float(raw[v, u])
    if root != 0:
        shifted = number + shift
        code = wp.sqrt(wp.abs(shifted))
        if shifted < 0.0:
            code = -code
        factor = factors[(v + shift_y) % period_y * period_x + (u + shift_x) % period_x]
        number = wp.floor((code - zero) * factor * GRAIN + 0.5) / GRAIN
    codes[y, x] = number


@wp.func
def whole(value: float, root: int):
    return int(wp.where(root != 0, wp.floor(value * STEPS + 0.5), value))


@wp.func
def column(
    codes: wp.array2d[float],
    filters: wp.array2d[int],
    kind: int,
    y: int,
    x: int,
    box: int,
    root: int,
):
    """Return the sum down a box's column of |contrast|: along columns (even kinds) or rows."""
    total = int(0)
    half = filters.shape[1] / 2
    for v in range(y - box, y + box + 1):
        sum = float(0.0)
        for i in range(-half, half + 1):
            weight = filters[kind, i + half]
            if weight != 0:
                if kind % 2 == 0:
                    sum += float(weight) * codes[v + i, x]
                else:
                    sum += float(weight) * codes[v, x + i]
        total += whole(wp.abs(sum), root)
    return total


@wp.kernel
def classify(
    # in:
    codes: wp.array2d[float],
    limits: wp.array[int],
    knots: wp.array[float],
    # out:
    units: wp.array2d[wp.uint16],
    levels: wp.array2d[float],
    # params:
    least: int,
    level_scale: float,
    level_zero: float,
    shift_y: int,
    shift_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
    stride: int,
    # params:
    filters: wp.array2d[int],
    reach: int,
    box: int,
    root: int,
    bounds: int,
    ratios: int,
    shares: int,
    run: int,
):
    y, item = wp.tid()
    kinds = filters.shape[0]
    span = 2 * box + 1
    history = ring()
    totals = wp.vec4i()
    for u in range(item * run - box, wp.min(item * run + run, cols) + box):
        slot = (u + span) % span * 4
        for k in range(kinds):
            new = column(codes, filters, k, y + reach, u + reach, box, root)
            totals[k] = totals[k] + new - history[slot + k]
            history[slot + k] = new
        x = u - box
        if x >= item * run:
            columns = totals[0]
            along = totals[1]
            direction = int(ratios)
            for i in range(ratios):
                ratio = limits[bounds + i]
                more = (ratio - 8) * least
                if 8 * along > ratio * columns + more:
                    direction += 1
                if 8 * columns > ratio * along + more:
                    direction -= 1
            kind = int(0)
            for i in range(bounds):
                if columns + along > limits[i]:
                    kind += 1
            if shares > 0:
                kind = kind * (shares + 1)
                for i in range(shares):
                    ratio = limits[bounds + ratios + i]
                    if (
                        8 * wp.min(columns, along)
                        > ratio * wp.min(totals[2], totals[3]) + (ratio - 8) * least
                    ):
                        kind += 1
            position = (y + shift_y) % period_y * period_x + (x + shift_x) % period_x
            units[y, x] = wp.uint16(
                (position * (2 * ratios + 1) + direction) * (bounds + 1) * (shares + 1) + kind
            )
            if knots.shape[0] > 1:
                sum = int(0)
                for v in range(y + reach - box, y + reach + box + 1):
                    for w in range(x + reach - box, x + reach + box + 1):
                        sum += whole(codes[v, w], root)
                level = float(sum) * level_scale - level_zero
                at = float(0.0)
                for i in range(1, knots.shape[0]):
                    at += wp.clamp((level - knots[i - 1]) / (knots[i] - knots[i - 1]), 0.0, 1.0)
                levels[y, x] = at


@wp.kernel
def apply(
    # in:
    raw: wp.array2d[wp.uint16],
    codes: wp.array2d[float],
    units: wp.array2d[wp.uint16],
    levels: wp.array2d[float],
    weights: wp.array4d[float],
    planes: wp.array2d[int],
    loss: wp.array[float],
    # out:
    out: wp.array3d[float],
    # params:
    zero: float,
    offset: float,
    scale: float,
    black_level: float,
    # sizes:
    rows: int,
    cols: int,
    stride: int,
    # params:
    taps: wp.array2d[int],
    reach: int,
    root: int,
    unbiased: int,
    classes: int,
    constant: int,
):
    y, x = wp.tid()
    unit = int(units[y, x])
    position = unit / classes
    computed = weights.shape[2]
    below = int(0)
    part = float(0.0)
    if weights.shape[0] > 1:
        below = wp.min(int(levels[y, x]), weights.shape[0] - 2)
        part = levels[y, x] - float(below)
    found = values()
    upper = values()
    for o in range(computed):
        found[o] = wp.where(unbiased != 0, 0.0, weights[below, unit, o, constant])
        if weights.shape[0] > 1:
            upper[o] = wp.where(unbiased != 0, 0.0, weights[below + 1, unit, o, constant])
    t = int(0)
    while t < taps.shape[0]:
        group = taps[t, 0]
        sum = float(0.0)
        while t < taps.shape[0] and taps[wp.min(t, taps.shape[0] - 1), 0] == group:
            sum += codes[y + reach + taps[t, 1], x + reach + taps[t, 2]]
            t += 1
        for o in range(computed):
            found[o] += weights[below, unit, o, group] * sum
            if weights.shape[0] > 1:
                upper[o] += weights[below + 1, unit, o, group] * sum
    for o in range(computed):
        code = found[o]
        if weights.shape[0] > 1:
            code = (1.0 - part) * code + part * upper[o]
        if root != 0:
            code += zero
            square = code * code
            missing = float(0.0)
            if unbiased != 0:
                near = wp.min(loss[1] / (loss[0] + square), 1.0)
                missing = (
                    ((loss[2] * near + loss[3]) * near + loss[4]) * near + loss[5]
                ) * near + loss[6]
                share = weights[below, unit, o, constant]
                if weights.shape[0] > 1:
                    share += part * (weights[below + 1, unit, o, constant] - share)
                missing *= share
            code = code * wp.abs(code) - offset + missing
        out[planes[position, o], y, x] = code * scale
    if planes.shape[1] > computed:
        out[planes[position, computed], y, x] = (float(raw[y, x]) - black_level) * scale
