"""Polynomials of place and circle of confusion, float64."""

import numpy as np
from numpy.polynomial.chebyshev import chebval


def expand(cover, degrees, spans, edges, limits, even=None):
    """Return the stage's result, see `expand.py`."""
    cover, spans = np.asarray(cover, np.float64), np.asarray(spans, np.float64)
    _, rows, cols = cover.shape
    v, u = np.empty((rows, 1)), np.empty(cols)
    tile = np.zeros((rows, cols), int)
    for axis, (edge, size) in enumerate(zip(edges, (rows, cols), strict=True)):
        for t in range(len(edge) - 1):
            first, last = max(edge[t], 0), min(edge[t + 1], size) - 1
            if last < first:
                continue
            # sides of the outermost tiles are middles of pixels
            low = first if t == 0 else first - 0.5
            high = last if t == len(edge) - 2 else last + 0.5
            at = (np.arange(first, last + 1) - (low + high) / 2) / max((high - low) / 2, 0.5)
            if axis == 0:
                v[first : last + 1, 0] = at
                tile[first : last + 1] += t * (len(edges[1]) - 1)
            else:
                u[first : last + 1] = at
                tile[:, first : last + 1] += t
    alpha, weighted = cover
    there = np.abs(alpha) > 1e-6
    circle = limits[0] + np.where(there, weighted / np.where(there, alpha, 1), 0)
    away = np.clip(circle, *limits) - spans[tile, 0]
    x = np.clip(away * spans[tile, 1], -1, 1)
    found = []
    for a, b, d in np.asarray(degrees):
        parts = [chebval(at, np.eye(n + 1)[n]) for at, n in ((v, a), (u, b), (x, d))]
        found.append(parts[0] * parts[1] * parts[2])
    for e in () if even is None else np.asarray(even, np.float64):
        e0, e1, e2, e3 = e[tile].transpose(2, 0, 1)
        found.append(1 / (1 + e0 + e1 * v + e2 * u + e3 * np.clip(away, -2, 2)))
    return np.stack(found)
