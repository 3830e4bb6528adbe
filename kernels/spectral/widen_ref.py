"""out_b(i, x) = content_b(row_i, x), float64."""

import numpy as np


def widen(content, chosen=None):
    """Content (entries, rows, cols), chosen rows (n,) or None for all -> (entries, n, cols)."""
    rows = range(content.shape[1]) if chosen is None else np.clip(chosen, 0, content.shape[1] - 1)
    return np.asarray(content, np.float64)[:, rows]
