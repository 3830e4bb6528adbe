"""planes_p(x) = sum_b W_pb content_b(x), float64."""

import numpy as np


def integrate(content, weights):
    """Return the stage's result, see `integrate.py`."""
    return np.tensordot(np.asarray(weights, np.float64), np.asarray(content, np.float64), axes=1)
