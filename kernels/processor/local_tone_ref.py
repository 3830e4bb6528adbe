"""out_p = rgb_p (1 + s L / (1 + (B / S)^2) B^2 / (B^2 + n^2)), B of a guided filter on blocks, float64.

Means are over what a block or a window has of the picture.
"""

import numpy as np

from gpusim.kernels.common.nodes_ref import interpolate
from gpusim.kernels.processor.local_tone import (
    BLOCKS,
    DARKEST,
    EDGE,
    LIFT,
    NOISY,
    REACH,
    SHADOW,
)


def local_tone(rgb, luminance, *, strength, noise=0.0):
    """Return the stage's result, see `local_tone.py`."""
    rgb = np.asarray(rgb, np.float64)
    rows, cols = rgb.shape[1:]
    with np.errstate(all="ignore"):
        light = np.einsum("p,pyx->yx", np.asarray(luminance, np.float64), rgb)
        stops = np.log2(np.maximum(light, 0) + DARKEST)
        size = max(1, round(min(rows, cols) / BLOCKS))
        means = _mean_blocks(np.where(np.isfinite(light), light, np.nan), size)
        slope, offset = _guide(np.log2(np.maximum(means, 0) + DARKEST))
        y, x = ((np.arange(n) + 0.5) / size - 0.5 for n in (rows, cols))
        base = interpolate(slope, y, x) * stops + interpolate(offset, y, x)
        around = np.maximum(2**base - DARKEST, 0)
        dark = (NOISY * noise) ** 2
        seen = np.where(around + dark > 0, around**2 / (around**2 + dark), 1.0)
        gain = 1 + strength * LIFT / (1 + (around / SHADOW) ** 2) * seen
        return np.where(np.isfinite(light), gain, 1.0) * rgb


def _mean_blocks(light, size):
    """Return means of blocks, without NaN; 0 of blocks without any value."""
    rows, cols = (-(-n // size) for n in light.shape)
    wide = np.full((rows * size, cols * size), np.nan)
    wide[: light.shape[0], : light.shape[1]] = light
    parts = wide.reshape(rows, size, cols, size)
    return np.nansum(parts, (1, 3)) / np.maximum(np.isfinite(parts).sum((1, 3)), 1)


def _guide(base):
    """Return slope and offset of the guided filter on blocks."""
    mean, square = _window_means(base), _window_means(base**2)
    variance = np.maximum(square - mean**2, 0)
    slope = variance / (variance + EDGE)
    return _window_means(slope), _window_means((1 - slope) * mean)


def _window_means(values):
    """Return means over windows of 2 REACH + 1 blocks, cut at the frame."""
    rows, cols = values.shape
    out = np.empty(values.shape)
    for y in range(rows):
        for x in range(cols):
            down = slice(max(y - REACH, 0), y + REACH + 1)
            out[y, x] = values[down, max(x - REACH, 0) : x + REACH + 1].mean()
    return out
