"""Pyramid search of tiles by sums of absolute differences, and a paraboloid through 3 x 3 sums of squares: float64."""

import numpy as np

from gpusim.kernels.processor.align import COARSE, FINE, TILE


def align(raw, *, reference=0, period=(2, 2), levels=None):
    """See the contract."""
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
            finer = np.zeros((*tiles, 2), int)
            for ty, tx in np.ndindex(*tiles):
                start = (0, 0) if found is None else tuple(2 * found[
                    min(ty // 2, len(found) - 1), min(tx // 2, len(found[0]) - 1)])
                finer[ty, tx] = search(planes[reference], planes[i], ty, tx, start, radius)
                if level == 0:
                    out[i, ty, tx] = finer[ty, tx] + fraction(planes[reference], planes[i], ty, tx, finer[ty, tx])
            found = finer
    return out


def window(plane, ty, tx, dy=0, dx=0):
    """A tile of a plane that goes on outside itself as at its edge."""
    y = np.clip(np.arange(ty * TILE + dy, (ty + 1) * TILE + dy), 0, plane.shape[0] - 1)
    x = np.clip(np.arange(tx * TILE + dx, (tx + 1) * TILE + dx), 0, plane.shape[1] - 1)
    return plane[np.ix_(y, x)]


def search(wanted, plane, ty, tx, start, radius):
    """The displacement of the least sum; another than the start only if it is better by a sixth."""
    start = tuple(np.clip(d, -2 * TILE - t * TILE, n + TILE - t * TILE)
                  for d, t, n in zip(start, (ty, tx), plane.shape, strict=True))
    tile = window(wanted, ty, tx)

    def cost(dy, dx):
        return abs(tile - window(plane, ty, tx, dy, dx)).sum()

    at_start = cost(*start)
    least, best = at_start - at_start // 6, start
    for dy in range(start[0] - radius, start[0] + radius + 1):
        for dx in range(start[1] - radius, start[1] + radius + 1):
            total = cost(dy, dx)
            if total < least:
                least, best = total, (dy, dx)
    return best


def fraction(wanted, plane, ty, tx, best):
    """Where a paraboloid has its minimum, fitted to the sums of squares around the best whole displacement."""
    # moving one tile forth instead of the other back, equal tiles give equal sums on both sides
    f = np.array([[((window(wanted, ty, tx, max(-dy, 0), max(-dx, 0)).astype(float)
                     - window(plane, ty, tx, best[0] + max(dy, 0), best[1] + max(dx, 0))) ** 2).sum()
                   for dx in (-1, 0, 1)] for dy in (-1, 0, 1)])
    slope_y, slope_x = (f[2] - f[0]).sum() / 6, (f[:, 2] - f[:, 0]).sum() / 6
    bend_y, bend_x = (f[2] - 2 * f[1] + f[0]).sum() / 3, (f[:, 2] - 2 * f[:, 1] + f[:, 0]).sum() / 3
    twist = (f[2, 2] - f[2, 0] - f[0, 2] + f[0, 0]) / 4
    sure_y, sure_x = bend_y > 0.25 * f[1, 1], bend_x > 0.25 * f[1, 1]
    determinant = bend_y * bend_x - twist**2
    if sure_y and sure_x and determinant > 0.25 * bend_y * bend_x:
        move = ((twist * slope_x - bend_x * slope_y) / determinant, (twist * slope_y - bend_y * slope_x) / determinant)
    else:
        move = (-slope_y / bend_y if sure_y else 0, -slope_x / bend_x if sure_x else 0)
    return np.clip(move, -0.5, 0.5)
