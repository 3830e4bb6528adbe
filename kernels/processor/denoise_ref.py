"""Non-local means of a mosaic at constant noise, float64; formulas are in the contract."""

import numpy as np


def denoise(raw, *, cfa, black_level, scale, noise, strength=1.0):
    """Return the stage's result, see `denoise.py`."""
    gain, read = noise
    d = np.asarray(raw, np.float64) - black_level
    if strength > 0 and (gain or read):
        c = read**2 + 3 / 8 * gain**2
        if gain:
            d = np.maximum(d, -c / gain)
        mean, n = non_local_mean(
            2 * d / (np.sqrt(gain * d + c) + np.sqrt(c)), np.asarray(cfa), strength
        )
        d = gain * mean**2 / 4 + np.sqrt(c) * mean + gain / 4 * (1 - 1 / n)
    return np.clip(np.floor(4096 + 61439 * scale * d + 0.5), 0, 65535).astype(np.uint16)


def non_local_mean(u, cfa, strength):
    """Return the weighted mean of u around every pixel, and the sum of weights."""
    period = cfa.shape
    # outside, the outermost period is repeated: every index moves inside by whole periods
    at = [np.arange(-2 * p - 1, n + 2 * p + 1) for n, p in zip(u.shape, period, strict=True)]
    at = [
        np.where(i < 0, i % p, np.where(i >= n, n - p + (i - n) % p, i))
        for i, n, p in zip(at, u.shape, period, strict=True)
    ]
    wide = u[np.ix_(*at)]

    def shift(dy, dx):
        y, x = (2 * p + 1 + step for p, step in zip(period, (dy, dx), strict=True))
        return wide[y : y + u.shape[0], x : x + u.shape[1]]

    square = [(v, w) for v in (-1, 0, 1) for w in (-1, 0, 1)]

    def sum_steps(steps, patch):
        """Return the weighted sum of u, and the sum of weights, over displacements."""
        total, weights = np.zeros((2, *u.shape))
        for sy, sx in steps:
            t = np.mean([(shift(v, w) - shift(sy + v, sx + w)) ** 2 for v, w in patch], axis=0)
            weight = np.clip(1 - (t / strength**2 - 2) / 6, 0, 1) ** 2
            total += weight * shift(sy, sx)
            weights += weight
        return total, weights

    square = [(v, w) for v in (-1, 0, 1) for w in (-1, 0, 1)]
    total, weights = sum_steps(
        [(sy * period[0], sx * period[1]) for sy in range(-2, 3) for sx in range(-2, 3)], square
    )
    if period == (2, 2):  # the other green, if a pixel's diagonal neighbours have its colour
        alike = np.array([[cfa[y, x] == cfa[1 - y, 1 - x] for x in (0, 1)] for y in (0, 1)])
        alike = alike[np.ix_(np.arange(u.shape[0]) % 2, np.arange(u.shape[1]) % 2)]
        diagonal = [(v + w, v - w) for v, w in square]
        twins, count = sum_steps(
            [(sy, sx) for sy in (-3, -1, 1, 3) for sx in (-3, -1, 1, 3)], diagonal
        )
        share = alike * np.minimum(2, weights / np.maximum(count, 1e-6))
        total, weights = total + share * twins, weights + share * count
    return total / weights, weights
