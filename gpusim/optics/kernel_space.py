"""Kernels of a lens at all places of a frame and all distances, and how they vary within tiles.

They lie near a space of few dimensions. A `KernelSpace` has a basis of it, and coefficients in tiles of
the frame: Chebyshev's polynomials of the place, at nodes of the circle of confusion.

The kernels are differences from one kernel, of the axis and of one distance, with sums of 0. It holds
the part that reaches far, and blurs the whole frame; in large frames by tiles and a coarse grid, see
`gpusim.optics.coarse`.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import scipy

from gpusim.domain.stored import stored
from gpusim.optics.coarse import LARGE, WIDER, split_error
from gpusim.optics.field import (
    Differences,
    choose_nodes,
    cubic_weights,
    error_scale,
    image_error,
    moments_of,
    spread_places,
    weigh,
)
from gpusim.optics.lengths import fft_length

GRIDS = ((5, 7), (9, 13), (15, 25))  # places along rows and columns; each holds those before
PROBES = 4  # places for the comparison with the lens
MOST_TERMS = 64
MOST_DEGREE = 12
LEAST_TILE = 8  # [pixel] a side
WIDE_TILE = 32  # [pixel] in smaller ones, kernels cost more than polynomials of the place
NEAR_LINES = 3  # [pixel] on both sides of an edge between tiles, in which nearly all of a line lies
ALONG = np.array([-1.0, 0.0, 1.0])  # places along an edge between tiles, of half its length
COARSE_SHARE = 0.5  # of the limit: error by a coarse grid
LITTLE = 1.05  # times an error above the limit, with it
TILES_ACROSS = 12  # of the longer side, at least, if the blur varies over the field


@dataclass(frozen=True, eq=False)
class KernelSpace:
    """Kernels of a lens at all places of a frame and all circles of confusion, and tiles of the frame.

    Attributes:
        kernels: Eigen-kernels, sums 0, shape (K, planes, m, m).
        nodes: Circles of confusion [pixel] between which kernels are interpolated, increasing, shape (N,).
        edges: The tiles' boundaries along rows and columns, see `optics.field`.
        degrees: Degrees along rows and columns of the polynomials of the place in a tile, pairs; (0, 0) is the first.
        values: Coefficients of each eigen-kernel times each of them, shape (degrees, tiles, N, K).
        weights: Square of the relative RMS error of a natural scene for coefficients of 1, shape (K,).
        even: Flat fields in the planes of coverage, at one distance, shape (channels, tiles, N): in the
            middle of each tile.
        even_slopes: Their changes to a tile's sides, along rows and along columns, shape (2, channels, tiles, N).
        error: Relative RMS error of a natural scene, root mean square and largest.
        flat: Relative RMS error of flat fields, and the largest, at the places where tiles meet.
        limit: Relative RMS error of a natural scene that `expand` may make.
        reference: Number of the node whose kernel on the axis is subtracted.
        wrong: Error of the kernels at the worst place and circle of confusion, shape (planes, m, m).
        coarse: Relative RMS error of a natural scene by a coarse grid for the far part of that kernel, which `error`
            includes; None: it blurs the frame in one piece.
    """

    kernels: np.ndarray
    nodes: np.ndarray
    edges: tuple[np.ndarray, np.ndarray]
    degrees: tuple[tuple[int, int], ...]
    values: np.ndarray
    weights: np.ndarray
    even: np.ndarray
    even_slopes: np.ndarray
    error: tuple[float, float]
    flat: tuple[float, float]
    limit: float
    reference: int
    wrong: np.ndarray
    coarse: float | None = None

    @property
    def report(self) -> str:
        """Line of the report."""
        m = self.kernels.shape[-1]
        return (
            f"expansions by place and distance of {len(self.kernels)} eigen-kernels of {m} x {m} samples in "
            f"{self.values.shape[1]} tiles: image error {self.error[0]:.1e} rms, {self.error[1]:.1e} at the worst "
            f"place, {self.flat[0]:.1e} in flat fields"
        )

    @property
    def is_varying(self) -> bool:
        """Whether kernels depend on the place."""
        return len(self.degrees) > 1

    @property
    def most_terms(self) -> int:
        """Most terms of `expand`."""
        return len(self.degrees) * (MOST_DEGREE + 1)

    def bytes_of_tiles(self, channels: int) -> int:
        """Memory of the kernels' spectra and the blurred tiles [byte]."""
        count, planes, m, _ = self.kernels.shape
        rows, cols = (fft_length(int(np.diff(edge).max()) + m - 1) for edge in self.edges)
        return (
            8 * count * planes * rows * (cols // 2 + 1)
            + 8 * channels * self.values.shape[1] * rows * cols
        )


def make_space(
    lens, wavelengths, mix, shape, corner, room, limit, distances, nodes, covers, levels, flat_limit
) -> KernelSpace:
    """Return the kernels of a lens at the distances of the nodes.

    Args:
        lens: The lens in front of the planes' samples.
        wavelengths: [nm], shape (L,).
        mix: Weight of each wavelength in each plane, shape (planes, L).
        shape: (rows, cols) of the planes.
        corner: Distance of the frame's corner from the middle [pixel].
        room: Relative RMS error of a natural scene by the end of the kernels.
        limit: Relative RMS error of a natural scene.
        distances: Of the nodes [m].
        nodes: Circles of confusion [pixel].
        covers: How many planes, the last ones, are coverage.
        levels: Strength of each plane in flat fields.
        flat_limit: Relative RMS error of flat fields.

    Raises:
        OutOfRange: The kernels are too wide.
    """
    nodes = np.asarray(nodes, np.float64)
    reference = int(np.abs(nodes).argmin())
    basis, down, across, degrees, values, weights, even, even_slopes, wrong, *errors = _make_arrays(
        lens,
        np.asarray(wavelengths),
        mix,
        tuple(shape),
        corner,
        room,
        limit,
        np.asarray(distances),
        reference,
        covers,
        np.asarray(levels),
        flat_limit,
    )
    error, coarse = tuple(errors[:2]), None
    if shape[0] * shape[1] > LARGE:
        settings = lens, np.asarray(wavelengths), mix, room, distances[reference], basis.shape[-1]
        coarse = _error_of_split(*settings)
        both = tuple(float(np.hypot(one, coarse)) for one in error)
        is_good = coarse <= COARSE_SHARE * limit and both[0] <= max(limit, LITTLE * error[0])
        error, coarse = (both, coarse) if is_good else (error, None)
    return KernelSpace(
        basis,
        nodes,
        (down, across),
        tuple(map(tuple, degrees.tolist())),
        values,
        weights,
        even,
        even_slopes,
        error,
        tuple(errors[2:]),
        limit / 2,
        reference,
        wrong,
        coarse,
    )


@stored
def _error_of_split(lens, wavelengths, mix, room, distance, size):
    """Return the relative RMS error of a natural scene by a coarse grid for the far part of kernels on the axis."""
    nodes, between = choose_nodes(wavelengths, room)
    kernels = lens.kernels(nodes, (0.0, 0.0), WIDER * size + 1, distance)
    return split_error(np.tensordot(mix @ between, kernels, 1), size)


@stored
def _make_arrays(
    lens,
    wavelengths,
    mix,
    shape,
    corner,
    room,
    limit,
    distances,
    reference,
    covers,
    levels,
    flat_limit,
):
    """Return the arrays and numbers of a `KernelSpace`, see `make_space`."""
    circles = len(distances)
    differences = Differences(
        lens, wavelengths, mix, shape, corner, room, tuple(distances), distances[reference]
    )
    m, planes = differences.size, len(mix)

    def kernels_at(places):
        found = differences(places)
        return found.reshape(len(places) * circles, planes, m, m)

    is_uniform = lens.is_uniform
    probes, wanted = np.empty((0, 2)), None
    if not is_uniform:
        probes = _probes(shape)
        wanted = kernels_at(probes)
    for grid in ((1, 1),) if is_uniform else GRIDS:
        axes = [
            np.linspace(0, size - 1, min(count, size)) if count > 1 else np.array([(size - 1) / 2])
            for size, count in zip(shape, grid, strict=True)
        ]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        found = kernels_at(places)
        basis, coefficients, left = _eigen_kernels(found)
        shading = _Shading(axes, moments_of(found), levels)
        held = int(np.argmax(left <= limit / 2)) + 1 if (left <= limit / 2).any() else len(left)
        uneven = shading.error(basis[:held], coefficients[:, :held])
        while uneven > flat_limit / 2 and held < len(basis):
            held += 1 + held // 8
            uneven = shading.error(basis[:held], coefficients[:, :held])
        basis, coefficients, left = basis[:held], coefficients[:, :held], float(left[:held][-1])
        coefficients = coefficients.reshape(len(places), -1)
        error, peak = (left, left), 0.0
        if is_uniform:
            unlike = np.tensordot(coefficients.reshape(len(found), -1), basis, 1) - found
            break
        between = _at(axes, coefficients, probes).reshape(len(wanted), -1)
        unlike = np.tensordot(between, basis, 1) - wanted
        more = image_error(unlike, np.zeros_like(unlike))
        error = float(np.hypot(left, more[0])), float(np.hypot(left, more[1]))
        uneven = float(
            np.hypot(uneven, shading.error_between(np.tensordot(between, basis, 1), wanted))
        )
        peak = shading.find_largest(basis, coefficients.reshape(-1, len(basis)), probes, wanted)
        if error[0] <= limit and uneven <= flat_limit / 2:
            break
    weights = _weights(basis)
    moments = moments_of(basis)  # (K, planes, 5)
    for degree, largest in _choices(shape, is_uniform):
        edges = _tiles(shape, m, largest)
        degrees, values, rest = _in_tiles(edges, shape, axes, coefficients, circles, degree)
        wrong = rest**2 @ weights
        left_out = float(np.sqrt(wrong.mean()))
        lines, line = 0.0, 0.0
        if not is_uniform:
            lines, line = _line_errors(
                edges, shape, axes, coefficients, degrees, values, basis, levels
            )
        if left_out <= limit / 2 and lines <= flat_limit / 2:
            break
    even, even_slopes, bent = _flat_fields(
        edges, shape, axes, coefficients, moments[:, planes - covers :], circles, reference
    )
    worst = float(np.sqrt(wrong.max()))
    end = differences.end_error()
    left = tuple(
        float(np.sqrt(a**2 + b**2 + end**2)) for a, b in zip(error, (left_out, worst), strict=True)
    )
    in_tiles = np.tensordot(rest[[int(np.argmax(wrong))]], basis, 1)
    worst_kernel = _find_worst(np.concatenate([unlike, in_tiles]), left[1])
    size = float(np.linalg.norm(levels))
    flat = float(np.sqrt(lines**2 + uneven**2 + (size * bent[0]) ** 2))
    most = line + peak + size * bent[1]
    arrays = np.array(degrees), values, weights, even, even_slopes, worst_kernel
    return basis, *edges, *arrays, *left, flat, most


def _find_worst(kernels, error):
    """Return the one of several errors of kernels (n, planes, m, m) that is worst next to edges, if all err as much.

    It is scaled so that a natural scene errs by `error`, or more if it does.
    """
    own = np.array([image_error(one[None], np.zeros_like(one[None]))[0] for one in kernels])
    kernels = kernels * np.maximum(error / np.maximum(own, 1e-300), 1)[:, None, None, None]
    steps = [kernels.sum(axis=axis).cumsum(axis=-1) for axis in (2, 3)]
    sizes = np.abs(steps).max(axis=(0, 2, 3)) * (own > 1e-3 * error)  # else it is rounding
    return kernels[np.argmax(sizes)]


def _choices(shape, is_uniform):
    """Yield degrees of the place in tiles, with the largest sides of the tiles [pixel], the cheapest first."""
    if is_uniform:
        yield 0, None
        return
    largest = max(max(shape) // TILES_ACROSS, WIDE_TILE)
    sides = [largest]
    while sides[-1] > LEAST_TILE:
        sides.append(max(int(sides[-1] / 1.5), LEAST_TILE))
    for degree in (1, 2, 3):
        yield from ((degree, side) for side in sides if side >= WIDE_TILE)
    yield from ((3, side) for side in sides if side < WIDE_TILE)


def _probes(shape):
    """Places spread evenly over the frame, and near corners.

    In the middle of a grid's outermost cells splines err most.
    """
    corners = np.array([[0.5 / (rows - 1), 0.5 / (cols - 1)] for rows, cols in GRIDS])
    return np.concatenate([spread_places(shape, PROBES), np.floor(corners * shape)])


def _eigen_kernels(kernels):
    """Return a basis of kernels (n, planes, m, m), their coefficients (n, K), and errors by 1 .. K of it."""
    gram = np.zeros((len(kernels), len(kernels)))
    for plane in range(kernels.shape[1]):
        spectra = weigh(kernels[:, plane]).reshape(len(kernels), -1)
        gram += spectra @ spectra.T
    if len(kernels) <= 4 * MOST_TERMS:
        variances, vectors = np.linalg.eigh(gram)
    else:
        start = np.ones(len(kernels))  # the same each time
        from scipy.sparse.linalg import eigsh  # 50 ms

        variances, vectors = eigsh(gram, MOST_TERMS, v0=start)
    variances, vectors = np.maximum(variances[::-1], 0), vectors[:, ::-1]
    left = np.maximum(np.trace(gram) - np.cumsum(variances), 0) / kernels[:, :, 0, 0].size
    left = np.sqrt(left) * error_scale(kernels.shape[-1])
    # below the rounding of the Gram matrix a vector is noise
    most = max(int(np.count_nonzero(variances > 1e-14 * max(variances[0], 1e-300))), 1)
    most = min(most, MOST_TERMS)
    vectors, left = vectors[:, :most], left[:most]
    return np.tensordot(vectors.T, kernels, 1), vectors, left


class _Shading:
    """Errors of flat fields by kernels at the places of a grid, see `gpusim.optics.field.FlatField`.

    moments: of the right kernels, (places times N, planes, 5). levels: strength of each plane.
    """

    def __init__(self, axes, moments, levels):
        self._axes, self._moments, self._levels = axes, moments, np.asarray(levels)

    def error(self, basis, coefficients) -> float:
        """Return the relative RMS error of flat fields by a basis with coefficients."""
        if max(map(len, self._axes)) == 1:
            return 0.0
        total = self._shade(basis, coefficients)
        return float(np.sqrt(np.square(total).mean(axis=(0, 1, 2)) @ self._levels**2))

    def _shade(self, basis, coefficients):
        """Return errors of flat fields at the places, (rows, cols, N, planes)."""
        counts = [len(axis) for axis in self._axes]
        wrong = np.tensordot(coefficients, moments_of(basis), 1) - self._moments
        wrong = wrong.reshape(*counts, -1, *wrong.shape[1:])
        total = np.zeros(wrong.shape[:-1])
        for axis, count in enumerate(counts):
            if count > 1:
                total -= np.gradient(wrong[..., axis], self._axes[axis], axis=axis)
        return total

    def find_largest(self, basis, coefficients, places, wanted) -> float:
        """Return the largest relative error of flat fields, at places of the grid and between them.

        wanted: the right kernels at other places, (places times N, planes, m, m). Errors of
        interpolation change their sign from one cell of the grid to the next; those of the basis do not.
        """
        own = float(np.sqrt((np.square(self._shade(basis, coefficients)) @ self._levels**2).max()))
        grid = self._moments.reshape(np.prod([len(axis) for axis in self._axes]), -1)
        wrong = moments_of(wanted)
        wrong = _at(self._axes, grid, places).reshape(wrong.shape) - wrong
        square = 0.0
        for axis, at in enumerate(self._axes):
            if len(at) > 1:
                slope = np.pi / (at[1] - at[0]) * wrong[..., axis]
                square = square + np.square(slope) @ self._levels**2
        return own + float(np.sqrt(np.max(square)))

    def error_between(self, kernels, wanted) -> float:
        """Return the relative RMS error of flat fields by kernels between the grid's places (n, planes, m, m).

        Errors of interpolation change their sign from one cell of the grid to the next.
        """
        wrong, square = moments_of(kernels) - moments_of(wanted), 0.0
        for axis, at in enumerate(self._axes):
            if len(at) > 1:
                slope = np.pi / (at[1] - at[0]) * wrong[..., axis]
                square += np.square(slope).mean(axis=0) @ self._levels**2
        return float(np.sqrt(square))


def _weights(basis):
    """Return the squares of the relative RMS errors of a natural scene by eigen-kernels, which are orthogonal."""
    squares = np.square(weigh(basis)).sum(axis=(2, 3)).mean(axis=1)
    return error_scale(basis.shape[-1]) ** 2 * squares


def _at(axes, coefficients, places):
    """Return coefficients (grid places, n) between the places of a grid, at others (p, 2): (p, n)."""
    weights = [_spline_weights(axis, at) for axis, at in zip(axes, places.T, strict=True)]
    both = weights[0][:, :, None] * weights[1][:, None]
    return both.reshape(len(places), -1) @ coefficients


def _spline_weights(axis, at):
    """Return weights of values at nodes in their interpolating spline, cubic if there are 4, (points, nodes)."""
    if len(axis) == 1:
        return np.ones((len(at), 1))
    return cubic_weights(axis, np.asarray(at, np.float64))


def _tiles(shape, m, largest):
    """Return boundaries of tiles along rows and columns that cost least, see `optics.field`."""
    found = []
    for size in shape:
        best = None
        for count in range(1, max(size // LEAST_TILE, 1) + 1):
            edges = _edges(size, m // 2, count)
            inner = np.diff(np.clip(edges, 0, size)).max()
            if (
                largest is not None
                and inner > max(largest, LEAST_TILE)
                and count < size // LEAST_TILE
            ):
                continue
            period = fft_length(int(np.diff(edges).max()) + m - 1)
            # transforms, and the sums of kernels, which miss the caches if they are large
            cost = count * period * (np.log2(max(period, 2)) + 8 + period / 64)
            if best is None or cost < best[0]:
                best = cost, edges
        found.append(best[1])
    return tuple(found)


def _edges(size, reach, count):
    """Return boundaries of tiles of similar sides, each of which holds pixels of the frame; see `optics.field`."""
    inner = max((size + 2 * reach) / count - reach, min(4.0, size / count))
    between = (
        np.linspace(inner, size - inner, count - 1) if count > 2 else np.full(count - 1, size / 2)
    )
    return np.unique(np.round([-reach, *between, size + reach]).astype(int))


def middles_of(edges, shape):
    """Middle and half side of each tile within the frame, along rows and columns: pairs of arrays."""
    found = []
    for edge, size in zip(edges, shape, strict=True):
        inner = np.clip(edge, 0, size - 1).astype(np.float64)
        inner[1:-1] -= 0.5  # sides are between pixels
        found.append(((inner[:-1] + inner[1:]) / 2, np.maximum((inner[1:] - inner[:-1]) / 2, 0.5)))
    return found


def _in_tiles(edges, shape, axes, coefficients, count, degree):
    """Return polynomials of the place in the tiles.

    Returns:
        Their degrees, their values, see `KernelSpace`, and what they leave out of the coefficients (n, K).
    """
    (y, down), (x, across) = middles_of(edges, shape)
    tiles, kernels = len(y) * len(x), coefficients.shape[1] // count

    def at(dy, dx):
        rows = np.clip(y + dy * down, 0, shape[0] - 1)
        cols = np.clip(x + dx * across, 0, shape[1] - 1)
        places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        return _at(axes, coefficients, places).reshape(tiles, count, kernels)

    nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    known = np.stack([at(dy, dx) for dy in nodes for dx in nodes])
    known = known.reshape(degree + 1, degree + 1, *known.shape[1:])
    solve = chebyshev_solver(degree)
    every = np.einsum("ai,bj,ijtnk->abtnk", solve, solve, known)
    degrees = tuple((a, own - a) for own in range(degree + 1) for a in range(own, -1, -1))
    values = np.stack([every[a, b] for a, b in degrees])

    def made(dy, dx):
        return sum(
            chebyshev(a, dy) * chebyshev(b, dx) * value
            for (a, b), value in zip(degrees, values, strict=True)
        )

    if not degree:
        return degrees, values, np.zeros((1, kernels))
    checks = [(dy, dx) for dy in (-1, -0.5, 0, 0.5, 1) for dx in (-1, 0, 0.5, 1)]
    rest = np.concatenate([(at(*one) - made(*one)).reshape(-1, kernels) for one in checks])
    return degrees, values, rest


def _line_errors(edges, shape, axes, coefficients, degrees, values, basis, levels):
    """Return errors of flat fields by polynomials of the place in tiles: RMS of the frame, and the largest.

    Polynomials of neighbours have different values and slopes where they meet, as at the frame's edge, beyond which
    kernels stay the same: lines in flat fields. A flat field is the sum of all kernels. Next to a line the kernels
    change mainly across it, so this is a sum along the kernels' profile, at some places along the line. The lines of
    rows and of columns cross: their largest errors are added.
    """
    middles = middles_of(edges, shape)
    kernels, reach, wide = values.shape[2:], basis.shape[-1] // 2, 2 * NEAR_LINES
    values = values.reshape(len(degrees), len(edges[0]) - 1, len(edges[1]) - 1, -1)
    grid = coefficients.reshape(*map(len, axes), -1)
    squares, most = 0.0, [0.0, 0.0]
    for axis in (0, 1):
        edge, size = edges[axis], shape[axis]
        (middle, half), (other, length) = middles[axis], middles[1 - axis]
        along = (other[:, None] + length[:, None] * ALONG).ravel()
        along = np.clip(along, 0, shape[1 - axis] - 1)
        spot = np.tile(ALONG, len(other))
        between = np.tensordot(_spline_weights(axes[1 - axis], along), grid, (1, 1 - axis))
        own = np.repeat(np.moveaxis(values, 1 + axis, 1), len(ALONG), axis=2)
        profile = basis.sum(axis=3 - axis)  # (K, planes, m)
        lines = np.clip(edge, 0, size)
        for n, start in enumerate([*lines, *np.rint(middle).astype(int)]):
            # sources of the light at `wide` places
            first = start - NEAR_LINES
            places = np.clip(np.arange(first - reach, first + wide + reach), 0, size - 1)
            tile = np.clip(np.searchsorted(edge, places, side="right") - 1, 0, len(edge) - 2)
            place = (places - middle[tile]) / half[tile]
            wrong = -np.tensordot(_spline_weights(axes[axis], places), between, (1, 1))
            for degree, value in zip(degrees, own, strict=True):
                weight = chebyshev(degree[axis], place)[:, None]
                weight = weight * chebyshev(degree[1 - axis], spot)
                wrong += weight[..., None] * value[tile]
            wrong = wrong.reshape(*wrong.shape[:2], *kernels)
            inside = [k for k in range(wide) if 0 <= first + k < size]
            seen = sum(
                np.tensordot(wrong[[2 * reach - k + i for i in inside]], profile[..., k], 1)
                for k in range(2 * reach + 1)
            )
            error = np.square(seen) @ np.square(levels)  # (places, along, N)
            most[axis] = max(most[axis], float(np.sqrt(error.max())))
            mean = error.mean(axis=(1, 2))
            squares += float(mean.sum() / size if n < len(lines) else mean.mean() / len(middle))
    return float(np.sqrt(squares)), sum(most)


def chebyshev_solver(degree: int) -> np.ndarray:
    """Return the matrix from values at Chebyshev's nodes to coefficients of his polynomials."""
    at = np.arange(degree + 1)
    solve = np.cos(at[:, None] * np.pi * (at + 0.5) / (degree + 1)) * 2 / (degree + 1)
    solve[0] /= 2
    return solve


def chebyshev(degree, at):
    """Return Chebyshev's polynomial of a degree, in a range of -1 .. 1."""
    return np.cos(degree * np.arccos(np.clip(at, -1, 1)))


def _flat_fields(edges, shape, axes, coefficients, moments, count, reference):
    """Return flat fields in the tiles' middles, (channels, tiles, N), and their slopes: see `KernelSpace`.

    The last result is what these leave out of the differences from the reference: RMS, and the largest.
    """
    channels, kernels = moments.shape[1], len(moments)
    (y, down), (x, across) = middles_of(edges, shape)
    tiles = len(y) * len(x)
    if coefficients.shape[0] == 1:
        return np.ones((channels, tiles, count)), np.zeros((2, channels, tiles, count)), (0.0, 0.0)
    fine = [
        np.linspace(0, size - 1, min(4 * len(axis), size))
        for size, axis in zip(shape, axes, strict=True)
    ]
    places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1).reshape(-1, 2)
    made = _at(axes, coefficients, places).reshape(*map(len, fine), count, kernels)
    moment = np.tensordot(made, moments, 1)  # (rows, cols, N, channels, 5)

    def slope(values, axis):
        if len(fine[axis]) < 2:
            return np.zeros_like(values)
        return np.gradient(values, fine[axis], axis=axis)

    dy, dx, yy, xx, yx = np.moveaxis(moment, -1, 0)
    flat = 1 - slope(dy, 0) - slope(dx, 1)
    flat += slope(slope(yy, 0), 0) / 2 + slope(slope(xx, 1), 1) / 2 + slope(slope(yx, 1), 0)
    flat = np.moveaxis(flat, -1, 2).reshape(len(places), channels * count)
    by_place = scipy.interpolate.RegularGridInterpolator(fine, flat.reshape(*map(len, fine), -1))

    def at(dy, dx):
        rows = np.clip(y + dy * down, 0, shape[0] - 1)
        cols = np.clip(x + dx * across, 0, shape[1] - 1)
        at_places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        return by_place(at_places).T.reshape(channels, count, tiles).swapaxes(1, 2)

    even, slopes = at(0, 0), np.stack([(at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2])
    bends = []
    for dy, dx in itertools.product((-1, 0, 1), repeat=2):
        rest = at(dy, dx) - even - dy * slopes[0] - dx * slopes[1]
        bends.append(rest - rest[..., [reference]])
    return even, slopes, (float(np.sqrt(np.mean(np.square(bends)))), float(np.abs(bends).max()))
