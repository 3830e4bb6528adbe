"""Blur that follows distance and field: in each tile, few terms times sums of eigen-kernels.

`expand` gives the kernel of every pixel of a tile as a sum of few terms: Chebyshev's polynomials of the
place in the tile, and of the pixel's circle of confusion among those in the tile. A term's kernel is a
sum of the eigen-kernels of `gpusim.optics.kernel_space`. So the cost of a tile depends on how much its
own kernels differ. The stage `optics.field` sums all this.
"""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.interpolation import node_weights
from gpusim.optics.kernel_space import (
    MOST_DEGREE,
    KernelSpace,
    chebyshev,
    chebyshev_solver,
    middles_of,
)

EVEN = 1e-6  # of a flat field: gains nearer to 1 are left out
# circles of confusion at which polynomials of degree 0 are compared with the kernels; two more a degree
CHECKS = 5


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the kernels in each tile: inputs of the stage `optics.field`.

    Attributes:
        coefficients: Polynomials of place and circle of confusion, float32, shape (terms, rows, cols).
        index: Weights of the eigen-kernels in each term, float32, shape (tiles, terms, K).
        gains: Gains by which coverage of an even surface becomes as at the reference, float32, shape (channels,
            rows, cols); None: they are 1.
    """

    coefficients: np.ndarray
    index: np.ndarray
    gains: np.ndarray | None


def expand(made: KernelSpace, confusion: np.ndarray, cover: np.ndarray) -> Terms:
    """Return the terms of a layer's kernels in each tile.

    Args:
        made: The kernels.
        confusion: Circle of confusion of each pixel [pixel], shape (rows, cols).
        cover: Coverage [1], same shape. Where it is 0, the circle of confusion has no effect.
    """
    middle, half, is_there = _spans(made.edges, confusion, cover)
    index: list[np.ndarray] = []
    terms: list[tuple[int, int]] = []
    for power, values in enumerate(made.values):
        found, _ = _polynomials(made, values, middle, half, is_there)
        for degree in range(found.shape[1]):
            if not terms or found[:, degree].any():
                terms.append((power, degree))
                index.append(found[:, degree])
    maps = _maps(made, confusion, middle, half, terms)
    gains = _gains(made, confusion, middle)
    return Terms(maps, np.stack(index, axis=1).astype(np.float32), gains)


def expansion_error(made: KernelSpace, surfaces) -> float:
    """Return the relative RMS error of a natural scene by the terms of layers.

    surfaces: coverage and circles of confusion of each layer, pairs of (rows, cols).
    """
    worst = 0.0
    for cover, confusion in surfaces:
        middle, half, is_there = _spans(made.edges, confusion, cover)
        if is_there.any():
            errors = [
                _polynomials(made, values, middle, half, is_there)[1] for values in made.values
            ]
            worst = max(worst, float(np.sum(errors, axis=0)[is_there].mean()))
    return float(np.sqrt(worst))


def _spans(edges, confusion, cover):
    """Return the middle and half the range of each tile's circles of confusion, and whether it covers any pixel."""
    rows, cols = (
        [slice(a, b) for a, b in _inside(edge, size)]
        for edge, size in zip(edges, confusion.shape, strict=True)
    )
    is_whole, low, high = cover.min() > 0, [], []
    for down in rows:
        for across in cols:
            part = confusion[down, across]
            if not is_whole:
                part = part[cover[down, across] != 0]
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


def _maps(made, confusion, middle, half, terms):
    """Return the polynomials of place and circle of confusion at each pixel, float32 (terms, rows, cols)."""
    shape, sides = confusion.shape, middles_of(made.edges, confusion.shape)
    tiles = _tiles_of(made.edges, shape)
    along, grid = _along(shape, tiles, sides), [len(at) for at, _ in sides]
    circles: list = []
    if any(degree for _, degree in terms):
        scale = np.divide(1, half, out=np.zeros_like(half), where=half > 0)
        at = confusion - _spread(middle.reshape(grid), tiles)
        at *= _spread(scale.reshape(grid), tiles)
        np.clip(at, -1, 1, out=at)
        circles = [None, at]
    out = np.empty((len(terms), *shape), np.float32)
    for one, (power, degree) in zip(out, terms, strict=True):
        down, across = made.degrees[power]
        while len(circles) <= degree and degree:
            before = 1 if circles[-2] is None else circles[-2]
            circles.append(2 * circles[1] * circles[-1] - before)
        one[:] = circles[degree] if degree else 1
        if down:
            one *= chebyshev(down, along[0]).astype(np.float32)[:, None]
        if across:
            one *= chebyshev(across, along[1]).astype(np.float32)
    return out


def _tiles_of(edges, shape):
    """Return the tile of each row and each column of a frame."""
    return [
        np.clip(np.searchsorted(edge, np.arange(size), "right") - 1, 0, len(edge) - 2)
        for edge, size in zip(edges, shape, strict=True)
    ]


def _along(shape, tiles, sides):
    """Return the place of each row and of each column in its tile, -1 .. 1, float32."""
    return [
        ((np.arange(size) - at[tile]) / side[tile]).astype(np.float32)
        for size, tile, (at, side) in zip(shape, tiles, sides, strict=True)
    ]


def _spread(values, tiles):
    """Return values of the tiles (..., rows of tiles, columns) at each pixel, float32."""
    return values.astype(np.float32)[..., tiles[0], :][..., tiles[1]]


def _gains(made, confusion, middle):
    """Return the gains of coverage, see `Terms`: linear in the place and in the circle of confusion within a tile."""
    even = made.even - made.even[:, :, [made.reference]]
    slopes = made.even_slopes - made.even_slopes[..., [made.reference]]
    if max(np.abs(even).max(), np.abs(slopes).max()) <= EVEN:
        return None
    shape, sides = confusion.shape, middles_of(made.edges, confusion.shape)
    tiles = _tiles_of(made.edges, shape)
    rows, cols = _along(shape, tiles, sides)
    grid = len(even), *(len(at) for at, _ in sides)
    at = node_weights(made.nodes, np.stack([middle, middle + 0.5], axis=1))
    value, more = np.einsum("tin,ctn->ict", at, even)
    by_row, by_col = np.einsum("tn,actn->act", at[:, 0], slopes)
    away = np.clip(confusion - _spread(middle.reshape(grid[1:]), tiles), -2, 2).astype(np.float32)
    flat = 1 + _spread(value.reshape(grid), tiles)
    flat += (
        _spread(by_row.reshape(grid), tiles) * rows[:, None]
        + _spread(by_col.reshape(grid), tiles) * cols
    )
    flat += _spread(2 * (more - value).reshape(grid), tiles) * away
    return 1 / flat
