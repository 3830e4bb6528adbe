"""Blur that follows distance and field: in each tile, few terms times sums of eigen-kernels.

The kernel of every pixel of a tile is a sum of few terms: Chebyshev's polynomials of the place in the
tile, and of the pixel's circle of confusion among those in the tile. A term's kernel is a sum of the
eigen-kernels of `gpusim.optics.kernel_space`. So the cost of a tile depends on how much its own kernels
differ. `choose_terms` finds the terms, the stage `optics.expand` their values at each pixel, and
`optics.field` sums all this.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from gpusim.domain.interpolation import node_weights
from gpusim.optics.depth import DepthPlan
from gpusim.optics.kernel_space import MOST_DEGREE, KernelSpace, chebyshev, chebyshev_solver
from gpusim.optics.placed import Placed

EVEN = 1e-6  # of a flat field: gains nearer to 1 are left out
# circles of confusion at which polynomials of degree 0 are compared with the kernels; two more a degree
CHECKS = 5
WIDE = 2  # [pixel] of circles of confusion around a tile's middle, up to which the stage lets flat fields change


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the kernels in each tile: inputs of the stages `optics.expand` and `optics.field`.

    Attributes:
        degrees: Degrees of the polynomials of the place along rows and columns, and of the circle of confusion, int32,
            shape (terms, 3).
        spans: Middle of the circles of confusion in each tile [pixel], and 1 over half their range, or 0, float32,
            shape (tiles, 2).
        even: Brightness of an even surface, less that at the reference, in the planes of coverage: in the middle of
            each tile, its change to the tile's sides along rows and columns, and with the circle of confusion, float32,
            shape (channels, tiles, 4); None: it is 0.
        index: Weights of the eigen-kernels in each term, float32, shape (tiles, terms, K); with a coarse grid, last of
            the near part of the kernel on the axis, (tiles, terms, K + 1).
        limits: Least and largest circle of confusion [pixel].
    """

    degrees: np.ndarray
    spans: np.ndarray
    even: np.ndarray | None
    index: np.ndarray
    limits: tuple[float, float]


def choose_terms(
    made: KernelSpace,
    confusion: np.ndarray,
    cover: np.ndarray,
    placed: Placed | None = None,
    window: tuple[slice, slice] | None = None,
) -> Terms:
    """Return the terms of a layer's kernels in each tile.

    Args:
        made: The kernels.
        confusion: Circle of confusion of each sample [pixel], shape (rows, cols).
        cover: Coverage [1], same shape. Where it is 0, the circle of confusion has no effect.
        placed: Where the frame's pixels take samples from; None: each its own.
        window: Rows and columns with all light of the layer, which takes the near part of the kernel on the axis; None:
            only differences from it are wanted.
    """
    middle, half, is_there = _spans(made.edges, confusion, cover, placed)
    index: list[np.ndarray] = []
    degrees: list[tuple[int, int, int]] = []
    for power, values in zip(made.degrees, made.values, strict=True):
        found, _ = _polynomials(made, values, middle, half, is_there)
        for degree in range(found.shape[1]):
            if not degrees or found[:, degree].any():
                degrees.append((*power, degree))
                index.append(found[:, degree])
    weights = np.stack(index, axis=1).astype(np.float32)
    if made.coarse is not None:  # the last kernel
        near = np.zeros((*weights.shape[:2], 1), np.float32)
        if window is not None:
            near[:, 0, 0] = _meets(made, window)
        weights = np.concatenate([weights, near], axis=2)
    scale = np.divide(1, half, out=np.zeros_like(half), where=half > 0)
    return Terms(
        np.array(degrees, np.int32),
        np.stack([middle, scale], axis=1).astype(np.float32),
        _even(made, middle),
        weights,
        (float(confusion.min()), float(confusion.max())),
    )


def expansion_error(made: KernelSpace, depth: DepthPlan):
    """Return relative errors of the terms of layers: RMS and largest of a natural scene, and of flat fields."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets other threads run
        found = list(pool.map(partial(_layer_error, made, depth), range(depth.layers)))
    worst, most, *even = map(max, zip((0.0, 0.0, 0.0, 0.0), *found, strict=True))
    return (float(np.sqrt(worst)), float(np.sqrt(most))), tuple(even)


def _layer_error(made, depth, layer):
    """Return mean and largest square of the errors of a layer's terms; RMS and largest error of its flat fields."""
    cover, confusion = depth.surface(layer)
    middle, half, is_there = _spans(made.edges, confusion, cover)
    if not is_there.any():
        return 0.0, 0.0, 0.0, 0.0
    errors = [_polynomials(made, values, middle, half, is_there)[1] for values in made.values]
    each = np.sum(errors, axis=0)[is_there]
    return float(each.mean()), float(each.max()), *_even_error(made, middle, half, is_there)


