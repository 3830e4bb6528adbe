"""Bilinear values between nodes at whole indices, for references."""

import numpy as np


def interpolate(values: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return bilinear values (..., len(y), len(x)) of planes (..., ny, nx) at indices y and x, edges repeated."""
    values = np.moveaxis(values, -2, 0)
    values = _along_first(values, y)
    return np.moveaxis(_along_first(np.moveaxis(values, -1, 0), x), (0, 1), (-1, -2))


def _along_first(values, place):
    place = np.clip(place, 0, len(values) - 1)
    low = np.minimum(place.astype(int), max(len(values) - 2, 0))
    part = (place - low).reshape(-1, *[1] * (values.ndim - 1))
    return (1 - part) * values[low] + part * values[np.minimum(low + 1, len(values) - 1)]
