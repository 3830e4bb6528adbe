"""out(p, y, x) = base(p, y, x) + gains(p or 0, y, x) planes(p, y, x), float64."""

import numpy as np


def falloff(planes, gains, base=None):
    """Return the stage's result, see `falloff.py`."""
    product = np.asarray(planes, np.float64) * np.asarray(gains, np.float64)
    return product if base is None else base + product
