"""Lens shading undone, float64: 4096 + 61439 gain (DN - black_level) scale, rounded and clipped."""

import numpy as np


def shade(raw, gains, *, cfa, black_level, scale):
    """Return the stage's result, see `shade.py`."""
    cfa = np.asarray(cfa)
    y, x = (
        np.interp((np.arange(n) + 0.5) / n, np.linspace(0, 1, m), np.arange(m))
        for n, m in zip(raw.shape, gains.shape[1:], strict=True)
    )
    channel = cfa[
        np.arange(raw.shape[0])[:, None] % len(cfa), np.arange(raw.shape[1]) % len(cfa[0])
    ]
    rows, cols = (
        np.minimum(place.astype(int), m - 2)
        for place, m in zip((y, x), gains.shape[1:], strict=True)
    )
    gain, (v, u) = 0.0, ((y - rows)[:, None], x - cols)
    for j, wy in ((0, 1 - v), (1, v)):
        for i, wx in ((0, 1 - u), (1, u)):
            gain = (
                gain + wy * wx * np.asarray(gains, np.float64)[channel, rows[:, None] + j, cols + i]
            )
    values = 4096 + 61439 * gain * (np.asarray(raw, np.float64) - black_level) * scale
    return np.clip(np.floor(values + 0.5), 0, 65535).astype(np.uint16)
