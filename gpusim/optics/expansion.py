"""Blur that follows distance and field: in each tile, powers of both times sums of eigen-kernels.

The kernels of a lens at all places and distances lie near a space of few dimensions. A `KernelSpace` has a
basis of it, and the coefficients at a grid of places and circles of confusion. A frame is cut into
tiles. In each, `expand` gives the kernel of every pixel as a sum of few terms: of the place, to first
order from the tile's middle, and of the pixel's circle of confusion, Chebyshev's polynomials over
those that the tile has. A term's kernel is a sum of eigen-kernels. So the cost of a tile depends on
how much its kernels differ, and not on those of the frame. All of it is for the stage `optics.field`.

The kernels are differences from one kernel, of the axis and of one distance, with sums of 0. It holds the
part that reaches far, and blurs the whole frame.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from gpusim.optics.field import (
    Differences,
    error_scale,
    image_error,
    interpolate,
    moments_of,
    weigh,
)
from gpusim.optics.lengths import fft_length

GRIDS = ((5, 7), (9, 13), (15, 25))  # places along rows and columns; each holds those before
PROBES = 6  # places for the comparison with the lens
MOST_TERMS = 64
MOST_DEGREE = 12
LEAST_TILE = 16  # [pixel] a side
TILES_ACROSS = 12  # of the longer side, at least, if the blur varies over the field
EVEN = 1e-6  # of a flat field: gains nearer to 1 are left out
CHECKS = (
    5  # circles of confusion at which polynomials are compared with the kernels, for each degree
)


@dataclass(frozen=True, eq=False)
class KernelSpace:
    """Kernels of a lens at all places of a frame and all circles of confusion, and tiles of the frame.

    Attributes:
        kernels: Eigen-kernels, sums 0, shape (K, planes, m, m).
        nodes: Circles of confusion [pixel] between which kernels are interpolated, increasing, shape (N,).
        edges: The tiles' boundaries along rows and columns, see `optics.field`.
        values: Coefficients in the middle of each tile, shape (tiles, N, K).
        slopes: Their changes from a tile's middle to its sides, along rows and columns, shape (2, tiles, N, K).
        weights: Square of the relative RMS error of a natural scene for coefficients of 1, shape (K,).
        even: Flat fields in the planes of coverage, at one distance, shape (channels, tiles, N): in the
            middle of each tile.
        even_slopes: Their changes, as `slopes`, shape (2, channels, tiles, N).
        error: Relative RMS error of a natural scene, root mean square and largest.
        flat: Relative RMS error of flat fields.
        limit: Relative RMS error of a natural scene that `expand` may make.
        reference: Number of the node whose kernel on the axis is subtracted.
    """

    kernels: np.ndarray
    nodes: np.ndarray
    edges: tuple[np.ndarray, np.ndarray]
    values: np.ndarray
    slopes: np.ndarray
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
            f"{len(self.values)} tiles: image error {self.error[0]:.1e} rms, {self.error[1]:.1e} at the worst place, "
            f"{self.flat:.1e} in flat fields"
        )

    @property
    def is_varying(self) -> bool:
        """Whether kernels depend on the place."""
        return bool(self.slopes.any())

    def bytes_of_tiles(self, channels: int) -> int:
        """Memory of the kernels' spectra and the blurred tiles [byte]."""
        count, planes, m, _ = self.kernels.shape
        rows, cols = (fft_length(int(np.diff(edge).max()) + m - 1) for edge in self.edges)
        return (
            8 * count * planes * rows * (cols // 2 + 1)
            + 8 * channels * len(self.values) * rows * cols
        )


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the kernels in each tile: inputs of the stage `optics.field`.

    Attributes:
        coefficients: Powers of place and circle of confusion, float32, shape (terms, rows, cols).
        index: Weights of the eigen-kernels in each term, float32, shape (tiles, terms, K).
        gains: Gains by which coverage of an even surface remains 1, float32, shape (channels, rows, cols);
            None: they are 1.
        error: Relative RMS error of a natural scene.
    """

    coefficients: np.ndarray
    index: np.ndarray
    gains: np.ndarray | None
    error: float


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
    differences = Differences(
        lens, wavelengths, mix, shape, corner, room, tuple(distances), distances[reference]
    )
    m, planes = differences.size, len(mix)

    def kernels_at(places):
        found = differences(places)
        return found.reshape(len(places) * len(nodes), planes, m, m)

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
        basis, coefficients, left = _eigen_kernels(found, limit / 2)
        coefficients = coefficients.reshape(len(places), len(nodes) * basis.shape[0])
        error = (left, left)
        if is_uniform:
            break
        between = _at(axes, coefficients, probes).reshape(len(wanted), -1)
        more = image_error(np.tensordot(between, basis, 1), wanted)
        error = float(np.hypot(left, more[0])), float(np.hypot(left, more[1]))
        if error[0] <= limit:
            break
    weights = _weights(basis)
    moments = moments_of(basis)  # (K, planes, 5)
    largest = None if is_uniform else max(max(shape) // TILES_ACROSS, 2 * LEAST_TILE)
    while True:
        edges = _tiles(shape, m, largest)
        values, slopes, curves, jumps = _in_tiles(edges, shape, axes, coefficients, len(nodes))
        second = float(np.sqrt((curves**2 @ weights).mean()))
        # light that moves differently on both sides of an edge between tiles, a line of a pixel
        lines = sum(
            float(
                np.mean(np.square(jump @ moments[..., axis]) @ np.square(levels))
                / np.diff(edge).max()
            )
            for axis, (jump, edge) in enumerate(zip(jumps, edges, strict=True))
            if jump.size
        )
        lines = float(np.sqrt(lines))
        if (
            is_uniform
            or largest <= 2 * LEAST_TILE
            or (second <= limit / 2 and lines <= flat_limit / 2)
        ):
            break
        largest = max(int(largest / 1.5), 2 * LEAST_TILE)
    even, even_slopes = _flat_fields(
        edges, shape, axes, coefficients, moments[:, planes - covers :], len(nodes)
    )
    return KernelSpace(
        basis,
        nodes,
        edges,
        values,
        slopes,
        weights,
        even,
        even_slopes,
        (float(np.hypot(error[0], second)), float(np.hypot(error[1], second))),
        lines,
        limit / 2,
        reference,
    )


def _probes(shape):
    """Places spread evenly over the frame: the additive recurrence of the plastic number."""
    plastic = 1.324717957244746
    number = np.arange(PROBES)
    fractions = np.stack([(0.5 + number / plastic) % 1, (0.5 + number / plastic**2) % 1], axis=1)
    return np.floor(fractions * shape)


def _eigen_kernels(kernels, limit):
    """Return a basis of kernels (n, planes, m, m), the kernels' coefficients (n, K), and the error that is left."""
    gram = np.zeros((len(kernels), len(kernels)))
    for plane in range(kernels.shape[1]):
        spectra = weigh(kernels[:, plane]).reshape(len(kernels), -1)
        gram += spectra @ spectra.T
    variances, vectors = np.linalg.eigh(gram)
    variances, vectors = np.maximum(variances[::-1], 0), vectors[:, ::-1]
    left = np.sqrt(
        np.maximum(variances.sum() - np.cumsum(variances), 0) / gram.shape[0] / kernels.shape[1]
    )
    left *= error_scale(kernels.shape[-1])
    count = int(np.argmax(left <= limit)) + 1 if (left <= limit).any() else len(left)
    count = min(count, MOST_TERMS)
    vectors = vectors[:, :count]
    return np.tensordot(vectors.T, kernels, 1), vectors, float(left[count - 1])


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
        whole = size + 2 * (m // 2)
        best = None
        for count in range(1, max(whole // LEAST_TILE, 1) + 1):
            side = -(-whole // count)
            if largest is not None and side > max(largest, LEAST_TILE):
                continue
            period = fft_length(side + m - 1)
            # transforms, and the work of each tile
            cost = count * period * (np.log2(max(period, 2)) + 8)
            if best is None or cost < best[0]:
                best = cost, count
        count = best[1] if best else max(whole // LEAST_TILE, 1)
        found.append(
            np.unique(np.round(np.linspace(-(m // 2), size + m // 2, count + 1)).astype(int))
        )
    return tuple(found)


def _middles(edges, shape):
    """Middle and half side of each tile within the frame, along rows and columns: pairs of arrays."""
    found = []
    for edge, size in zip(edges, shape, strict=True):
        inner = np.clip(edge, 0, size - 1).astype(np.float64)
        inner[1:-1] -= 0.5  # sides are between pixels
        found.append(((inner[:-1] + inner[1:]) / 2, np.maximum((inner[1:] - inner[:-1]) / 2, 0.5)))
    return found


def _in_tiles(edges, shape, axes, coefficients, count):
    """Return coefficients in the tiles' middles, their slopes, what slopes leave out, and jumps between tiles."""
    (y, down), (x, across) = _middles(edges, shape)
    tiles, kernels = len(y) * len(x), coefficients.shape[1] // count

    def at(dy, dx):
        rows = np.clip(y + dy * down, 0, shape[0] - 1)
        cols = np.clip(x + dx * across, 0, shape[1] - 1)
        places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        return _at(axes, coefficients, places).reshape(tiles, count, kernels)

    middle = at(0, 0)
    if coefficients.shape[0] == 1:
        none = np.zeros((2, tiles, count, kernels))
        return middle, none, np.zeros((1, kernels)), (np.zeros(0), np.zeros(0))
    low_y, high_y, low_x, high_x = at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    slopes = np.stack([(high_y - low_y) / 2, (high_x - low_x) / 2])
    curves = np.stack(
        [
            (high_y + low_y) / 2 - middle,
            (high_x + low_x) / 2 - middle,
            at(1, 1) - middle - slopes.sum(axis=0),
        ]
    )
    curves = curves.reshape(-1, kernels) / np.sqrt(5)  # of a parabola over a tile
    grid = (len(y), len(x), count, kernels)
    value, (by_row, by_col) = middle.reshape(grid), slopes.reshape(2, *grid)
    jumps = (
        (value + by_row)[:-1] - (value - by_row)[1:],
        (value + by_col)[:, :-1] - (value - by_col)[:, 1:],
    )
    return middle, slopes, curves, jumps


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
    limit = made.limit
    spans = _spans(made.edges, confusion, cover)
    degrees, values, wrong = _polynomials(made, spans, limit)
    most, is_varying = int(degrees.max(initial=0)), made.is_varying
    low, high = spans
    is_there = np.isfinite(low)
    tiles, count = made.values.shape[0], made.values.shape[2]
    first = 3 if is_varying else 1
    cross = 2 if is_varying and most else 0
    index = np.zeros((tiles, first + cross + most, count), np.float32)
    index[:, 0] = values[:, 0]
    index[:, first : first + min(most, 1)] = values[:, 1 : 1 + min(most, 1)]
    index[:, first + min(most, 1) + cross :] = values[:, 2:]
    middle, half = np.where(is_there, (low + high) / 2, 0), np.where(is_there, (high - low) / 2, 0)
    if is_varying:
        at = _lagrange(made.nodes, np.stack([middle, middle - half, middle + half], axis=1))
        ends = np.einsum("tin,atnk->aitk", at, made.slopes)
        index[:, 1:3] = ends[:, 0].swapaxes(0, 1)
        if cross:
            across = (ends[:, 2] - ends[:, 1]).swapaxes(0, 1) / 2
            is_small = (across**2 @ made.weights).sum(axis=1) / 9 <= (limit / 4) ** 2
            wrong = wrong + np.where(is_small, (across**2 @ made.weights).sum(axis=1) / 9, 0)
            across[is_small | (degrees == 0)] = 0
            index[:, first + 1 : first + 3] = across
    index[~is_there] = 0
    used = index.any(axis=(0, 2))
    used[0] = True
    error = float(np.sqrt(wrong[is_there].mean())) if is_there.any() else 0.0
    maps = _powers(made, confusion, middle, half, most, np.flatnonzero(used))
    return Terms(maps, np.ascontiguousarray(index[:, used]), _gains(made, confusion, middle), error)


def expansion_error(made: KernelSpace, surfaces) -> float:
    """Return the relative RMS error of a natural scene by the terms of layers.

    surfaces: coverage and circles of confusion of each layer, pairs of (rows, cols).
    """
    worst = 0.0
    for cover, confusion in surfaces:
        spans = _spans(made.edges, confusion, cover)
        is_there = np.isfinite(spans[0])
        if is_there.any():
            worst = max(worst, float(_polynomials(made, spans, made.limit)[2][is_there].mean()))
    return float(np.sqrt(worst))


def _spans(edges, confusion, cover):
    """Return the smallest and the largest circle of confusion that each tile covers; infinite if there is none."""
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
    return np.array(low), np.array(high)


def _inside(edge, size):
    """Return first and last pixel of the frame, plus 1, whose light is in each tile; beyond the frame the outermost."""
    first = np.clip(edge[:-1], 0, size - 1)
    return list(zip(first, np.maximum(np.clip(edge[1:], 0, size), first + 1), strict=True))


def _lagrange(nodes, at):
    """Return weights of the nodes by which values are interpolated at any shape of points, (..., N)."""
    count = min(4, len(nodes))
    first = np.clip(np.searchsorted(nodes, at, "right") - count // 2, 0, len(nodes) - count)
    out = np.zeros((*at.shape, len(nodes)))
    for own in range(count):
        weight = np.ones(at.shape)
        for other in range(count):
            if other != own:
                apart = nodes[first + own] - nodes[first + other]
                weight = weight * (at - nodes[first + other]) / apart
        np.put_along_axis(out, (first + own)[..., None], weight[..., None], axis=-1)
    return out


def _polynomials(made, spans, limit):
    """Return each tile's degree, its values (tiles, most + 1, K) of Chebyshev's polynomials, and squares of errors.

    The degree is the lowest whose error is below the limit, as mean over the tile's span.
    """
    low, high = spans
    tiles, _, count = made.values.shape
    degrees, wrong = np.zeros(tiles, int), np.zeros(tiles)
    values = np.zeros((tiles, MOST_DEGREE + 1, count))
    left = np.flatnonzero(np.isfinite(low))
    middle, half = (low + high) / 2, (high - low) / 2
    for degree in range(MOST_DEGREE + 1):
        if not len(left):
            break
        x = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        at = _lagrange(made.nodes, middle[left, None] + half[left, None] * x)
        known = np.einsum("tin,tnk->tik", at, made.values[left])
        solve = np.cos(np.arange(degree + 1)[:, None] * np.arccos(x)) * 2 / (degree + 1)
        solve[0] /= 2
        found = np.einsum("di,tik->tdk", solve, known)
        checks = np.linspace(-1, 1, CHECKS + 2 * degree)
        at = _lagrange(made.nodes, middle[left, None] + half[left, None] * checks)
        wanted = np.einsum("tin,tnk->tik", at, made.values[left])
        poly = np.cos(np.arange(degree + 1) * np.arccos(checks)[:, None])
        error = (np.square(np.einsum("id,tdk->tik", poly, found) - wanted) @ made.weights).mean(
            axis=1
        )
        values[left, : degree + 1], degrees[left], wrong[left] = found, degree, error
        left = left[error > limit**2]
    for tile in np.flatnonzero(degrees < MOST_DEGREE):
        values[tile, degrees[tile] + 1 :] = 0
    return degrees, values[:, : degrees.max(initial=0) + 1], wrong


def _powers(made, confusion, middle, half, most, used):
    """Return the powers of place and circle of confusion at each pixel, float32 (used, rows, cols)."""
    shape = confusion.shape
    (y, down), (x, across) = _middles(made.edges, shape)
    tile_y, tile_x = (
        np.clip(np.searchsorted(edge, np.arange(size), "right") - 1, 0, len(edge) - 2)
        for edge, size in zip(made.edges, shape, strict=True)
    )
    first = 3 if made.is_varying else 1
    cross = 2 if made.is_varying and most else 0
    out = np.empty((len(used), *shape), np.float32)
    by_row = ((np.arange(shape[0]) - y[tile_y]) / down[tile_y])[:, None].astype(np.float32)
    by_col = ((np.arange(shape[1]) - x[tile_x]) / across[tile_x]).astype(np.float32)
    place, before = None, None
    if most and (used >= first).any():
        grid = len(y), len(x)
        scale = np.divide(1, half, out=np.zeros_like(half), where=half > 0).reshape(grid)
        scale = scale[tile_y].astype(np.float32)[:, tile_x]
        centre = middle.reshape(grid)[tile_y].astype(np.float32)[:, tile_x]
        place = np.clip((confusion.astype(np.float32) - centre) * scale, -1, 1)
        before = [np.ones_like(place), place]
    for one, number in zip(out, used, strict=True):
        if number == 0:
            one[:] = 1
        elif number < first:
            one[:] = by_row if number == 1 else by_col
        elif number == first:
            one[:] = place
        elif number < first + 1 + cross:
            np.multiply(place, by_row if number == first + 1 else by_col, out=one)
        else:
            degree = number - first - cross + 1
            while len(before) <= degree:
                before.append(2 * place * before[-1] - before[-2])
            one[:] = before[degree]
    return out


def _gains(made, confusion, middle):
    """Return the gains of coverage, see `Terms`: linear in the place and in the circle of confusion within a tile."""
    if np.abs(made.even - 1).max() <= EVEN:
        return None
    shape = confusion.shape
    (y, down), (x, across) = _middles(made.edges, shape)
    tile_y, tile_x = (
        np.clip(np.searchsorted(edge, np.arange(size), "right") - 1, 0, len(edge) - 2)
        for edge, size in zip(made.edges, shape, strict=True)
    )
    at = _lagrange(made.nodes, np.stack([middle, middle + 0.5], axis=1))
    value, more = np.einsum("tin,ctn->ict", at, made.even)
    slopes = np.einsum("tn,actn->act", at[:, 0], made.even_slopes)
    by_row = ((np.arange(shape[0]) - y[tile_y]) / down[tile_y])[:, None].astype(np.float32)
    by_col = ((np.arange(shape[1]) - x[tile_x]) / across[tile_x]).astype(np.float32)

    def spread(values):
        return values.reshape(-1, len(y), len(x))[:, tile_y][:, :, tile_x].astype(np.float32)

    away = np.clip(confusion - spread(middle)[0], -2, 2).astype(np.float32)
    flat = spread(value) + spread(slopes[0]) * by_row + spread(slopes[1]) * by_col
    flat += spread(2 * (more - value)) * away
    return 1 / flat
