"""grey = (DN - black_level) scale, float64."""

import numpy as np


def linear(raw, *, black_level, scale):
    """Return the stage's result, see `linear.py`."""
    return (np.asarray(raw, np.float64) - black_level)[None] * scale
