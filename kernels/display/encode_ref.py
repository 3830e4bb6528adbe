"""The code of a value is how many thresholds lie at or below it."""

import numpy as np


def encode(rgb, thresholds):
    """Rgb (3, rows, cols), thresholds (255,) -> (rows, cols, 3) uint8. NaN is black."""
    linear = np.where(np.isnan(rgb), -np.inf, np.asarray(rgb, np.float64))
    counts = np.searchsorted(np.asarray(thresholds, np.float64), linear, side="right")
    return np.moveaxis(counts.astype(np.uint8), 0, -1)
