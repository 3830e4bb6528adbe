"""planes_p(x) = shading(x) W[p, id(x)], float64."""

import numpy as np


def materials(ids, shading, table):
    """Ids (rows, cols), shading (rows, cols), table (planes, materials) -> (planes, rows, cols)."""
    return np.asarray(shading, np.float64) * np.asarray(table, np.float64)[:, ids]
