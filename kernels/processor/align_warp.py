"""As align.cl on a GPU: one block, or one tile, per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.processor import align as align_host

# GPUs need the loops over a tile unrolled; a CPU's compiler takes minutes for that, without gain
wp.set_module_options(
    {"enable_backward": False, "fuse_fp": False, "max_unroll": 16 if wp.is_cuda_available() else 1}
)

PAD = wp.constant(align_host.PAD)
TILE = wp.constant(align_host.TILE)
LIKELY = wp.constant(align_host.LIKELY)
SAVED = wp.constant(align_host.SAVED)
SURE = wp.constant(align_host.SURE)


@wp.kernel
def blocks(
    # in:
    raw: wp.array3d[wp.uint16],
    # out:
    out: wp.array3d[int],
    # sizes:
    frames: int,
    rows: int,
    cols: int,
    h: int,
    w: int,
    period_y: int,
    period_x: int,
):
    i, y, x = wp.tid()
    by = wp.clamp(y - PAD, 0, h - 1) * period_y
    bx = wp.clamp(x - PAD, 0, w - 1) * period_x
    sum = int(0)
    for j in range(period_y):
        for k in range(period_x):
            sum += int(raw[i, by + j, bx + k])
    out[i, y, x] = sum


@wp.kernel
def halve(
    # in:
    fine: wp.array3d[int],
    # out:
    out: wp.array3d[int],
    # sizes:
    frames: int,
    fine_h: int,
    fine_w: int,
    h: int,
    w: int,
):
    i, y, x = wp.tid()
    by = 2 * wp.clamp(y - PAD, 0, h - 1) + PAD
    bx = 2 * wp.clamp(x - PAD, 0, w - 1) + PAD
    out[i, y, x] = (
        fine[i, by, bx] + fine[i, by, bx + 1] + fine[i, by + 1, bx] + fine[i, by + 1, bx + 1] + 2
    ) >> 2


@wp.func
def difference_sum(
    plane: wp.array3d[int], reference: int, i: int, y0: int, x0: int, dy: int, dx: int
):
    """Return the sum of absolute differences of the tile at (y0, x0) of the plane with its PAD."""
    sum = int(0)
    for j in range(TILE):
        for k in range(TILE):
            sum += wp.abs(plane[reference, y0 + j, x0 + k] - plane[i, y0 + dy + j, x0 + dx + k])
    return sum


@wp.func
def square_sum(plane: wp.array3d[int], reference: int, i: int, y0: int, x0: int, dy: int, dx: int):
    """Return the sum of squared differences; rows are summed separately, which rounds less."""
    sum = float(0.0)
    for j in range(TILE):
        line = float(0.0)
        for k in range(TILE):
            d = float(plane[reference, y0 + j, x0 + k] - plane[i, y0 + dy + j, x0 + dx + k])
            line += d * d
        sum += line
    return sum


@wp.func
def overlap(tile: int, d: int, n: int):
    """Return how many of a tile's rows or columns are inside n blocks, there and displaced by d."""
    return wp.max(wp.min(wp.min((tile + 1) * TILE, n), n - d) - wp.max(tile * TILE, -d), 0)


@wp.func
def whole_root(n: int):
    """Return the whole part of the square root of up to TILE^2."""
    root = int(0)
    while (root + 1) * (root + 1) <= n:
        root += 1
    return root


@wp.kernel
def search(
    # in:
    plane: wp.array3d[int],
    parents: wp.array[int],
    # out:
    out: wp.array4d[int],
    # params:
    reference: int,
    radius: int,
    # sizes:
    parent_y: int,
    parent_x: int,
    h: int,
    w: int,
    tiles_y: int,
    tiles_x: int,
    frames: int,
):
    i, ty, tx = wp.tid()
    y = int(0)
    x = int(0)
    sure = int(0)
    if i != reference:
        y0 = ty * TILE + PAD
        x0 = tx * TILE + PAD
        if parent_y > 0:
            at = 3 * (
                (i * parent_y + wp.min(ty / 2, parent_y - 1)) * parent_x
                + wp.min(tx / 2, parent_x - 1)
            )
            y = wp.clamp(2 * parents[at], -(2 + ty) * TILE, h + TILE - ty * TILE)
            x = wp.clamp(2 * parents[at + 1], -(2 + tx) * TILE, w + TILE - tx * TILE)
            sure = parents[at + 2]
        at_start = difference_sum(plane, reference, i, y0, x0, y, x)
        least = at_start
        best_y = y
        best_x = x
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                sum = difference_sum(plane, reference, i, y0, x0, y + dy, x + dx)
                root = whole_root(overlap(ty, y + dy, h) * overlap(tx, x + dx, w))
                if sum < least and root > 0:
                    if at_start - sum > at_start / root * LIKELY:
                        least = sum
                        best_y = y + dy
                        best_x = x + dx
        y = best_y
        x = best_x
        last = whole_root(overlap(ty, y, h) * overlap(tx, x, w))
        at_rest = difference_sum(plane, reference, i, y0, x0, 0, 0)
        if last > 0:
            if at_rest - least > at_rest / last * SAVED:
                sure = 1
    out[i, ty, tx, 0] = y
    out[i, ty, tx, 1] = x
    out[i, ty, tx, 2] = sure


