"""out(y, x) = sum_ij k_i(s) k_j(t) planes(floor(Y) - 1 + i, floor(X) - 1 + j), float64, edges repeated.

(Y, X) = (y, x) + the bilinear interpolant of the nodes, s and t its fractions, k Keys's cubic.
"""

import numpy as np

from gpusim.kernels.common.nodes_ref import interpolate


def rectify(planes, nodes):
    """Return the stage's result, see `rectify.py`."""
    planes, nodes = np.asarray(planes, np.float64), np.asarray(nodes, np.float64)
    y, x = (
        (np.arange(n) + 0.5) * (count - 1) / n
        for n, count in zip(planes.shape[1:], nodes.shape[2:], strict=True)
    )
    moved = interpolate(nodes, y, x) + np.indices(planes.shape[1:])
    return np.stack([_cubic(one, *moved[p % len(nodes)]) for p, one in enumerate(planes)])


def _cubic(plane, y, x):
    rows, cols = plane.shape
    low_y, low_x = np.floor(y), np.floor(x)
    out = np.zeros(y.shape)
    for i in range(-1, 3):
        row = np.clip(low_y + i, 0, rows - 1).astype(int)
        for j in range(-1, 3):
            col = np.clip(low_x + j, 0, cols - 1).astype(int)
            out += _keys(y - low_y - i) * _keys(x - low_x - j) * plane[row, col]
    return out


def _keys(t):
    """Return Keys's cubic with a = -1/2."""
    t = np.abs(t)
    near = (1.5 * t - 2.5) * t * t + 1
    far = ((-0.5 * t + 2.5) * t - 4) * t + 2
    return np.where(t < 1, near, np.where(t < 2, far, 0.0))
