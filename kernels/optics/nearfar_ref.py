"""B(I, n) = sum_t columns[n, t] * (rows[n, t] * I) + enlarged(B(blocks of I, n + 1)), float64, on wide surroundings."""

import numpy as np
from scipy.ndimage import convolve1d

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def nearfar(planes, levels, mix, border, factor=2):
    """See the contract. The frame is padded by more than the kernels reach, so that no level has a border."""
    count, rows, cols = planes.shape
    mix = np.asarray(mix, np.float64)
    unit = factor ** (len(levels) - 1)
    reach = sum((columns.shape[3] // 2 + 2) * factor**n for n, (columns, _) in enumerate(levels))
    before = -(-reach // unit) * unit
    pads = [(before, before + -n % unit) for n in (rows, cols)]
    out = np.zeros((len(mix), rows, cols))
    for k in range(count):
        wide = np.pad(np.asarray(planes[k], np.float64), pads, mode=MODES[border])
        for c in range(len(mix)):
            group = c if levels[0][0].shape[0] > 1 else 0
            blurred = _level(wide, [(columns[group, k], lines[group, k]) for columns, lines in levels], factor)
            out[c] += mix[c, k] * blurred[before : before + rows, before : before + cols]
    return out


def _level(image, levels, factor):
    (columns, lines), *rest = levels
    out = sum(convolve1d(convolve1d(image, column, 0, mode="wrap"), line, 1, mode="wrap")
              for column, line in zip(np.asarray(columns, float), np.asarray(lines, float), strict=True))
    if rest:
        n, m = image.shape
        blocks = image.reshape(n // factor, factor, m // factor, factor).sum(axis=(1, 3))
        out = out + _finer(_finer(_level(blocks, rest, factor), factor, 0), factor, 1)
    return out


def _finer(image, factor, axis):
    n = image.shape[axis]
    at = (np.arange(n * factor) + 0.5) / factor - 0.5
    low = np.floor(at).astype(int)
    share = (at - low).reshape(-1, 1) if axis == 0 else at - low
    return (1 - share) * np.take(image, low % n, axis) + share * np.take(image, (low + 1) % n, axis)
