"""Interpolation by cubics: of kernels between circles of confusion, and of point spreads between distances."""

import numpy as np


def stencil(nodes: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the first of the neighbouring nodes from which each value is interpolated, and how many: 4, or all."""
    count = min(4, len(nodes))
    first = np.searchsorted(nodes, at, "right") - count // 2
    return np.clip(first, 0, len(nodes) - count), count


def node_weights(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return weights by which values at nodes (N,) are interpolated by cubics, at points of any shape: (..., N)."""
    first, count = stencil(nodes, at)
    out = np.zeros((*at.shape, len(nodes)))
    for own in range(count):
        weight = np.ones(at.shape)
        for other in range(count):
            if other != own:
                apart = nodes[first + own] - nodes[first + other]
                weight = weight * (at - nodes[first + other]) / apart
        np.put_along_axis(out, (first + own)[..., None], weight[..., None], axis=-1)
    return out
