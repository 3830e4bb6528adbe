"""Differences of smoothed samples over what noise and texture explain: float64, see the contract."""

import numpy as np

from gpusim.kernels.processor.align import TILE

TEXTURE, MARGIN, OUTSIDE = 0.2, 3.2, 1e6


def trust(raw, displacement, *, reference=0, last=None, period=(2, 2), table):
    """Return the stage's result, see `trust.py`."""
    dark, scale, shot, floor, full = np.asarray(table, np.float64)
    count, rows, cols = raw.shape
    still = smooth(raw[reference], np.zeros((rows, cols, 2)), period)
    own, own_squares = still[0] - dark[reference], still[1]
    own_squares = (own_squares - 2 * dark[reference] * still[0] + dark[reference] ** 2) * (
        scale[reference] ** 2
    )
    own = own * scale[reference]
    own_full = still[3] >= full[reference]
    spread = 2 / (9 * 5.6 * period[0] * period[1])
    low = max(1.5, (1 - spread + 3.3 * np.sqrt(spread)) ** 3)
    high = 1.7 * low
    out = np.zeros((count, -(-rows // period[0]), -(-cols // period[1])))
    for i in range(count):
        moves = np.zeros((rows, cols, 2))
        if i != reference:
            moves = place_displacements(displacement[i], rows, cols, period)
        mean, _, kept, largest = smooth(raw[i], moves, period)
        other = (mean - dark[i]) * scale[i]
        light = np.maximum(other, 0)
        noise, own_noise = (shot[k] * light + floor[k] for k in (i, reference))
        left = (full[i] - dark[i]) * scale[i] - other
        is_full = (largest >= full[i]) | (left < MARGIN * np.sqrt(noise))
        change = np.maximum(own_squares - own**2 - (1 - still[2]) * own_noise, 0)
        expected = still[2] * own_noise + kept * noise + TEXTURE * change
        q = (other - own) ** 2 / expected
        q[own_full | (largest >= full[i])] = 0
        if i == reference:
            q[:] = 0
        blocks = block_means(q, period)
        if last is not None and i != last:
            blocks[block_means(is_full, period) > 0] = OUTSIDE
        around = np.pad(blocks, 1, mode="edge")
        h, w = blocks.shape
        mean = sum(around[a : a + h, b : b + w] for a in range(3) for b in range(3)) / 9
        out[i] = np.clip((high - mean) / (high - low), 0, 1)
    return out


def place_displacements(tiles, rows, cols, period):
    """Return the displacement at each pixel [pixel], (rows, cols, 2), linear between middles of tiles."""
    found = np.asarray(tiles, np.float64)
    for axis, (size, p) in enumerate(zip((rows, cols), period, strict=True)):
        count = found.shape[axis]
        if count == 1:
            found = np.repeat(found, size, axis=axis)
            continue
        at = (np.arange(size) + 0.5) / (TILE * p) - 0.5
        first = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = np.expand_dims(at - first, tuple(range(1, found.ndim - axis)))
        low, high = np.take(found, first, axis), np.take(found, first + 1, axis)
        found = low * (1 - part) + high * part
    return found * np.asarray(period)


def smooth(frame, moves, period):
    """Return mean, mean of squares, what is left of noise, and the largest number of the taps."""
    rows, cols = frame.shape
    y, x = np.mgrid[:rows, :cols]
    moved = np.asarray(moves) / np.asarray(period)
    whole = np.floor(moved).astype(int)
    weights = [basis(moved[..., k] - whole[..., k]) for k in (0, 1)]
    mean, squares, kept = np.zeros((3, rows, cols))
    largest = np.zeros((rows, cols))
    values = frame.astype(np.float64)
    for a in range(4):
        for b in range(4):
            v = hold(y + (whole[..., 0] + a - 1) * period[0], rows, period[0])
            u = hold(x + (whole[..., 1] + b - 1) * period[1], cols, period[1])
            weight = weights[0][a] * weights[1][b] * ((v >= 0) & (u >= 0))
            tap = values[v, u]
            mean += weight * tap
            squares += weight * tap**2
            largest = np.where(weight > 0, np.maximum(largest, tap), largest)
            kept += (weights[0][a] * weights[1][b]) ** 2
    return mean, squares, kept, largest


def basis(s):
    """Return the four cubic B-splines at 0 <= s < 1."""
    r = 1 - s
    return [r**3 / 6, 2 / 3 - s**2 + s**3 / 2, 2 / 3 - r**2 + r**3 / 2, s**3 / 6]


def hold(places, size, period):
    """Return places; outside, the outermost ones at the same place in the period; -1 without any."""
    places = np.where(places < 0, places % period, places)
    beyond = np.maximum(places - size + period, 0) // period
    places = places - np.where(places >= size, beyond * period, 0)
    return np.maximum(places, -1)


def block_means(values, period):
    """Return the mean over each block of a period; the last ones may be cut."""
    rows, cols = values.shape
    py, px = period
    return np.array(
        [
            [values[y : y + py, x : x + px].mean() for x in range(0, cols, px)]
            for y in range(0, rows, py)
        ]
    )
