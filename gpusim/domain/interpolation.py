"""Interpolation: of spectra between a scene's wavelengths, of kernels and point spreads between theirs."""

from functools import lru_cache

import numpy as np

# Largest sum of magnitudes of a cubic spline's weights. On regular wavelengths it is 2. A narrow gap
# next to a wide one makes it large: the spline then swings far beyond the samples.
MOST_SWING = 4.0


def is_regular(nodes: np.ndarray) -> bool:
    """Return True if a cubic spline through samples at these nodes stays near them."""
    return _swings_little(tuple(np.asarray(nodes, np.float64)))


@lru_cache(maxsize=64)
def _swings_little(nodes):
    if len(nodes) < 3:
        return True
    at = np.array(nodes)
    weights = spline_weights(at, (at[1:] + at[:-1]) / 2)
    return bool(np.abs(weights).sum(axis=1).max() <= MOST_SWING)


def spectral_weights(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return weights by which spectra are interpolated between a scene's wavelengths: (M, L).

    They are a cubic spline's; straight lines' if the nodes are not regular, which never go below
    the samples.

    Args:
        nodes: Wavelengths of the samples [nm], shape (L,), L >= 2.
        at: Wavelengths to interpolate at [nm], shape (M,).

    Returns:
        The weights.
    """
    if is_regular(nodes):
        return spline_weights(nodes, at)
    return line_weights(nodes, at)


def line_weights(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return weights of straight lines between nodes (L,), at points (M,): (M, L)."""
    return np.stack([np.interp(at, nodes, one) for one in np.eye(len(nodes))], axis=1)


def spline_weights(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return weights of a cubic spline through nodes (L,), at points (M,): (M, L).

    Its ends are not-a-knot, or natural for up to three nodes. The bits equal the bits of SciPy's
    CubicSpline, whose import takes longer than a frame.
    """
    nodes, at = (np.asarray(values, np.float64) for values in (nodes, at))
    unit, step = np.eye(len(nodes)), np.diff(nodes)
    wide = step[:, None]
    chord = np.diff(unit, axis=0) / wide
    bands, right = np.zeros((3, len(nodes))), np.zeros_like(unit)  # of the slopes' equations
    bands[:, 1:-1] = 2 * (step[:-1] + step[1:])
    bands[0, 2:], bands[2, :-2] = step[:-1], step[1:]
    right[1:-1] = 3 * (wide[1:] * chord[:-1] + wide[:-1] * chord[1:])
    if len(nodes) > 3:
        span = nodes[2] - nodes[0]
        bands[1, 0], bands[0, 1] = step[1], span
        right[0] = ((wide[0] + 2 * span) * wide[1] * chord[0] + wide[0] ** 2 * chord[1]) / span
        span = nodes[-1] - nodes[-3]
        bands[1, -1], bands[2, -2] = step[-2], span
        right[-1] = wide[-1] ** 2 * chord[-2] + (2 * span + wide[-1]) * wide[-2] * chord[-1]
        right[-1] /= span
    else:
        bands[1, 0], bands[0, 1] = 2 * step[0], step[0]
        bands[1, -1], bands[2, -2] = 2 * step[-1], step[-1]
        right[0], right[-1] = 3 * (unit[1] - unit[0]), 3 * (unit[-1] - unit[-2])
    slopes = _solve_tridiagonal(bands[2, :-1], bands[1], bands[0, 1:], right)
    bend = (slopes[:-1] + slopes[1:] - 2 * chord) / wide
    piece = np.clip(np.searchsorted(nodes, at, "right") - 1, 0, len(nodes) - 2)
    offset = (at - nodes[piece])[:, None]
    out, power = unit[piece], offset
    for factor in (slopes[:-1], (chord - slopes[:-1]) / wide - bend, bend / wide):
        out, power = out + factor[piece] * power, power * offset
    return out


def _solve_tridiagonal(under, diagonal, above, right):
    """Return the solution of equations with a tridiagonal matrix, with the bits of LAPACK's dgtsv.

    All arguments are overwritten. `scipy.linalg`, which has it, takes 40 ms to import.

    under, diagonal, above: of the matrix, shapes (n - 1,), (n,) and (n - 1,). right: (n, columns).
    """
    second = np.zeros_like(above)  # above `above`, where rows are exchanged
    last = len(diagonal) - 1
    for i in range(last):
        if abs(diagonal[i]) >= abs(under[i]):
            factor = under[i] / diagonal[i]
            diagonal[i + 1] -= factor * above[i]
            right[i + 1] -= factor * right[i]
            continue
        factor = diagonal[i] / under[i]
        diagonal[i], above[i], below = under[i], diagonal[i + 1], above[i]
        diagonal[i + 1] = below - factor * above[i]
        if i + 1 < last:
            second[i], above[i + 1] = above[i + 1], -factor * above[i + 1]
        right[i], right[i + 1] = right[i + 1].copy(), right[i] - factor * right[i + 1]
    right[last] /= diagonal[last]
    for i in range(last - 1, -1, -1):
        right[i] -= above[i] * right[i + 1]
        if i + 2 <= last:
            right[i] -= second[i] * right[i + 2]
        right[i] /= diagonal[i]
    return right


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
