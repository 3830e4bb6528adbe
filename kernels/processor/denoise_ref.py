"""Non-local means of a mosaic in the domain of constant noise, float64; the contract has the formulas."""

import numpy as np


def denoise(raw, *, cfa, black_level, scale, noise, strength=1.0):
    """See the contract."""
    (gain, read), period = noise, np.shape(cfa)
    d = np.asarray(raw, np.float64) - black_level
    if strength > 0 and (gain or read):
        c = read**2 + 3 / 8 * gain**2
        if gain:
            d = np.maximum(d, -c / gain)
        mean, n = non_local_mean(2 * d / (np.sqrt(gain * d + c) + np.sqrt(c)), period, strength)
        d = gain * mean**2 / 4 + np.sqrt(c) * mean + gain / 4 * (1 - 1 / n)
    return np.clip(np.floor(4096 + 61439 * scale * d + 0.5), 0, 65535).astype(np.uint16)


def non_local_mean(u, period, strength):
    """Weighted mean of u two periods around every pixel, and the sum of weights."""
    # outside, the outermost period goes on: every index moves inside by whole periods
    at = [np.arange(-2 * p - 1, n + 2 * p + 1) for n, p in zip(u.shape, period, strict=True)]
    at = [np.where(i < 0, i % p, np.where(i >= n, n - p + (i - n) % p, i))
          for i, n, p in zip(at, u.shape, period, strict=True)]
    wide = u[np.ix_(*at)]

    def moved(dy, dx):
        y, x = (2 * p + 1 + step for p, step in zip(period, (dy, dx), strict=True))
        return wide[y : y + u.shape[0], x : x + u.shape[1]]

    patch = [(v, w) for v in (-1, 0, 1) for w in (-1, 0, 1)]
    total, weights = u.copy(), np.ones_like(u)
    for sy in range(-2 * period[0], 2 * period[0] + 1, period[0]):
        for sx in range(-2 * period[1], 2 * period[1] + 1, period[1]):
            if sy or sx:
                t = np.mean([(moved(v, w) - moved(sy + v, sx + w)) ** 2 for v, w in patch], axis=0)
                weight = np.clip(1 - (t / strength**2 - 2) / 6, 0, 1) ** 2
                total += weight * moved(sy, sx)
                weights += weight
    return total / weights, weights
