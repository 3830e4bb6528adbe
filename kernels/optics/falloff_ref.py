"""out(p, y, x) = gains(p or 0, y, x) planes(p, y, x), float64."""

import numpy as np


def falloff(planes, gains):
    """Return the stage's result, see `falloff.py`."""
    return np.asarray(planes, np.float64) * np.asarray(gains, np.float64)