@wp.kernel
def fraction(
    # in:
    plane: wp.array3d[int],
    found: wp.array4d[int],
    # out:
    out: wp.array4d[float],
    # params:
    reference: int,
    # sizes:
    h: int,
    w: int,
    tiles_y: int,
    tiles_x: int,
    frames: int,
):
    i, ty, tx = wp.tid()
    y = float(0.0)
    x = float(0.0)
    if i != reference:
        y0 = ty * TILE + PAD
        x0 = tx * TILE + PAD
        at_y = found[i, ty, tx, 0] * found[i, ty, tx, 2]
        at_x = found[i, ty, tx, 1] * found[i, ty, tx, 2]
        f = wp.mat33()
        for dy in range(3):
            for dx in range(3):
                f[dy, dx] = square_sum(
                    plane,
                    reference,
                    i,
                    y0 + wp.max(1 - dy, 0),
                    x0 + wp.max(1 - dx, 0),
                    at_y + dy - 1,
                    at_x + dx - 1,
                )
        slope_y = (f[2, 0] + f[2, 1] + f[2, 2] - (f[0, 0] + f[0, 1] + f[0, 2])) / 6.0
        slope_x = (f[0, 2] + f[1, 2] + f[2, 2] - (f[0, 0] + f[1, 0] + f[2, 0])) / 6.0
        bend_y = (
            f[2, 0]
            + f[2, 1]
            + f[2, 2]
            + (f[0, 0] + f[0, 1] + f[0, 2])
            - 2.0 * (f[1, 0] + f[1, 1] + f[1, 2])
        ) / 3.0
        bend_x = (
            f[0, 2]
            + f[1, 2]
            + f[2, 2]
            + (f[0, 0] + f[1, 0] + f[2, 0])
            - 2.0 * (f[0, 1] + f[1, 1] + f[2, 1])
        ) / 3.0
        twist = (f[2, 2] - f[2, 0] - (f[0, 2] - f[0, 0])) / 4.0
        sure_y = bend_y > 0.25 * f[1, 1]
        sure_x = bend_x > 0.25 * f[1, 1]
        noise = SURE * f[1, 1] / float(wp.max(overlap(ty, at_y, h) * overlap(tx, at_x, w), 1))
        determinant = bend_y * bend_x - twist * twist
        if sure_y and sure_x and determinant > 0.25 * (bend_y * bend_x):
            y = (twist * slope_x - bend_x * slope_y) / determinant
            x = (twist * slope_y - bend_y * slope_x) / determinant
            if -0.5 * (y * slope_y + x * slope_x) < noise * (
                1.0 + f[1, 1] / (4.0 * wp.min(bend_y, bend_x))
            ):
                y = 0.0
                x = 0.0
        else:
            if sure_y:
                if slope_y * slope_y / (2.0 * bend_y) >= noise * (1.0 + f[1, 1] / (4.0 * bend_y)):
                    y = -slope_y / bend_y
            if sure_x:
                if slope_x * slope_x / (2.0 * bend_x) >= noise * (1.0 + f[1, 1] / (4.0 * bend_x)):
                    x = -slope_x / bend_x
        y = float(at_y) + wp.clamp(y, -0.5, 0.5)
        x = float(at_x) + wp.clamp(x, -0.5, 0.5)
    out[i, ty, tx, 0] = y
    out[i, ty, tx, 1] = x
