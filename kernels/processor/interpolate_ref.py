"""Linear interpolation of any mosaic, float64: values of planes that fit a channel's samples.

First-order normalised convolution with a tent: Knutsson and Westin 1993, CVPR, 515-523.
"""

from functools import cache
from itertools import count, product

import numpy as np


def interpolate(raw, *, cfa, black_level, scale):
    """Return the stage's result, see `interpolate.py`."""
    raw, cfa = np.asarray(raw, np.float64), shortest_period(np.asarray(cfa))
    period, rows_cols = cfa.shape, raw.shape
    out = np.empty((cfa.max() + 1, *rows_cols))
    for c, plane in enumerate(out):
        half, windows = smallest_tent(tuple(map(tuple, cfa == c)))
        pad = [(h - 1, h - 1) for h in half]
        values = np.lib.stride_tricks.sliding_window_view(
            np.pad(raw, pad), [2 * h - 1 for h in half]
        )
        exists = np.lib.stride_tricks.sliding_window_view(
            np.pad(np.ones(rows_cols), pad), [2 * h - 1 for h in half]
        )
        for (y, x), weights in windows.items():
            every = np.s_[y :: period[0], x :: period[1]]
            plane[every] = np.einsum(
                "...ij,...ij,ij", values[every], exists[every], weights
            ) / np.einsum("...ij,ij", exists[every], weights)
    return (out - black_level) * scale


def shortest_period(cfa):
    """Return one period, without repetitions."""

    def repeats(rows, cols):
        return np.array_equal(
            np.tile(cfa[:rows, :cols], (len(cfa) // rows, len(cfa[0]) // cols)), cfa
        )

    rows = min(n for n in range(1, len(cfa) + 1) if repeats(n, len(cfa[0])))
    cols = min(n for n in range(1, len(cfa[0]) + 1) if repeats(rows, n))
    return cfa[:rows, :cols]


@cache
def smallest_tent(sampled):
    """Return half-widths of the smallest tent for all phases, and {phase: weights}."""
    sampled = np.array(sampled)
    for k in count(1):
        half = [min(k, period) for period in sampled.shape]
        windows = {
            phase: fit(sampled, phase, half) for phase in product(*map(range, sampled.shape))
        }
        if all(
            weights is not None and every_block_has_one(weights, half)
            for weights in windows.values()
        ):
            return half, windows


def fit(sampled, phase, half):
    """Return the weights by which samples make up the value of their plane here, or None.

    None if no plane has only positive weights.
    """
    weights = np.zeros([2 * h - 1 for h in half])
    if sampled[phase]:
        weights[half[0] - 1, half[1] - 1] = 1
        return weights
    places = np.array(
        [
            (dy, dx)
            for dy in range(1 - half[0], half[0])
            for dx in range(1 - half[1], half[1])
            if sampled[(phase[0] + dy) % len(sampled), (phase[1] + dx) % len(sampled[0])]
        ]
    ).reshape(-1, 2)
    while len(places):
        root = np.sqrt((1 - abs(places) / half).prod(axis=1))
        design = np.column_stack([np.ones(len(places)), places])
        # value at 0 of the weighted least squares
        row = np.linalg.pinv(root[:, None] * design, rcond=1e-6)[0] * root
        if row.min() > -1e-9:
            for (dy, dx), weight in zip(places, row, strict=True):
                weights[dy + half[0] - 1, dx + half[1] - 1] = weight if weight > 1e-9 else 0
            return weights if np.allclose(row @ design, (1, 0, 0), atol=1e-9) else None
        places = places[row > -1e-9]
    return None


def every_block_has_one(weights, half):
    """Return whether each block of `half` pixels in the window holds a sample."""
    return (np.lib.stride_tricks.sliding_window_view(weights, half) > 0).any(axis=(2, 3)).all()
