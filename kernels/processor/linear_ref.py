"""grey = (DN - black_level) scale, float64."""

import numpy as np


def linear(raw, *, black_level, scale):
    """See the contract."""
    return (np.asarray(raw, np.float64) - black_level)[None] * scale
