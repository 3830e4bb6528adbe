"""Statistics of light by NumPy: sorted float64 values."""

import numpy as np


def meter(rates, weights_y, weights_x, fractions=()):
    """Return the stage's result, see `meter.py`."""
    rates = np.asarray(rates, np.float64)
    is_finite = np.isfinite(rates)
    values = np.sort(rates[is_finite])
    n = len(values)
    missing = rates.size - n
    if not n:
        return np.array([0, 0, 0, 0, missing, 0, *[0, 0] * len(fractions)], np.float64)
    weights = np.outer(np.asarray(weights_y, np.float64), np.asarray(weights_x, np.float64))
    largest = np.abs(values).max()
    root_mean_square = largest * np.sqrt(np.mean((values / largest) ** 2)) if largest else 0.0
    pairs = [
        values[min(int(np.floor(q * (n - 1))) + more, n - 1)] for q in fractions for more in (0, 1)
    ]
    centre = np.sum(weights[is_finite] * rates[is_finite])
    return np.array(
        [values[-1], values.mean(), root_mean_square, centre, missing, values[0], *pairs]
    )
