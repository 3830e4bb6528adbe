"""Samples with the light of others, float64."""

import numpy as np


def reveal(planes, index, factor):
    """Return the stage's result, see `reveal.py`."""
    planes = np.asarray(planes, np.float64)
    flat, out = planes.reshape(len(planes), -1), planes.copy()
    at, source, other = index
    f = np.asarray(factor, np.float64)
    out.reshape(len(planes), -1)[:, at] = (1 + f) * flat[:, source] - f * flat[:, other]
    return out
