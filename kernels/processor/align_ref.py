"""Pyramid search of tiles by sums of absolute differences, and a fitted paraboloid: float64."""

from math import isqrt

import numpy as np

from gpusim.kernels.processor.align import COARSE, FINE, TILE


def align(raw, *, reference=0, period=(2, 2), levels=None):
    """Return the stage's result, see `align.py`."""
    count, rows, cols = raw.shape
    size = rows // period[0], cols // period[1]
    whole = np.asarray(raw, np.int64)[:, : size[0] * period[0], : size[1] * period[1]]
    pyramid = [whole.reshape(count, size[0], period[0], size[1], period[1]).sum(axis=(2, 4))]
    while min(pyramid[-1].shape[1:]) // 2 >= TILE and len(pyramid) < (levels or 99):
        fine = pyramid[-1]
        h, w = (n // 2 for n in fine.shape[1:])
        fine = fine[:, : 2 * h, : 2 * w].reshape(count, h, 2, w, 2)
        pyramid.append((fine.sum(axis=(2, 4)) + 2) >> 2)
    out = np.zeros((count, *(-(-n // TILE) for n in size), 2))
    for i in range(count):
        if i == reference:
            continue
        found = None
        for level, planes in reversed(list(enumerate(pyramid))):
            h, w = planes.shape[1:]
            tiles = -(-h // TILE), -(-w // TILE)
            radius = COARSE if found is None else FINE
            finer = np.zeros((*tiles, 3), int)
            for ty, tx in np.ndindex(*tiles):
                *start, sure = (
                    (0, 0, 0)
                    if found is None
                    else found[min(ty // 2, len(found) - 1), min(tx // 2, len(found[0]) - 1)]
                )
                moved, now = search(
                    planes[reference], planes[i], ty, tx, (2 * start[0], 2 * start[1]), radius
                )
                finer[ty, tx] = *moved, sure or now
                if level == 0:
                    taken = finer[ty, tx, :2] * finer[ty, tx, 2]
                    out[i, ty, tx] = taken + fraction(planes[reference], planes[i], ty, tx, taken)
            found = finer
    return out


def window(plane, ty, tx, dy=0, dx=0):
    """Return a tile of a plane that continues with its edge values."""
    y = np.clip(np.arange(ty * TILE + dy, (ty + 1) * TILE + dy), 0, plane.shape[0] - 1)
    x = np.clip(np.arange(tx * TILE + dx, (tx + 1) * TILE + dx), 0, plane.shape[1] - 1)
    return plane[np.ix_(y, x)]


def search(wanted, plane, ty, tx, start, radius):
    """Return the best displacement that noise hardly explains, and whether it is significant."""
    start = tuple(
        np.clip(d, -2 * TILE - t * TILE, n + TILE - t * TILE)
        for d, t, n in zip(start, (ty, tx), plane.shape, strict=True)
    )
    tile = window(wanted, ty, tx)

    def cost(dy, dx):
        return abs(tile - window(plane, ty, tx, dy, dx)).sum()

    at_start = cost(*start)
    least, best = at_start, start
    for dy in range(start[0] - radius, start[0] + radius + 1):
        for dx in range(start[1] - radius, start[1] + radius + 1):
            total, root = cost(dy, dx), isqrt(inside(plane, ty, tx, dy, dx))
            if root and total < least and at_start - total > at_start // root * 2:
                least, best = total, (dy, dx)
    at_rest, root = cost(0, 0), isqrt(inside(plane, ty, tx, *best))
    return best, int(root > 0 and at_rest - least > at_rest // root * 4)


def inside(plane, ty, tx, dy=0, dx=0):
    """Return the number of a tile's differences that lie inside both pictures."""
    sizes = []
    for t, d, n in zip((ty, tx), (dy, dx), plane.shape, strict=True):
        places = np.arange(t * TILE, min((t + 1) * TILE, n)) + d
        sizes.append(int(((places >= 0) & (places < n)).sum()))
    return sizes[0] * sizes[1]


def fraction(wanted, plane, ty, tx, best):
    """Return the minimum of a paraboloid through the sums of squares around the best place."""

    # one tile moves forth instead of the other back: equal tiles then give equal sums on both sides
    def square(dy, dx):
        here = window(wanted, ty, tx, max(-dy, 0), max(-dx, 0)).astype(float)
        there = window(plane, ty, tx, best[0] + max(dy, 0), best[1] + max(dx, 0))
        return ((here - there) ** 2).sum()

    f = np.array([[square(dy, dx) for dx in (-1, 0, 1)] for dy in (-1, 0, 1)])
    slope_y, slope_x = (f[2] - f[0]).sum() / 6, (f[:, 2] - f[:, 0]).sum() / 6
    bend_y, bend_x = (f[2] - 2 * f[1] + f[0]).sum() / 3, (f[:, 2] - 2 * f[:, 1] + f[:, 0]).sum() / 3
    twist = (f[2, 2] - f[2, 0] - f[0, 2] + f[0, 0]) / 4
    sure_y, sure_x = bend_y > 0.25 * f[1, 1], bend_x > 0.25 * f[1, 1]
    count = max(inside(plane, ty, tx, *best), 1)

    def limit(bend):
        """Return the depth of a minimum that noise does not explain."""
        return 8 * f[1, 1] / count * (1 + f[1, 1] / (4 * bend))

    determinant = bend_y * bend_x - twist**2
    if sure_y and sure_x and determinant > 0.25 * bend_y * bend_x:
        move = np.array((twist * slope_x - bend_x * slope_y, twist * slope_y - bend_y * slope_x))
        move = move / determinant
        if -(move @ (slope_y, slope_x)) / 2 < limit(min(bend_y, bend_x)):
            move = np.zeros(2)
    else:
        move = [
            -slope / bend if sure and slope**2 / (2 * bend) >= limit(bend) else 0
            for slope, bend, sure in ((slope_y, bend_y, sure_y), (slope_x, bend_x, sure_x))
        ]
    return np.clip(move, -0.5, 0.5)
