"""mean(y, x) = T cos^4(theta(y, x)) rates[cfa(y, x), y, x], float64."""

import numpy as np


def relative_illumination(rows, cols, slope):
    """Return cos^4 theta at every pixel's centre, tan(theta) = r slope, shape (rows, cols)."""
    y = np.arange(rows)[:, None] - (rows - 1) / 2
    x = np.arange(cols) - (cols - 1) / 2
    return np.cos(np.arctan(np.hypot(y, x) * slope)) ** 4


def collect(rates, cfa, exposure_time, slope):
    """Return the stage's result, see `collect.py`."""
    rows, cols = rates.shape[1:]
    own = np.asarray(rates, np.float64)
    if cfa is not None:
        y, x = np.indices((rows, cols))
        channel = np.asarray(cfa)[y % len(cfa), x % len(cfa[0])]
        own = np.take_along_axis(own, channel[None], axis=0)[0]
    return exposure_time * relative_illumination(rows, cols, slope) * np.where(own < 0, 0, own)