def _even_error(made, middle, half, is_there):
    """Return what straight lines over the circle of confusion miss of flat fields: RMS and largest."""
    terms = _even(made, middle)
    if terms is None:
        return 0.0, 0.0
    even = made.even - made.even[:, :, [made.reference]]
    wrong = []
    for x in np.linspace(-1, 1, CHECKS):
        at = node_weights(made.nodes, middle + half * x)
        true = np.einsum("tn,ctn->ct", at, even)
        line = terms[..., 0] + terms[..., 3] * np.clip(half * x, -WIDE, WIDE)
        wrong.append((line - true)[:, is_there])
    return float(np.sqrt(np.mean(np.square(wrong)))), float(np.abs(wrong).max())


def _meets(made, window):
    """Return whether light of a window arrives in each tile, as 0 or 1."""
    reach, found = made.kernels.shape[-1] // 2, []  # light is mirrored at the frame's sides
    for edge, its in zip(made.edges, window, strict=True):
        first, last = np.array(_inside(edge, edge[-1] + edge[0])).T
        found.append((first - reach < its.stop) & (last + reach > its.start))
    return (found[0][:, None] & found[1]).ravel()


def _spans(edges, confusion, cover, placed=None):
    """Return the middle and half the range of each tile's circles of confusion, and whether it covers any pixel.

    If pixels take samples from elsewhere, these are bounds.
    """
    rows, cols = (
        [slice(a, b) for a, b in _inside(edge, edge[-1] + edge[0])]  # the frame's size
        for edge in edges
    )
    is_whole, low, high = cover.min() > 0, [], []
    for down in rows:
        for across in cols:
            part = (down, across) if placed is None else placed.find_sources((down, across))
            covered, part = cover[part], confusion[part]
            if not is_whole:
                part = part[covered != 0]
            low.append(part.min() if part.size else np.inf)
            high.append(part.max() if part.size else -np.inf)
    is_there = np.isfinite(low)
    low, high = np.where(is_there, low, 0), np.where(is_there, high, 0)
    return (low + high) / 2, (high - low) / 2, is_there


def _inside(edge, size):
    """Return first and last pixel of the frame, plus 1, whose light is in each tile; beyond the frame the outermost."""
    first = np.clip(edge[:-1], 0, size - 1)
    return list(zip(first, np.maximum(np.clip(edge[1:], 0, size), first + 1), strict=True))


def _polynomials(made, values, middle, half, is_there):
    """Return Chebyshev's polynomials of the circle of confusion in each tile, and the squares of their errors.

    A tile has the lowest degree whose error is below the limit, as mean over its circles. values: coefficients of the
    kernels (tiles, N, K). The first result has the shape (tiles, degrees, K).
    """
    tiles, _, count = values.shape
    wrong, found = np.zeros(tiles), np.zeros((tiles, MOST_DEGREE + 1, count))
    left = np.flatnonzero(is_there)
    most = 0
    for degree in range(MOST_DEGREE + 1):
        if not len(left):
            break
        x = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        at = node_weights(made.nodes, middle[left, None] + half[left, None] * x)
        own = values[left]
        found[left, : degree + 1] = np.einsum("di,tik->tdk", chebyshev_solver(degree), at @ own)
        checks = np.linspace(-1, 1, CHECKS + 2 * degree)
        at = node_weights(made.nodes, middle[left, None] + half[left, None] * checks)
        poly = chebyshev(np.arange(degree + 1), checks[:, None])
        error = np.square(poly @ found[left, : degree + 1] - at @ own) @ made.weights
        wrong[left], most = error.mean(axis=1), degree
        left = left[wrong[left] > made.limit**2]
    return found[:, : most + 1], wrong


def _even(made, middle):
    """Return what even surfaces have in each tile, see `Terms`: linear in the place and in the circle of confusion."""
    even = made.even - made.even[:, :, [made.reference]]
    slopes = made.even_slopes - made.even_slopes[..., [made.reference]]
    if max(np.abs(even).max(), np.abs(slopes).max()) <= EVEN:
        return None
    at = node_weights(made.nodes, np.stack([middle, middle + 0.5], axis=1))
    value, more = np.einsum("tin,ctn->ict", at, even)
    by_row, by_col = np.einsum("tn,actn->act", at[:, 0], slopes)
    return np.stack([value, by_row, by_col, 2 * (more - value)], axis=-1).astype(np.float32)
