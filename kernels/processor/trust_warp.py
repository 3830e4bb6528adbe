"""One block per thread, as in trust.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.tiles_warp import displacement_at
from gpusim.kernels.processor import trust as trust_host

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

OUTSIDE = wp.constant(trust_host.OUTSIDE)


@wp.func
def spline(s: float):
    """Return the weights of the samples at -1, 0, 1, 2 at 0 <= s < 1: cubic B-splines."""
    r = 1.0 - s
    return (
        wp.vec4(
            r * r * r,
            4.0 - 6.0 * s * s + 3.0 * s * s * s,
            4.0 - 6.0 * r * r + 3.0 * r * r * r,
            s * s * s,
        )
        / 6.0
    )


@wp.func
def hold_place(i: int, n: int, period: int):
    """Return the place; outside, the last one at the same place in the period."""
    j = i
    if j < 0:
        j = (j % period + period) % period
    if j >= n:
        j -= (j - n + period) / period * period
    return j


@wp.func
def smooth_sample(
    raw: wp.array3d[wp.uint16],
    table: wp.array2d[float],
    i: int,
    wy: wp.vec4,
    wx: wp.vec4,
    y: int,
    x: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    """Return mean and mean of squares of samples a period apart, and whether any is full."""
    found = wp.vec3(0.0, 0.0, 0.0)
    for a in range(4):
        v = hold_place(y + (a - 1) * period_y, rows, period_y)
        if wy[a] != 0.0 and v >= 0:
            line = float(0.0)
            squares = float(0.0)
            for b in range(4):
                u = hold_place(x + (b - 1) * period_x, cols, period_x)
                if wx[b] != 0.0 and u >= 0:
                    number = float(raw[i, v, u])
                    value = (number - table[0, i]) * table[1, i]
                    if number >= table[4, i]:
                        found[2] = 1.0
                    line += wx[b] * value
                    squares += wx[b] * value * value
            found[0] += wy[a] * line
            found[1] += wy[a] * squares
    return found


@wp.kernel
def compare(
    # in:
    raw: wp.array3d[wp.uint16],
    displacement: wp.array4d[float],
    table: wp.array2d[float],
    # out:
    misfit: wp.array3d[float],
    # params:
    reference: int,
    last: int,
    texture: float,
    margin: float,
    # sizes:
    tiles_y: int,
    tiles_x: int,
    frames: int,
    rows: int,
    cols: int,
    h: int,
    w: int,
    period_y: int,
    period_x: int,
):
    i, by, bx = wp.tid()
    still = spline(0.0)
    kept = wp.dot(still, still) * wp.dot(still, still)
    sum = float(0.0)
    pixels = float(0.0)
    is_full = bool(False)
    for k in range(period_y):
        for m in range(period_x):
            y = by * period_y + k
            x = bx * period_x + m
            if y < rows and x < cols:
                move = wp.vec2(0.0, 0.0)
                if i != reference:
                    move = displacement_at(
                        displacement,
                        i,
                        float(y),
                        float(x),
                        tiles_y,
                        tiles_x,
                        period_y,
                        period_x,
                    )
                moved_y = wp.clamp(move[0] / float(period_y), -1.0e5, 1.0e5)
                moved_x = wp.clamp(move[1] / float(period_x), -1.0e5, 1.0e5)
                wy = spline(moved_y - wp.floor(moved_y))
                wx = spline(moved_x - wp.floor(moved_x))
                v = y + int(wp.floor(moved_y)) * period_y
                u = x + int(wp.floor(moved_x)) * period_x
                other = smooth_sample(raw, table, i, wy, wx, v, u, rows, cols, period_y, period_x)
                light = wp.max(other[0], 0.0)
                noise = table[2, i] * light + table[3, i]
                left = (table[4, i] - table[0, i]) * table[1, i] - other[0]
                if other[2] != 0.0 or left < 0.0 or left * left < margin * margin * noise:
                    is_full = True
                pixels += 1.0
                if i != reference:
                    own = smooth_sample(
                        raw, table, reference, still, still, y, x, rows, cols, period_y, period_x
                    )
                    if own[2] == 0.0 and other[2] == 0.0:
                        own_noise = table[2, reference] * light + table[3, reference]
                        change = wp.max(own[1] - own[0] * own[0] - (1.0 - kept) * own_noise, 0.0)
                        expected = (
                            kept * own_noise
                            + wp.dot(wy, wy) * wp.dot(wx, wx) * noise
                            + texture * change
                        )
                        sum += (other[0] - own[0]) * (other[0] - own[0]) / expected
    value = sum / pixels
    if is_full and last >= 0 and i != last:
        value = OUTSIDE
    misfit[i, by, bx] = value


@wp.kernel
def weigh(
    # in:
    misfit: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    low: float,
    high: float,
    # sizes:
    frames: int,
    h: int,
    w: int,
):
    i, y, x = wp.tid()
    left = wp.max(x - 1, 0)
    right = wp.min(x + 1, w - 1)
    sum = float(0.0)
    for k in range(3):
        v = wp.clamp(y + k - 1, 0, h - 1)
        sum += misfit[i, v, left] + misfit[i, v, x] + misfit[i, v, right]
    out[i, y, x] = wp.clamp((high - sum / 9.0) / (high - low), 0.0, 1.0)
