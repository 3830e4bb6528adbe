"""One pixel, or one tile, per thread, as in refine.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.keys_warp import keys
from gpusim.kernels.processor import align as align_host
from gpusim.kernels.processor import refine as refine_host

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TILE = wp.constant(align_host.TILE)
FULL = wp.constant(refine_host.FULL)
MARGIN = wp.constant(refine_host.MARGIN)
vec7 = wp.types.vector(length=7, dtype=float)


@wp.kernel
def smooth(
    # in:
    raw: wp.array3d[wp.uint16],
    table: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    frames: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    i, y, x = wp.tid()
    full = table[4, i]
    sum = float(0.0)
    is_full = bool(False)
    for j in range(1 - period_y, period_y):
        v = wp.clamp(y + j, 0, rows - 1)
        part = float(0.0)
        for k in range(1 - period_x, period_x):
            number = float(raw[i, v, wp.clamp(x + k, 0, cols - 1)])
            part += float(period_x - wp.abs(k)) * number
            if number >= full:
                is_full = True
        sum += float(period_y - wp.abs(j)) * part
    mean = sum / float(period_y * period_y * period_x * period_x)
    value = (mean - table[0, i]) * table[1, i]
    left = (full - table[0, i]) * table[1, i] - value
    noise = table[2, i] * wp.max(value, 0.0) + table[3, i]
    if is_full or left < 0.0 or left * left < MARGIN * MARGIN * noise:
        value = FULL
    out[i, y, x] = value


@wp.kernel
def sums(
    # in:
    plane: wp.array3d[float],
    displacement: wp.array4d[float],
    table: wp.array2d[float],
    # out:
    out: wp.array4d[float],
    # params:
    reference: int,
    # sizes:
    tiles_y: int,
    tiles_x: int,
    frames: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    i, ty, tx = wp.tid()
    dy = displacement[i, ty, tx, 0] * float(period_y)
    dx = displacement[i, ty, tx, 1] * float(period_x)
    wy = keys(dy - wp.floor(dy))
    wx = keys(dx - wp.floor(dx))
    down = int(wp.clamp(wp.floor(dy), -1.0e6, 1.0e6))
    right = int(wp.clamp(wp.floor(dx), -1.0e6, 1.0e6))
    shot = table[2, i] + table[2, reference]
    floor_ = table[3, i] + table[3, reference]
    found = vec7()
    first_y = ty * TILE * period_y
    first_x = tx * TILE * period_x
    if first_y == 0:
        first_y = 1
    if first_x == 0:
        first_x = 1
    last_y = wp.min((ty + 1) * TILE * period_y, rows - 1)
    last_x = wp.min((tx + 1) * TILE * period_x, cols - 1)
    for y in range(first_y, last_y, period_y):
        if y + down >= 1 and y + down + 2 < rows:
            part = vec7()
            for x in range(first_x, last_x, period_x):
                if x + right >= 1 and x + right + 2 < cols:
                    own = plane[reference, y, x]
                    up = plane[reference, y - 1, x]
                    low = plane[reference, y + 1, x]
                    before = plane[reference, y, x - 1]
                    after = plane[reference, y, x + 1]
                    largest = wp.max(wp.max(wp.max(up, low), wp.max(before, after)), own)
                    value = float(0.0)
                    for a in range(4):
                        line = float(0.0)
                        for b in range(4):
                            tap = plane[i, y + down + a - 1, x + right + b - 1]
                            line += wx[b] * tap
                            largest = wp.max(largest, tap)
                        value += wy[a] * line
                    if largest < FULL:
                        weight = 1.0 / (shot * wp.max(own, 0.0) + floor_)
                        slope_y = 0.5 * (low - up)
                        slope_x = 0.5 * (after - before)
                        off = value - own
                        part[0] += weight * slope_y * slope_y
                        part[1] += weight * slope_y * slope_x
                        part[2] += weight * slope_x * slope_x
                        part[3] -= weight * slope_y * off
                        part[4] -= weight * slope_x * off
                        part[5] += weight * off * off
                        part[6] += 1.0
            found += part
    for k in range(7):
        if i == reference:
            out[i, ty, tx, k] = 0.0
        else:
            out[i, ty, tx, k] = found[k]
