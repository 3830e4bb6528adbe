"""Defective pixels found and replaced, in integers; only the threshold is float32.

The contract has the rules. Only the search is vectorised here.
"""

import numpy as np


def defects(raw, known=None, *, cfa, black_level, noise=(0.0, 0.0), detect=None):
    """Return the stage's result, see `defects.py`."""
    raw, cfa = np.asarray(raw), np.asarray(cfa)
    if known is not None:
        raw = replace(raw, np.asarray(known) != 0, cfa)
    if detect is not None:
        raw = replace(raw, find_defects(raw, cfa, black_level, noise, detect), cfa)
    return raw


def rings_of(cfa, y, x):
    """Return offsets to pixels of the colour of (y, x), ring by ring, in the search distance."""
    ry, rx = (max(4, 2 * n) for n in cfa.shape)
    dy, dx = np.mgrid[-ry : ry + 1, -rx : rx + 1]
    same = (
        cfa[(y + dy) % cfa.shape[0], (x + dx) % cfa.shape[1]]
        == cfa[y % cfa.shape[0], x % cfa.shape[1]]
    )
    square = dy**2 + dx**2
    return [np.argwhere(same & (square == s)) - (ry, rx) for s in np.unique(square[same]) if s > 0]


def groups_of(cfa, y, x):
    """Return the same; the first rings that together hold at least eight are one group."""
    rings = rings_of(cfa, y, x)
    n = 1
    while n < len(rings) and sum(map(len, rings[:n])) < 8:
        n += 1
    return [np.concatenate(rings[:n]), *rings[n:]]


def find_defects(raw, cfa, black_level, noise, detect):
    """Return the pixels that the rule finds defective, bool (rows, cols)."""
    far = 2 * 8 + 1
    inside = np.pad(np.ones(raw.shape, bool), far)
    value = np.pad(raw.astype(np.int64), far)

    def at(plane, y, x, dy, dx):
        return plane[far + dy :, far + dx :][: raw.shape[0], : raw.shape[1]][
            y :: cfa.shape[0], x :: cfa.shape[1]
        ]

    out = np.zeros(raw.shape, bool)
    for y, x in np.ndindex(min(cfa.shape[0], raw.shape[0]), min(cfa.shape[1], raw.shape[1])):
        here, around = at(value, y, x, 0, 0), groups_of(cfa, y, x)[0]
        high = np.max(
            [np.where(at(inside, y, x, *n), at(value, y, x, *n), -1) for n in around], axis=0
        )
        low = np.min(
            [np.where(at(inside, y, x, *n), at(value, y, x, *n), 65536) for n in around], axis=0
        )
        spread = 0
        for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            n = next(
                n
                for n in range(2, 10)
                if cfa[(y + n * dy) % len(cfa), (x + n * dx) % len(cfa[0])]
                == cfa[(y + dy) % len(cfa), (x + dx) % len(cfa[0])]
            )
            difference = at(value, y, x, dy, dx) - at(value, y, x, n * dy, n * dx)
            spread = spread + np.where(at(inside, y, x, n * dy, n * dx), difference, 0)
        above = here > high
        excess = np.where(above, here - high, low - here)
        end = np.where(above, high, low).astype(np.float32)
        limit = np.float32(detect * detect * noise[0]) * np.maximum(
            end - np.float32(black_level), np.float32(0)
        ) + np.float32(detect * detect * noise[1] * noise[1])
        spread = np.where(above, spread, -spread)
        square, spread_square = (part.astype(np.float32) ** 2 for part in (excess, spread))
        out[y :: cfa.shape[0], x :: cfa.shape[1]] = (
            (high >= 0)
            & (excess > 0)
            & (square > limit)
            & (excess > high - low)
            & ((8 * spread <= excess) | (spread_square <= limit))
        )
    return out


def replace(raw, bad, cfa):
    """Return the frame with defective pixels replaced from good neighbours of their colour."""
    out, groups = raw.copy(), {}
    for y, x in np.argwhere(bad):
        phase = y % cfa.shape[0], x % cfa.shape[1]
        if phase not in groups:
            groups[phase] = groups_of(cfa, *phase)
        nearest = {}
        for group in groups[phase]:
            good = {
                (v - y, u - x): int(raw[v, u])
                for v, u in np.add(group, (y, x))
                if 0 <= v < raw.shape[0] and 0 <= u < raw.shape[1] and not bad[v, u]
            }
            nearest = nearest or good
            pairs = [
                (abs(a - good[-dy, -dx]), (a + good[-dy, -dx] + 1) // 2)
                for (dy, dx), a in good.items()
                if (-dy, -dx) in good
            ]
            if pairs:
                out[y, x] = min(pairs)[1]
                break
        else:
            if nearest:
                out[y, x] = (2 * sum(nearest.values()) + len(nearest)) // (2 * len(nearest))
    return out
