"""Blur that follows distance and field: in each tile, powers of both times sums of eigen-kernels.

The kernels of a lens at all places and distances lie near a space of few dimensions. A `KernelSpace`
has a basis of it, and the coefficients at a grid of places and circles of confusion. A frame is cut
into tiles. In each, `expand` gives the kernel of every pixel as a sum of few terms: Chebyshev's
polynomials of the place in the tile, and of the pixel's circle of confusion among those in the tile.
A term's kernel is a sum of eigen-kernels. So the cost of a tile depends on how much its own kernels
differ. The stage `optics.field` sums all this.

The kernels are differences from one kernel, of the axis and of one distance, with sums of 0. It holds
the part that reaches far, and blurs the whole frame.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from gpusim.domain.stored import stored
from gpusim.optics.depth import stencil
from gpusim.optics.field import (
    Differences,
    error_scale,
    image_error,
    interpolate,
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
TILES_ACROSS = 12  # of the longer side, at least, if the blur varies over the field
EVEN = 1e-6  # of a flat field: gains nearer to 1 are left out
# circles of confusion at which polynomials of degree 0 are compared with the kernels; two more a degree
CHECKS = 5


@dataclass(frozen=True, eq=False)
class KernelSpace:
    """Kernels of a lens at all places of a frame and all circles of confusion, and tiles of the frame.

    Attributes:
        kernels: Eigen-kernels, sums 0, shape (K, planes, m, m).
        nodes: Circles of confusion [pixel] between which kernels are interpolated, increasing, shape (N,).
        edges: The tiles' boundaries along rows and columns, see `optics.field`.
        powers: Degrees along rows and columns of the polynomials of the place in a tile, pairs; (0, 0) is the first.
        values: Coefficients of each eigen-kernel times each of them, shape (powers, tiles, N, K).
        weights: Square of the relative RMS error of a natural scene for coefficients of 1, shape (K,).
        even: Flat fields in the planes of coverage, at one distance, shape (channels, tiles, N): in the
            middle of each tile.
        even_slopes: Their changes to a tile's sides, along rows and along columns, shape (2, channels, tiles, N).
        error: Relative RMS error of a natural scene, root mean square and largest.
        flat: Relative RMS error of flat fields.
        limit: Relative RMS error of a natural scene that `expand` may make.
        reference: Number of the node whose kernel on the axis is subtracted.
    """

    kernels: np.ndarray
    nodes: np.ndarray
    edges: tuple[np.ndarray, np.ndarray]
    powers: tuple[tuple[int, int], ...]
    values: np.ndarray
    weights: np.ndarray
    even: np.ndarray
    even_slopes: np.ndarray
    error: tuple[float, float]
    flat: float
    limit: float
    reference: int

    @property
    def report(self) -> str:
        """Line of the report."""
        m = self.kernels.shape[-1]
        return (
            f"expansions by place and distance of {len(self.kernels)} eigen-kernels of {m} x {m} samples in "
            f"{self.values.shape[1]} tiles: image error {self.error[0]:.1e} rms, {self.error[1]:.1e} at the worst "
            f"place, {self.flat:.1e} in flat fields"
        )

    @property
    def is_varying(self) -> bool:
        """Whether kernels depend on the place."""
        return len(self.powers) > 1

    @property
    def most_terms(self) -> int:
        """Most terms of `expand`."""
        return len(self.powers) * (MOST_DEGREE + 1)

    def bytes_of_tiles(self, channels: int) -> int:
        """Memory of the kernels' spectra and the blurred tiles [byte]."""
        count, planes, m, _ = self.kernels.shape
        rows, cols = (fft_length(int(np.diff(edge).max()) + m - 1) for edge in self.edges)
        return (
            8 * count * planes * rows * (cols // 2 + 1)
            + 8 * channels * self.values.shape[1] * rows * cols
        )


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the kernels in each tile: inputs of the stage `optics.field`.

    Attributes:
        coefficients: Powers of place and circle of confusion, float32, shape (terms, rows, cols).
        index: Weights of the eigen-kernels in each term, float32, shape (tiles, terms, K).
        gains: Gains by which coverage of an even surface becomes as at the reference, float32, shape (channels,
            rows, cols); None: they are 1.
    """

    coefficients: np.ndarray
    index: np.ndarray
    gains: np.ndarray | None


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
    basis, down, across, powers, values, weights, even, even_slopes, rms, most, flat = _make_arrays(
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
    return KernelSpace(
        basis,
        nodes,
        (down, across),
        tuple(map(tuple, powers.tolist())),
        values,
        weights,
        even,
        even_slopes,
        (rms, most),
        flat,
        limit / 2,
        reference,
    )


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
        error = (left, left)
        if is_uniform:
            break
        between = _at(axes, coefficients, probes).reshape(len(wanted), -1)
        more = image_error(np.tensordot(between, basis, 1), wanted)
        error = float(np.hypot(left, more[0])), float(np.hypot(left, more[1]))
        uneven = float(
            np.hypot(uneven, shading.error_between(np.tensordot(between, basis, 1), wanted))
        )
        if error[0] <= limit and uneven <= flat_limit / 2:
            break
    weights = _weights(basis)
    moments = moments_of(basis)  # (K, planes, 5)
    for degree, largest in _choices(shape, is_uniform):
        edges = _tiles(shape, m, largest)
        powers, values, rest, jumps = _in_tiles(edges, shape, axes, coefficients, circles, degree)
        left_out = float(np.sqrt((rest**2 @ weights).mean()))
        # light that moves or widens differently on both sides of an edge between tiles: a line, and two of half
        lines = 0.0
        for axis, (jump, edge) in enumerate(zip(jumps, edges, strict=True)):
            if jump.size:
                moved, widened = jump @ moments[..., axis], jump @ moments[..., 2 + axis]
                square = (moved**2 + widened**2 / 2) @ np.square(levels)
                lines += float(square.mean() / np.diff(edge).max())
        lines = float(np.sqrt(lines))
        if left_out <= limit / 2 and lines <= flat_limit / 2:
            break
    even, even_slopes = _flat_fields(
        edges, shape, axes, coefficients, moments[:, planes - covers :], circles
    )
    left = float(np.hypot(error[0], left_out)), float(np.hypot(error[1], left_out))
    flat = float(np.hypot(lines, uneven))
    return basis, *edges, np.array(powers), values, weights, even, even_slopes, *left, flat


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
    variances, vectors = np.linalg.eigh(gram)
    variances, vectors = np.maximum(variances[::-1], 0), vectors[:, ::-1]
    left = np.sqrt(np.maximum(variances.sum() - np.cumsum(variances), 0) / kernels[:, :, 0, 0].size)
    left *= error_scale(kernels.shape[-1])
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
        counts = [len(axis) for axis in self._axes]
        if max(counts) == 1:
            return 0.0
        wrong = np.tensordot(coefficients, moments_of(basis), 1) - self._moments
        wrong = wrong.reshape(*counts, -1, *wrong.shape[1:])
        total = np.zeros(wrong.shape[:-1])
        for axis, count in enumerate(counts):
            if count > 1:
                total -= np.gradient(wrong[..., axis], self._axes[axis], axis=axis)
        return float(np.sqrt(np.square(total).mean(axis=(0, 1, 2)) @ self._levels**2))

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
    if len(axes[0]) == len(axes[1]) == 1:
        return np.repeat(coefficients, len(places), axis=0)
    return interpolate(axes, coefficients, places[:, 0], places[:, 1], grid=False).T


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


def _middles(edges, shape):
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
        Their degrees, their values, see `KernelSpace`, what they leave out of the coefficients (n, K), and how these
        jump across the edges between tiles, of rows and of columns.
    """
    (y, down), (x, across) = _middles(edges, shape)
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
    powers = tuple((a, own - a) for own in range(degree + 1) for a in range(own, -1, -1))
    values = np.stack([every[a, b] for a, b in powers])

    def made(dy, dx):
        return sum(
            _power(a, dy) * _power(b, dx) * value
            for (a, b), value in zip(powers, values, strict=True)
        )

    if not degree:
        return powers, values, np.zeros((1, kernels)), (np.zeros(0), np.zeros(0))
    checks = [(dy, dx) for dy in (-1, -0.5, 0, 0.5, 1) for dx in (-1, 0, 0.5, 1)]
    rest = np.concatenate([(at(*one) - made(*one)).reshape(-1, kernels) for one in checks])
    grid = (len(y), len(x), count, kernels)
    low_y, high_y, low_x, high_x = (
        made(*one).reshape(grid) for one in ((-1, 0), (1, 0), (0, -1), (0, 1))
    )
    return powers, values, rest, (high_y[:-1] - low_y[1:], high_x[:, :-1] - low_x[:, 1:])


def chebyshev_solver(degree: int) -> np.ndarray:
    """Return the matrix from values at Chebyshev's nodes to coefficients of his polynomials."""
    at = np.arange(degree + 1)
    solve = np.cos(at[:, None] * np.pi * (at + 0.5) / (degree + 1)) * 2 / (degree + 1)
    solve[0] /= 2
    return solve


def _power(degree, at):
    """Return Chebyshev's polynomial of a degree, in a range of -1 .. 1."""
    return np.cos(degree * np.arccos(np.clip(at, -1, 1)))


def _flat_fields(edges, shape, axes, coefficients, moments, count):
    """Return flat fields in the tiles' middles, (channels, tiles, N), and their slopes: see `KernelSpace`."""
    channels, kernels = moments.shape[1], len(moments)
    (y, down), (x, across) = _middles(edges, shape)
    tiles = len(y) * len(x)
    if coefficients.shape[0] == 1:
        return np.ones((channels, tiles, count)), np.zeros((2, channels, tiles, count))
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

    return at(0, 0), np.stack([(at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2])


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
    maps = _powers(made, confusion, middle, half, terms)
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
        poly = _power(np.arange(degree + 1), checks[:, None])
        error = np.square(poly @ found[left, : degree + 1] - at @ own) @ made.weights
        wrong[left], most = error.mean(axis=1), degree
        left = left[wrong[left] > made.limit**2]
    return found[:, : most + 1], wrong


def _powers(made, confusion, middle, half, terms):
    """Return the polynomials of place and circle of confusion at each pixel, float32 (terms, rows, cols)."""
    shape, sides = confusion.shape, _middles(made.edges, confusion.shape)
    tiles = _tiles_of(made.edges, shape)
    along = [
        ((np.arange(size) - at[tile]) / side[tile]).astype(np.float32)
        for size, tile, (at, side) in zip(shape, tiles, sides, strict=True)
    ]
    grid, circles = [len(at) for at, _ in sides], []
    if any(degree for _, degree in terms):
        scale = np.divide(1, half, out=np.zeros_like(half), where=half > 0)
        at = confusion - _spread(middle.reshape(grid), tiles)
        at *= _spread(scale.reshape(grid), tiles)
        np.clip(at, -1, 1, out=at)
        circles = [None, at]
    out = np.empty((len(terms), *shape), np.float32)
    for one, (power, degree) in zip(out, terms, strict=True):
        down, across = made.powers[power]
        while len(circles) <= degree and degree:
            before = 1 if circles[-2] is None else circles[-2]
            circles.append(2 * circles[1] * circles[-1] - before)
        one[:] = circles[degree] if degree else 1
        if down:
            one *= _power(down, along[0]).astype(np.float32)[:, None]
        if across:
            one *= _power(across, along[1]).astype(np.float32)
    return out


def _tiles_of(edges, shape):
    """Return the tile of each row and each column of a frame."""
    return [
        np.clip(np.searchsorted(edge, np.arange(size), "right") - 1, 0, len(edge) - 2)
        for edge, size in zip(edges, shape, strict=True)
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
    shape, tiles = confusion.shape, _tiles_of(made.edges, confusion.shape)
    (y, down), (x, across) = _middles(made.edges, shape)
    grid = len(even), len(y), len(x)
    at = node_weights(made.nodes, np.stack([middle, middle + 0.5], axis=1))
    value, more = np.einsum("tin,ctn->ict", at, even)
    by_row, by_col = np.einsum("tn,actn->act", at[:, 0], slopes)
    rows = ((np.arange(shape[0]) - y[tiles[0]]) / down[tiles[0]])[:, None].astype(np.float32)
    cols = ((np.arange(shape[1]) - x[tiles[1]]) / across[tiles[1]]).astype(np.float32)
    away = np.clip(confusion - _spread(middle.reshape(grid[1:]), tiles), -2, 2).astype(np.float32)
    flat = 1 + _spread(value.reshape(grid), tiles)
    flat += (
        _spread(by_row.reshape(grid), tiles) * rows + _spread(by_col.reshape(grid), tiles) * cols
    )
    flat += _spread(2 * (more - value).reshape(grid), tiles) * away
    return 1 / flat
