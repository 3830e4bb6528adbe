"""Frames moved by cubic interpolation within a colour, and averaged if they fit: float64."""

import numpy as np

from gpusim.kernels.processor.align import TILE
from gpusim.kernels.processor.average import OUTSIDE


def average(raw, displacement, *, reference=0, period=(2, 2), black_level, noise):
    """Return the stage's result, see `average.py`."""
    raw, displacement = np.asarray(raw, np.float64), np.asarray(displacement, np.float64)
    count, rows, cols = raw.shape
    total, weight = raw[reference].copy(), np.ones((rows, cols))
    for i in range(count):
        if i != reference:
            moved, left, inside = move(raw[i], displacement[i], period)
            light = np.maximum((moved + raw[reference]) / 2 - black_level, 0)
            q = (moved - raw[reference]) ** 2 / ((1 + left) * (noise[0] * light + noise[1] ** 2))
            share = trust(np.where(inside, q, OUTSIDE), period)
            total += share * moved
            weight += share
    return total / weight


def move(frame, displacement, period):
    """Return the moved frame, the variance left of its noise, and whether all taps were inside."""
    rows, cols = frame.shape
    y, x = np.mgrid[:rows, :cols]
    tile = [
        np.minimum(place // step // TILE, last - 1)
        for place, step, last in zip((y, x), period, displacement.shape, strict=False)
    ]
    d = displacement[tile[0], tile[1]]
    whole = np.floor(d)
    weights_y, weights_x = keys(d[..., 0] - whole[..., 0]), keys(d[..., 1] - whole[..., 1])
    moved, left, inside = np.zeros(frame.shape), np.zeros(frame.shape), np.ones(frame.shape, bool)
    for a in range(4):
        for b in range(4):
            share = weights_y[a] * weights_x[b]
            v = y + (whole[..., 0].astype(int) + a - 1) * period[0]
            u = x + (whole[..., 1].astype(int) + b - 1) * period[1]
            there = (v >= 0) & (v < rows) & (u >= 0) & (u < cols)
            inside &= there | (share == 0)
            moved += np.where(there, share * frame[v.clip(0, rows - 1), u.clip(0, cols - 1)], 0)
            left += share**2
    return moved, left, inside


def keys(s):
    """Return the weights of the samples at -1, 0, 1, 2 for 0 <= s < 1."""

    def inner(t):
        return 1 - 2.5 * t**2 + 1.5 * t**3

    def outer(t):
        return 2 - 4 * t + 2.5 * t**2 - 0.5 * t**3

    # t in 1 .. 2 of the outer piece; exactly 0 at whole displacements
    return [
        np.where(s == 0, 0, outer(1 + s)),
        inner(s),
        inner(1 - s),
        np.where(s == 0, 0, outer(2 - s)),
    ]


def trust(q, period):
    """Return each pixel's weight from the mean of q over 3 x 3 blocks; edges continue."""
    (rows, cols), (py, px) = q.shape, period
    h, w = -(-rows // py), -(-cols // px)
    padded = np.full((h * py, w * px), np.nan)
    padded[:rows, :cols] = q
    blocks = np.pad(np.nanmean(padded.reshape(h, py, w, px), axis=(1, 3)), 1, mode="edge")
    mean = sum(blocks[a : a + h, b : b + w] for a in range(3) for b in range(3)) / 9
    scatter = np.sqrt(2 / (9 * py * px))
    low = max(1.5, 1 + 2.1 * scatter)
    high = max(2.5, low + 4.2 * scatter)
    share = np.clip((high - mean) / (high - low), 0, 1)
    return share.repeat(py, axis=0).repeat(px, axis=1)[:rows, :cols]
