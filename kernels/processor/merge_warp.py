"""One pixel per thread, as in merge.cl on a GPU."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def neighbour(i: int, step: int, n: int):
    there = i + step
    opposite = i - step
    if there >= 0 and there < n:
        return there
    if opposite >= 0 and opposite < n:
        return opposite
    return i


@wp.kernel
def merge(
    # in:
    raw: wp.array3d[wp.uint16],
    table: wp.array2d[float],
    # out:
    out: wp.array2d[float],
    # params:
    margin: float,
    scale: float,
    photon: int,
    period_y: int,
    period_x: int,
    # sizes:
    rows: int,
    cols: int,
    frames: int,
):
    y, x = wp.tid()
    up = neighbour(y, -period_y, rows)
    down = neighbour(y, period_y, rows)
    left = neighbour(x, -period_x, cols)
    right = neighbour(x, period_x, cols)
    used = int(0)
    electrons = float(0.0)
    seconds = float(0.0)
    for i in range(frames):
        around = int(raw[i, y, left]) + int(raw[i, y, right])
        around += int(raw[i, up, left]) + int(raw[i, up, x]) + int(raw[i, up, right])
        around += int(raw[i, down, left]) + int(raw[i, down, x]) + int(raw[i, down, right])
        mean = (0.125 * float(around) - table[0, i]) * table[1, i]
        light = float(0.0)
        if photon != 0:
            light = wp.max(mean, 0.0)
        left_over = wp.max(table[5, i] - mean, 0.0)  # to a full well
        if i == 0 or (
            mean <= table[5, i] and margin * margin * (light + table[3, i]) <= left_over * left_over
        ):
            electrons += mean
            seconds += table[2, i]
            if i == 0 or float(raw[i, y, x]) < table[4, i]:
                used = used | (1 << i)
    rate = float(0.0)
    if photon != 0:
        rate = wp.max(electrons / seconds, 0.0)
    total = float(0.0)
    weight = float(0.0)
    for i in range(frames):
        if (used & (1 << i)) != 0:
            share = table[2, i] / (rate * table[2, i] + table[3, i])
            total += share * ((float(raw[i, y, x]) - table[0, i]) * table[1, i])
            weight += share * table[2, i]
    out[y, x] = total / weight * scale
