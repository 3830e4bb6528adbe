"""mean(y, x) = sum over k of weights(y, k) rates(k, y, x), float64; NaN x 0 is 0."""

import numpy as np


def shutter(rates, weights):
    """Return the stage's result, see `shutter.py`."""
    weights = np.asarray(weights, np.float64)
    mean = np.zeros(np.shape(rates)[1:])
    for k, picture in enumerate(np.asarray(rates)):
        rows = weights[:, k] != 0
        mean[rows] += weights[rows, k, None] * picture[rows].astype(np.float64)
    return mean
