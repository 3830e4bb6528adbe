"""Normal equations of every tile's step: float64, see the contract."""

import numpy as np

from gpusim.kernels.processor.align import TILE
from gpusim.kernels.processor.average_ref import keys

MARGIN = 4.0


def refine(raw, displacement, *, reference=0, period=(2, 2), table):
    """Return the stage's result, see `refine.py`."""
    dark, scale, shot, floor, full = np.asarray(table, np.float64)
    displacement = np.asarray(displacement, np.float64)
    count, *size = raw.shape
    tents = [tent(n, p) for n, p in zip(size, period, strict=True)]
    planes, fulls = [], []
    for i in range(count):
        mean = tents[0] @ raw[i].astype(np.float64) @ tents[1].T
        rate = (mean - dark[i]) * scale[i]
        planes.append(rate)
        left = (full[i] - dark[i]) * scale[i] - rate
        close = left < MARGIN * np.sqrt(shot[i] * np.maximum(rate, 0) + floor[i])
        fulls.append(close | ((tents[0] > 0) @ (raw[i] >= full[i]) @ (tents[1] > 0).T > 0))
    out = np.zeros((*displacement.shape[:3], 7))
    for i, ty, tx in np.ndindex(*out.shape[:3]):
        if i != reference:
            moves = displacement[i, ty, tx] * period
            variances = shot[i] + shot[reference], floor[i] + floor[reference]
            pair = [(planes[k], fulls[k]) for k in (reference, i)]
            out[i, ty, tx] = tile_sums(*pair, (ty, tx), moves, period, variances)
    return out


def tent(size, period):
    """Return the matrix of tent-shaped means along an axis that continues with its edge values."""
    matrix = np.zeros((size, size))
    for place in range(size):
        for step in range(1 - period, period):
            matrix[place, min(max(place + step, 0), size - 1)] += (period - abs(step)) / period**2
    return matrix


def tile_sums(wanted, seen, tile, moves, period, variances):
    """Return the seven sums of a tile. wanted, seen: L and where it is full, of both frames."""
    (own, own_full), (other, other_full) = wanted, seen
    places, taps, weights = [], [], []
    for t, p, n, move in zip(tile, period, own.shape, moves, strict=True):
        whole = int(np.floor(move))
        first = max(t * TILE * p, 1)
        along = np.arange(first, min((t + 1) * TILE * p, n - 1), p)
        along = along[(along + whole >= 1) & (along + whole + 2 < n)]
        places.append(along)
        taps.append(along + whole - 1)
        weights.append([float(weight) for weight in keys(move - whole)])
    if not (len(places[0]) and len(places[1])):
        return np.zeros(7)

    def at(values, dy=0, dx=0):
        return values[np.ix_(places[0] + dy, places[1] + dx)]

    value, usable = 0, np.ones((len(places[0]), len(places[1])), bool)
    for a in range(4):
        for b in range(4):
            there = np.ix_(taps[0] + a, taps[1] + b)
            value = value + weights[0][a] * weights[1][b] * other[there]
            usable &= ~other_full[there]
    for step in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        usable &= ~at(own_full, *step)
    weight = usable / (variances[0] * np.maximum(at(own), 0) + variances[1])
    slope_y, slope_x = ((at(own, *s) - at(own, -s[0], -s[1])) / 2 for s in ((1, 0), (0, 1)))
    off = value - at(own)
    terms = slope_y**2, slope_y * slope_x, slope_x**2, -slope_y * off, -slope_x * off, off**2
    return np.array([*((weight * term).sum() for term in terms), usable.sum()])
