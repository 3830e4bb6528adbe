"""Blur that varies over the field, as a sum of few convolutions: overlap-add of kernels, or eigen-kernels.

A lens is a function `lens(places)` that returns the kernels at `places`, (row, column) of source
pixels, shape (n, 2): float64 (n, planes, m, m), m odd. The kernels of one plane have the same sum
everywhere (one; or zero, for differences from a kernel that all places share). Both methods return
the maps, kernels and tiles of the stage `optics.field`, and their image error, which is always
computed from kernels they have not used.

The error is for the image of a natural scene, of amplitude spectrum 1/|f| and RMS contrast c over a
window of m pixels: for a difference D of kernels c / sqrt(1 + c^2) sqrt(sum |D(f)|^2 W^2 / sum
W^2), W = 1 / max(|f|, 1 / (2 m)), the sums without f = 0 (the mean is kept). It assumes that the
field varies little within one kernel: true for frames of megapixels; a frame of 270 rows has up to
four times this error if a centroid moves.

`Differences` makes such a function of a lens: its kernels minus the kernels on the axis.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.interpolation import line_weights, node_weights, spline_weights
from gpusim.optics.lengths import fft_length
from gpusim.optics.lens import NODES, Lens, Symmetry, wavelength_nodes

PERIOD = 64  # [pixel] m, the side of the window that the error is measured in, at least
CONTRAST = 0.3  # RMS over mean of a natural scene within that window: photographs have 0.2 .. 0.4
PROBES = 48  # places for the comparison of a model with the lens, and
LEAST_PROBES = 12  # in small frames
SPACING = 8  # [pixel] between places, at least
# error of the image from which on 6 wavelengths do, for kernels at several distances
COARSE = 1e-4
FEW = 6  # wavelengths between which kernels are cubic
COUNTS = (3, 5, FEW, 7, NODES)
UNEVEN = 1e-5  # of the largest value, by which a symmetric kernel on the axis may err
ROOM = 1.5  # times the error by the end of kernels that it may be
TRIED = (1.0, 0.6)  # heights over the corner's at which their error is measured
SAMPLES = (15, 25)  # of the field, for eigen-kernels: coefficients are cubic between them
MOST_TERMS = 40
# error of slopes over that of values, times the distance of places, of a cubic spline at a kink: RMS 3.4 .. 5.2
KINK = 6.0
ROUGH = 1.5  # twice as near, straight lines err a quarter in a smooth field; in a rough one more than 1 / ROUGH
# each holds the places of those before and of SAMPLES
GRIDS = ((3, 5), (8, 13), (15, 25), (29, 49), (57, 97))

Kernels = Callable[[np.ndarray], np.ndarray]
WIDEST_SHIFT = 12  # [pixel] of a wavelength's image at the frame's corner
SIZES = (15, 23, 31, 41, 51, 63, 81, 101)  # of kernels [pixel]
WIDER = ((127, 159, 201), (255, 319, 401), (511, 639, 801))  # of those that are wider


@dataclass(frozen=True, eq=False)
class FieldBlur:
    """Inputs of the stage `optics.field`, with their error and cost.

    method: "overlap-add" or "eigen-kernels". maps: makes the coefficients, when they are needed. kernels: shape
    (kernels, planes, m, m). index: kernel of each tile's terms, shape (tiles, terms). edges: the tiles' boundaries
    along rows and columns [source pixel]. error: relative RMS of a natural image, root mean square and largest over
    the probed places. convolutions: how many kernels a pixel's light goes through. cost: arithmetic of the transforms
    per plane and frame [flop]. flat: relative RMS error of flat fields, and the largest, see `FlatField`. wrong: error
    of the kernels at the worst place, shape (planes, m, m). is_rough: whether kernels between those that were analysed
    err most, so that the places of `choose` are few in a small frame.
    """

    method: str
    maps: Callable[[], np.ndarray]
    kernels: np.ndarray
    index: np.ndarray
    edges: tuple[np.ndarray, ...]
    error: tuple[float, float]
    convolutions: int
    cost: float
    flat: tuple[float, float]
    wrong: np.ndarray
    is_rough: bool = True

    @cached_property
    def coefficients(self) -> np.ndarray:
        """Weight of each term for each source pixel, float64, shape (terms, rows, cols)."""
        return self.maps()

    @property
    def stage_inputs(self) -> dict:
        """Keyword arguments of `optics.field`, as the devices want them."""
        return {
            "coefficients": self.coefficients.astype(np.float32),
            "kernels": self.kernels.astype(np.float32),
            "index": self.index.astype(np.int32),
            "edges": self.edges,
        }

    def kernels_at(self, places) -> np.ndarray:
        """Return the kernels at places of the frame, (row, column) [pixel], (n, planes, m, m)."""
        (rows, cols), tiles = places.T, len(self.edges[1]) - 1
        down, across = (
            np.searchsorted(edge, at, side="right") - 1
            for edge, at in zip(self.edges, (rows, cols), strict=True)
        )
        chosen = self.kernels[self.index[down * tiles + across]]
        return np.einsum("kn,nkpij->npij", self.coefficients[:, rows, cols], chosen, optimize=True)

    @property
    def worst_ratio(self) -> float:
        """Error of a natural image by `wrong` over that of the frame, at least 1."""
        worst = image_error(self.wrong[None], np.zeros_like(self.wrong[None]))[0]
        return max(worst / max(self.error[0], 1e-300), 1.0)

    def bytes_of_tiles(self, channels) -> int:
        """Memory of the kernels' spectra and the blurred tiles [byte]."""
        count, planes, m, _ = self.kernels.shape
        rows, cols = (fft_length(int(np.diff(edge).max()) + m - 1) for edge in self.edges)
        spectra = 8 * count * planes * rows * (cols // 2 + 1)
        return spectra + 4 * channels * len(self.index) * rows * cols

    @property
    def report(self) -> str:
        """Line of the report."""
        return (
            f"{self.method}, {self.convolutions} convolutions ({len(self.kernels)} kernels, {len(self.index)} "
            f"tiles): image error {self.error[0]:.1e} rms, {self.error[1]:.1e} at the worst place, "
            f"{self.flat[0]:.1e} in flat fields"
        )


def choose(
    lens: Kernels, shape, tolerance: float, flat: "FlatField | None" = None, groups: int = 1
) -> FieldBlur:
    """The cheaper of the two methods that keeps `tolerance` (relative RMS), or the more accurate if neither does.

    flat: what flat fields look like, and how wrong that may be; None: that does not count. groups: equal parts of the
    planes, see `image_error`.
    """
    probes = _probes(shape)
    truth = _kernels(lens, probes)

    def missed(blur):
        return max(blur.error[0] / tolerance, blur.flat[0] / flat.tolerance if flat else 0.0)

    known = {"truth": (probes, truth), "flat": flat, "groups": groups}
    candidates = [eigen_kernels(lens, shape, tolerance=tolerance, **known)]
    for grid in GRIDS:
        # places nearer than these add nothing that eigen-kernels of as many places lack
        if min(np.array(shape) - SPACING * (np.array(grid) - 1)) < 0:
            break
        # finer grids cost more: stop if this one costs more than one that is enough, or is enough
        if missed(candidates[0]) <= 1:
            edges, terms = _cells(_windows(shape, grid), shape, truth.shape[-1] // 2)
            if _cost(edges, truth.shape[-1] // 2, terms) > candidates[0].cost:
                break
        blur = overlap_add(lens, shape, grid, **known)
        candidates.append(blur)
        if missed(blur) <= 1:
            break
        if grid >= SAMPLES and _is_rough(lens, shape, grid, probes, truth):
            break
    good = [blur for blur in candidates if missed(blur) <= 1]
    return min(good, key=lambda blur: blur.cost) if good else min(candidates, key=missed)


def _is_rough(lens, shape, grid, probes, truth) -> bool:
    """Return whether most of the error lies at one place at which twice as many kernels along both axes err as well.

    So it is where a wavefront has a kink, for example on the axis of one that turns with the field's angle. Kernels
    are mixed by straight lines here.
    """

    def error(counts, some):
        wrong = -truth[some]
        axes = [_Window(size, count, "bilinear") for size, count in zip(shape, counts, strict=True)]
        (down, v), (across, u) = (one.at(probes[some][:, axis]) for axis, one in enumerate(axes))
        for i in range(2):
            for j in range(2):
                places = np.stack([axes[0].nodes[down + i], axes[1].nodes[across + j]], axis=1)
                wrong += (v[:, i] * u[:, j])[:, None, None, None] * _kernels(lens, places)
        return np.square(weigh(wrong)).sum(axis=(1, 2, 3))

    errors = error(grid, slice(None))
    worst = int(np.argmax(errors))
    if errors[worst] < errors.sum() / 2:
        return False
    nearer = error([2 * count - 1 for count in grid], slice(worst, worst + 1))
    return bool(ROUGH**2 * nearer[0] > errors[worst])


def overlap_add(
    lens: Kernels, shape, grid, window="quadratic", truth=None, flat=None, groups=1
) -> FieldBlur:
    """Return kernels on a grid of places, mixed for each source pixel with weights that sum to one.

    window: interpolation of kernels between the grid's places:

          "bilinear"   4 terms, the cheapest at 1e-3; but if a kernel's centre of gravity moves with the field, its
                       speed jumps from cell to cell, and a flat field has steps there: second differences of 2e-4
                       for a mild lens on 13 x 9 kernels at 1080p, 8e-4 for a strong one on 33 x 19;
          "cosine"     4 terms, sin^2 instead of a ramp: steps of 2e-5 and 2e-4, twice the error;
          "quadratic"  9 terms, B-splines through the kernels: steps below 1e-5, a seventh of the error;
          "cubic"      16 terms.

    Args:
        lens: Kernels at places.
        shape: (rows, cols) of the frame.
        grid: Kernels along the rows and columns, corner to corner, each >= 2.
        window: See above.
        truth: (places, kernels) from which the error is computed.
        flat: See `choose`.
        groups: See `choose`.

    Raises:
        BadData, OutOfRange, UnknownName: The grid or the window is none of these.

    Source:
        Hirsch et al., CVPR 2010 (efficient filter flow), for the first two.
    """
    for size, count in zip(shape, grid, strict=True):
        if not 2 <= count <= max(size, 2):
            wanted = f"2 .. {shape[0]} rows and 2 .. {shape[1]} columns"
            raise OutOfRange("field grid", f"{grid[0]} x {grid[1]}", wanted)
    axes = _windows(shape, grid, window)
    kernels = _kernels(lens, _mesh(axes[0].nodes, axes[1].nodes))
    reach = kernels.shape[-1] // 2
    through = kernels.reshape(*grid, -1)
    for axis, one in enumerate(axes):
        first = np.moveaxis(through, axis, 0)
        # a product with the inverse takes a quarter of the time of so many right-hand sides
        solved = np.linalg.inv(one.collocation) @ first.reshape(len(first), -1)
        through = np.moveaxis(solved.reshape(first.shape), 0, axis)
    kernels = through.reshape(kernels.shape)
    along_y, along_x = (one.at(np.arange(size))[1] for one, size in zip(axes, shape, strict=True))
    edges, terms = _cells(axes, shape, reach)
    tiles = [len(one.knots) - 1 for one in axes]
    corner = np.arange(tiles[0])[:, None] * grid[1] + np.arange(tiles[1])
    steps = (np.arange(along_y.shape[1])[:, None] * grid[1] + np.arange(along_x.shape[1])).ravel()
    index = (corner[..., None] + steps).reshape(-1, terms)
    probes, wanted = _truth(lens, shape, truth)
    (ty, v), (tx, u) = (one.at(probes[:, axis]) for axis, one in enumerate(axes))
    weights = np.einsum("na,nb->nab", v, u).reshape(len(probes), terms)
    mixed = np.einsum("nk,nkpij->npij", weights, kernels[index[ty * tiles[1] + tx]], optimize=True)
    wrong = 0.0, 0.0
    if flat:
        rows, cols = (one.dense(at) for one, at in zip(axes, flat.axes, strict=True))
        wrong = flat.error(kernels, _window_maps(rows, cols))
    maps = partial(_window_maps, along_y, along_x)
    error = image_error(mixed, wanted, groups)
    cost = _cost(edges, reach, terms)
    worst = _worst(mixed - wanted)
    return FieldBlur("overlap-add", maps, kernels, index, edges, error, terms, cost, wrong, worst)


def _windows(shape, grid, window="quadratic"):
    """Interpolation along rows and columns, see `overlap_add`."""
    return [_Window(size, count, window) for size, count in zip(shape, grid, strict=True)]


def _cells(axes, shape, reach):
    """Boundaries of the tiles of windows along both axes, and the number of terms of each. reach: of the kernels."""
    edges = tuple(
        np.array([-reach, *np.ceil(one.knots[1:-1]).astype(int), size + reach])
        for one, size in zip(axes, shape, strict=True)
    )
    down, across = (2 if one.cosine else one.degree + 1 for one in axes)
    return edges, down * across


def _window_maps(along_y, along_x):
    """Coefficients of every term from windows along the rows (rows, a) and the columns (cols, b)."""
    return np.einsum("ya,xb->abyx", along_y, along_x).reshape(-1, len(along_y), len(along_x))


def _eigen_maps(nodes, vectors, shape):
    """Coefficients of the mean kernel, 1, and of those that `vectors` weight at the nodes."""
    rest = interpolate(nodes, vectors, *map(np.arange, shape))
    return np.concatenate([np.ones((1, *shape)), rest])


class _Window:
    """Interpolation along one axis of `size` pixels from `count` nodes, end to end.

    nodes: places of the kernels. knots: boundaries of the cells. collocation: shape (count, count), nodes' values from
    the coefficients.
    """

    def __init__(self, size, count, window):
        degrees = {"bilinear": 1, "cosine": 1, "quadratic": 2, "cubic": 3}
        if window not in degrees:
            raise UnknownName("field window", window, degrees)
        self.cosine, self.degree = window == "cosine", min(degrees[window], count - 1)
        self.nodes = np.linspace(0, max(size - 1, 1), count)
        inner = self.nodes[1:-1]
        if self.degree == 2:
            inner = (self.nodes[1:-2] + self.nodes[2:-1]) / 2
        elif self.degree == 3:  # "not a knot": the first and last two cells are one
            inner = self.nodes[2:-2]
        self.knots = np.array([self.nodes[0], *inner, self.nodes[-1]])
        self.collocation = self._dense(*self._basis(self.nodes))

    def _basis(self, at):
        """Cell of each place, and the values of its degree + 1 B-splines, by de Boor's recurrence."""
        cell = np.clip(np.searchsorted(self.knots, at, side="right") - 1, 0, len(self.knots) - 2)
        knots, values = np.pad(self.knots, self.degree, mode="edge"), np.ones((len(at), 1))
        for degree in range(1, self.degree + 1):
            own = cell[:, None] + self.degree + np.arange(degree)
            left, right = knots[own + 1 - degree], knots[own + 1]
            share = values / (right - left)
            values = np.pad((right - at[:, None]) * share, ((0, 0), (0, 1)))
            values[:, 1:] += (at[:, None] - left) * share
        return cell, values

    def at(self, pixels):
        """Cell of each pixel, and the weights of its degree + 1 kernels, which sum to one."""
        if not self.cosine:
            return self._basis(np.clip(np.float64(pixels), self.knots[0], self.knots[-1]))
        cell = np.searchsorted(self.knots, pixels, side="right") - 1
        cell = np.clip(cell, 0, len(self.knots) - 2)
        place = np.clip((pixels - self.knots[cell]) / np.diff(self.knots)[cell], 0, 1)
        part = np.sin(np.pi / 2 * place) ** 2
        return cell, np.stack([1 - part, part], axis=1)

    def dense(self, pixels):
        """Weights of all kernels at each pixel, shape (pixels, count)."""
        return self._dense(*self.at(pixels))

    def _dense(self, cell, weights):
        out = np.zeros((len(cell), len(self.nodes)))
        np.put_along_axis(out, cell[:, None] + np.arange(weights.shape[1]), weights, axis=1)
        return out


def eigen_kernels(
    lens: Kernels,
    shape,
    terms=None,
    tolerance=1e-3,
    samples=SAMPLES,
    truth=None,
    flat=None,
    groups=1,
) -> FieldBlur:
    """Return the mean kernel and the principal differences from it, weighted for a natural scene.

    The mean has the coefficient one and the other kernels sum to zero, so no light is lost at any
    number of terms. One set of coefficients serves all planes.

    Args:
        lens: Kernels at places.
        shape: (rows, cols) of the frame.
        terms: Convolutions in all; by default the fewest that keep `tolerance`, at most
            MOST_TERMS.
        tolerance: Relative RMS error.
        samples: Places along rows and columns whose kernels are analysed.
        truth: (places, kernels) from which the error is computed.
        flat: See `choose`.
        groups: See `choose`.

    Source:
        Lauer, Proc. SPIE 4847 (2002); with the weight the truncation error is an image's error,
        not a kernel's.
    """
    nodes, places = _sample_places(shape, samples)
    kernels = _kernels(lens, places)
    mean = kernels.mean(axis=0)
    differences = kernels - mean
    spectra = weigh(differences).reshape(len(places), -1)
    squares = spectra @ spectra.T
    variances, vectors = np.linalg.eigh(squares)
    order = np.argsort(variances)[::-1][: MOST_TERMS - 1]
    # below the rounding of the Gram matrix a vector is noise, and more of them would not lower the error
    order = order[variances[order] > 1e-14 * max(variances.max(), 1e-300)]
    variances, vectors = variances[order], vectors[:, order]
    probes, wanted = _truth(lens, shape, truth)
    at_probes = interpolate(nodes, vectors, probes[:, 0], probes[:, 1], grid=False)
    # U (U^T D): sums of differences, so their sums are zero
    basis = np.tensordot(vectors, differences, (0, 0))

    def made(count):
        return mean + np.tensordot(at_probes[: count - 1], basis[: count - 1], (0, 0))

    def error(count):
        return image_error(made(count), wanted, groups)

    between = interpolate(nodes, vectors, *flat.axes) if flat else None

    def flat_error(count):
        if flat is None:
            return 0.0, 0.0
        weights = np.concatenate([np.ones((1, *between.shape[1:])), between[: count - 1]])
        return flat.error(np.concatenate([mean[None], basis[: count - 1]]), weights)

    def is_enough(count):
        is_sharp = error(count)[0] <= tolerance
        return is_sharp and (flat is None or flat_error(count)[0] <= flat.tolerance)

    most = vectors.shape[1] + 1
    if terms is None:
        low, high = 1, most  # the error falls with the number of terms
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if is_enough(middle) else (middle + 1, high)
        terms = low
    terms = min(terms, most)

    # the worst of the places, at which kernels were analysed or compared
    own = vectors[:, : terms - 1]
    left = np.maximum(np.diag(squares) - own**2 @ variances[: terms - 1], 0)
    node, at_nodes = int(np.argmax(left)), np.sqrt(left.mean() / len(mean))
    is_rough = error(terms)[0] > ROUGH * error_scale(mean.shape[-1]) * at_nodes
    rest = np.tensordot(own[node], basis[: terms - 1], 1)
    worst = _worst(np.concatenate([[rest - differences[node]], made(terms) - wanted]))
    reach = mean.shape[-1] // 2
    edges = tuple(np.array([-reach, size + reach]) for size in shape)
    maps = partial(_eigen_maps, nodes, vectors[:, : terms - 1], shape)
    return FieldBlur(
        "eigen-kernels",
        maps,
        np.concatenate([mean[None], basis[: terms - 1]]),
        np.arange(terms)[None],
        edges,
        error(terms),
        terms,
        _cost(edges, reach, terms),
        flat_error(terms),
        worst,
        bool(is_rough),
    )


def _sample_places(shape, samples=SAMPLES):
    """Places along rows and columns whose kernels are analysed, and all of them, (n, 2)."""
    nodes = [
        np.linspace(0, size - 1, min(count, size, max(size // SPACING, 5)))
        for size, count in zip(shape, samples, strict=True)
    ]
    return nodes, _mesh(*nodes)


def _mesh(rows, cols):
    """All pairs of rows and columns, (n, 2)."""
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)


class FlatField:
    """Flat fields through a lens: the sum of its points, brighter where the lens moves points together.

    Kernels K(d; s) that sum to the same everywhere give a flat field of 1 the light sum_s K(x - s;
    s): their sum minus the divergence of their first moments, plus half of the second derivatives
    of their second moments. The error of a model follows from the error of its moments.

    Args:
        lens: See `choose`.
        shape: See `choose`.
        levels: Strength of each plane [1]; `error` is relative to 1.
        tolerance: Of the error.
    """

    def __init__(self, lens: Kernels, shape, levels, tolerance: float):
        nodes, places = _sample_places(shape)
        self.levels, self.tolerance = np.asarray(levels, np.float64), tolerance
        self.axes = [
            np.linspace(0, size - 1, min(4 * len(at), size))
            for size, at in zip(shape, nodes, strict=True)
        ]
        moments = moments_of(_kernels(lens, places))
        self.shape, self.nodes, self.at_nodes = shape, nodes, moments
        between = interpolate(nodes, moments.reshape(len(places), -1), *self.axes)
        self.moments = between.reshape(*moments.shape[1:], *map(len, self.axes))

    def error(self, kernels, coefficients) -> tuple[float, float]:
        """Relative RMS error of flat fields, and the largest, of kernels (terms, planes, m, m).

        coefficients: (terms, *axes).
        """
        moments = moments_of(kernels)
        # (planes, 5, rows, cols)
        wrong = np.tensordot(moments, coefficients, (0, 0)) - self.moments
        if min(wrong.shape[2:]) < 3:
            return 0.0, 0.0
        down, across = (
            lambda values, axis=axis: np.gradient(values, self.axes[axis], axis=axis + 1)
            for axis in (0, 1)
        )
        y, x, yy, xx, yx = wrong.swapaxes(0, 1)
        flat = down(down(yy)) / 2 + across(across(xx)) / 2 + down(across(yx)) - down(y) - across(x)
        largest = np.tensordot(self.levels**2, np.square(flat), 1).max()
        mean = self.levels**2 @ np.square(flat).mean(axis=(1, 2))
        return float(np.sqrt(mean)), float(np.sqrt(largest))

    def unseen(self, lens: Kernels) -> tuple[float, float]:
        """Relative RMS error of flat fields, and the largest, by moments that are no cubics between places.

        They have kinks, as tables of field points have.
        """
        if min(map(len, self.nodes)) < 2:
            return 0.0, 0.0
        probes = _probes(self.shape)
        moments = moments_of(_kernels(lens, probes))[..., :2]
        known = self.at_nodes[..., :2].reshape(len(self.at_nodes), -1)
        between = interpolate(self.nodes, known, probes[:, 0], probes[:, 1], grid=False).T
        steps = np.array([at[1] - at[0] for at in self.nodes])
        wrong = KINK / steps * (moments - between.reshape(moments.shape))
        squares = np.square(wrong).sum(axis=2) @ self.levels**2
        return float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))


def moments_of(kernels):
    """First and second moments (y, x, y y, x x, y x) of kernels (n, planes, m, m) [pixel], shape (n, planes, 5)."""
    at = np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2.0
    y, x = np.meshgrid(at, at, indexing="ij")
    weights = np.stack([y, x, y**2, x**2, y * x])
    return np.tensordot(kernels, weights, ((2, 3), (1, 2)))


def image_error(kernels, wanted, groups: int = 1) -> tuple[float, float]:
    """Return the relative RMS error of a natural image blurred with `kernels` instead of `wanted`.

    Both have the shape (n, planes, m, m). Returns the root mean square over the n places, and the
    largest of them; planes have equal weights. groups: equal parts of the planes, of which the
    worst at each place counts.
    """
    wrong = np.square(weigh(kernels - wanted)).sum(axis=(2, 3))
    wrong = wrong.reshape(len(wrong), groups, -1).mean(axis=2).max(axis=1)
    scale = error_scale(kernels.shape[-1])
    return float(scale * np.sqrt(wrong.mean())), float(scale * np.sqrt(wrong.max()))


def with_more_probes(blur: FieldBlur, lens: Kernels, shape) -> FieldBlur:
    """Return the same blur with its error at PROBES places, if it has another one at fewer."""
    if not blur.is_rough or len(_probes(shape)) >= PROBES:
        return blur
    places = np.unique(spread_places(shape, PROBES), axis=0)
    wrong = blur.kernels_at(places) - _kernels(lens, places)
    error = np.maximum(image_error(wrong, np.zeros_like(wrong)), blur.error)
    worst = _worst(np.concatenate([wrong, blur.wrong[None]]))
    return replace(blur, error=tuple(error.tolist()), wrong=worst)


def _worst(kernels):
    """The kernels (planes, m, m) of the place at which a natural image through them is largest; (n, planes, m, m)."""
    return kernels[np.argmax(np.square(weigh(kernels)).sum(axis=(1, 2, 3)))]


def error_scale(size: int) -> float:
    """Return the relative RMS error of a natural scene by a difference of kernels whose `weigh` has length 1."""
    # of a point: only the weight
    scene = np.square(weigh(np.ones((1, 1)), size)).sum()
    return float(CONTRAST / np.sqrt((1 + CONTRAST**2) * scene))


def natural_difference() -> float:
    """Relative root mean square difference of neighbours, over both directions, of the scene of `image_error`."""
    f = np.fft.fftfreq(PERIOD)
    weight = 1 / np.maximum(np.hypot(f[:, None], f), 0.5 / PERIOD) ** 2
    weight[0, 0] = 0
    slope = 4 * np.sin(np.pi * f) ** 2
    mean = (weight * (slope[:, None] + slope)).sum() / weight.sum()
    return float(CONTRAST / np.sqrt(1 + CONTRAST**2) * np.sqrt(mean))


def weigh(kernels, size=0):
    """Half spectra times the amplitude spectrum of scenes, as real numbers whose squares sum to the whole's energy."""
    period = max(PERIOD, size, kernels.shape[-1])
    spectra = np.fft.rfft2(kernels, (period, period))
    fy, fx = np.fft.fftfreq(period)[:, None], np.fft.rfftfreq(period)
    weight = 1 / np.maximum(np.hypot(fy, fx), 0.5 / period)
    weight[0, 0] = 0
    weight = weight * np.where((fx > 0) & (fx < 0.5), np.sqrt(2), 1.0)  # columns that stand for two
    return np.concatenate([spectra.real * weight, spectra.imag * weight], axis=-1)


def _kernels(lens, places):
    """The lens's kernels, checked."""
    kernels = np.asarray(lens(places), np.float64)
    if kernels.ndim != 4 or len(kernels) != len(places) or kernels.shape[2] != kernels.shape[3]:
        raise BadData(
            f"field kernels: wanted shape ({len(places)}, planes, m, m), got {kernels.shape}"
        )
    if kernels.shape[2] % 2 == 0:
        raise BadData(
            f"field kernels: the size {kernels.shape[2]} is even; a kernel needs a middle pixel"
        )
    sums = kernels.sum(axis=(2, 3))
    wanted = np.median(sums, axis=0)
    off = np.where(np.isfinite(sums), np.abs(sums - wanted), np.inf)
    if not off.max() <= 1e-6 * np.abs(kernels).sum(axis=(2, 3)).max():
        worst = np.unravel_index(np.argmax(off), sums.shape)
        raise BadData(
            f"field kernels: the one at pixel {tuple(np.round(places[worst[0]], 1).tolist())} sums to "
            f"{sums[worst]:.6g}, others to {wanted[worst[1]]:.6g}: the field would change flat frames"
        )
    kernels = kernels.copy()
    kernels[..., kernels.shape[2] // 2, kernels.shape[3] // 2] += wanted - sums  # rounding
    return kernels


def _truth(lens, shape, truth):
    if truth is not None:
        return truth
    probes = _probes(shape)
    return probes, _kernels(lens, probes)


def _probes(shape):
    """Pixels at which models are compared with the lens."""
    count = min(PROBES, max(LEAST_PROBES, shape[0] * shape[1] // (2 * SPACING) ** 2))
    return spread_places(shape, count)


def spread_places(shape, count: int) -> np.ndarray:
    """Return pixels spread evenly over a frame, (count, 2): the additive recurrence of the plastic number."""
    plastic = 1.324717957244746
    number = np.arange(count)
    fractions = np.stack([(0.5 + number / plastic) % 1, (0.5 + number / plastic**2) % 1], axis=1)
    return np.floor(fractions * shape).astype(int)


def interpolate(nodes, vectors, rows, cols, grid=True):
    """Columns of `vectors`, given at the nodes, as bicubic functions of place: shape (columns, ...)."""
    counts = len(nodes[0]), len(nodes[1])
    weights = line_weights if min(counts) == 1 else cubic_weights
    down, across = (
        weights(axis, np.asarray(at, np.float64)) if len(axis) > 1 else np.ones((len(at), 1))
        for axis, at in zip(nodes, (rows, cols), strict=True)
    )
    lines = down @ vectors.T.reshape(-1, *counts)
    return lines @ across.T if grid else (lines * across).sum(axis=2)


def cubic_weights(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return weights (M, L) of values at L nodes at M points, of a cubic spline; up to 4 nodes, of their polynomial."""
    return (spline_weights if len(nodes) > 4 else node_weights)(nodes, at)


def _cost(edges, reach, terms):
    """Flop of the transforms of one plane to one channel: 2.5 n log2 n for each, terms forward and one back."""
    tiles = np.prod([len(edge) - 1 for edge in edges])
    size = np.prod([float(fft_length(int(np.diff(edge).max()) + 2 * reach)) for edge in edges])
    return float(2.5 * tiles * (terms + 1) * size * np.log2(max(size, 2)))


def choose_nodes(wavelengths, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes for an error of natural scenes, and the interpolation matrix: see `wavelength_nodes`."""
    return wavelength_nodes(wavelengths, FEW if error > COARSE else NODES)


class Differences:
    """Kernels of planes minus one kernel on the axis, as a function of places; they sum to 0 at all places.

    So a point's energy is the same all over the field, and a flat field is the sum of its points:
    brighter where a lens moves them together.

    The part of a lens that reaches farthest, diffraction at its pupil's edge, is nearly the same
    all over the field. The differences end earlier than the kernels, and a convolution of the whole
    frame with the kernels on the axis gives the rest.

    Args:
        lens: The lens in front of the planes' samples.
        wavelengths: [nm], shape (L,).
        mix: Weight of each wavelength in each plane, shape (planes, L).
        shape: (rows, cols) of the planes.
        corner: Distance of the frame's corner from the middle [pixel].
        error: Relative RMS of a natural image that the end of the kernels may cost.
        distances: Of objects [m]; None: the plane in focus. The planes of each follow one another.
        reference: Distance of the kernel that is subtracted [m].

    Raises:
        OutOfRange: No size of SIZES or WIDER is enough.
    """

    def __init__(
        self, lens: Lens, wavelengths, mix, shape, corner, error, distances=(None,), reference=None
    ):
        self.lens, self.shape, self.corner = lens, shape, corner
        self.distances, self.reference = tuple(distances), reference
        self.middle = (np.array(shape) - 1) / 2 + lens.axis
        self.nodes, _ = wavelength_nodes(wavelengths)
        sizes, self._cut = zip(*(self._enough(error, one) for one in self.distances), strict=True)
        self.size, self._waves_between = max(sizes), 0.0
        count = FEW if error > COARSE else NODES
        if len(self.distances) == 1:
            count, self._waves_between = self._enough_wavelengths(wavelengths, mix, error)
        self.nodes, between = wavelength_nodes(wavelengths, count)
        self.mix = mix @ between
        self._axis = self.lens.kernels(self.nodes, (0.0, 0.0), self.size, reference)
        self._axis_moments = None  # of a lens whose kernels hold all light they do not count
        if self.lens.tail is not None:
            self._axis_moments = self.lens.moments(self.nodes, (0.0, 0.0), reference, self.size)
        # a constant Zernike term turns with the place, and has no symmetry on the axis
        self._symmetry, turned = self.lens.symmetry, [(1, -1), (-1, 1)]
        if not self._symmetry.is_mirrored:
            turned = [(-1, -1)]
        rest = max(np.abs(self._axis - self._axis[:, ::y, ::x]).max() for y, x in turned)
        if rest > UNEVEN * np.abs(self._axis).max():
            self._symmetry = Symmetry(False, False)
        self._known: dict = {}

    def __call__(self, places) -> np.ndarray:
        """Differences at `places`, (row, column) of the planes, shape (n, 2): float64 (n, planes, size, size)."""
        planes = len(self.mix) * len(self.distances)
        kernels = np.empty((len(places), planes, self.size, self.size))
        places = (np.asarray(places, np.float64) - self.middle) / self.corner
        # other quadrants are mirror images, or places on the other side of the axis are turned by half a turn
        flips = _flips(places, self._symmetry)
        own = np.round(places * flips, 9) + 0.0
        new = {place: None for place in map(tuple, own.tolist()) if place not in self._known}
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            self._known.update(zip(new, pool.map(self._at, new), strict=True))
        for kernel, place, (down, across) in zip(kernels, own.tolist(), flips, strict=True):
            kernel[:] = self._known[tuple(place)][:, ::down, ::across]
        return kernels

    def _at(self, place):
        found = []
        for distance in self.distances:
            kernels = self.lens.kernels(self.nodes, place, self.size, distance)
            differences = _with_zero_sum(kernels - self._axis)
            differences = differences + self._slope(differences, place, distance)
            found.append(np.tensordot(self.mix, differences, 1))
        return np.concatenate(found)

    def end_error(self) -> float:
        """Return the relative RMS error of a natural image by the end of the kernels, at the farthest corner.

        It includes the error between wavelengths.
        """
        corner = farthest_corner(self.shape, self.middle) / self.corner
        slopes = []
        for distance in self.distances:
            kernels = self.lens.kernels(self.nodes, corner, self.size, distance)
            slope = self._slope(_with_zero_sum(kernels - self._axis), corner, distance)
            slopes.append(np.tensordot(self.mix, np.broadcast_to(slope, kernels.shape), 1))
        every = np.concatenate(slopes)[None]
        own = np.hypot(max(self._cut), image_error(every, np.zeros_like(every))[0])
        return float(np.hypot(own, self._waves_between))

    def _slope(self, differences, place, distance):
        """Light that moves beyond differences, as a slope that gives them the first moments of all the light."""
        if self.lens.tail is None:
            return np.zeros((1, 1))  # the kernels hold all light
        wanted = self.lens.moments(self.nodes, place, distance, self.size) - self._axis_moments
        at = np.arange(self.size) - self.size // 2
        moments = [differences.sum(axis=2) @ at, differences.sum(axis=1) @ at]
        left = wanted - np.stack(moments, axis=1)
        y, x = left.T[..., None, None] / (self.size * (at @ at))
        return y * at[:, None] + x * at

    def _enough_wavelengths(self, wavelengths, mix, error):
        """Count of wavelengths between which kernels of the planes err less than ROOM * `error`, and their error.

        It is measured at the farthest corner and between there and the axis. The last of COUNTS is the truth, and errs
        a tenth of the one before.
        """
        corner = farthest_corner(self.shape, self.middle) / self.corner

        def planes_at(count):
            nodes, between = wavelength_nodes(wavelengths, count)
            axis = self.lens.kernels(nodes, (0.0, 0.0), self.size, self.reference)
            places = (tuple((part * corner).tolist()) for part in TRIED)
            kernels = (
                self.lens.kernels(nodes, one, self.size, self.distances[0]) for one in places
            )
            return np.stack(
                [np.tensordot(mix @ between, _with_zero_sum(one - axis), 1) for one in kernels]
            )

        truth = planes_at(COUNTS[-1])
        for count in COUNTS[:-1]:
            wrong = image_error(planes_at(count), truth)[1]
            if wrong <= ROOM * error:
                return count, wrong
        return COUNTS[-1], 0.0

    def _enough(self, error, distance):
        """Size of kernels beyond which the differences at the corners err less than `error`, and their error."""
        least = self.lens.least_size
        if self.lens.tail is None and distance is not None:  # the spread ends
            least = max(least, 2 * int(np.ceil(self.lens.spread(self.nodes, 0.0, distance))) + 3)
        corner = farthest_corner(self.shape, self.middle) / self.corner
        middle = [self.nodes[len(self.nodes) // 2]]
        colour = np.abs(self.lens.optics.lateral_color_at(self.nodes)).max()
        shift = colour * self.corner * np.hypot(*corner)
        if shift > WIDEST_SHIFT:  # of the farthest wavelength
            least = max(least, 2 * int(np.ceil(shift)) + SIZES[0])
        for sizes in (SIZES, *WIDER):
            most = max(sizes[-1], least | 1 if distance is not None else self.lens.least_size)
            whole = self.lens.kernels(middle, corner, most, distance)
            axis = self.lens.kernels(middle, (0.0, 0.0), most, self.reference)
            for size in sizes:
                if size >= least:
                    cut = _with_zero_sum(whole - axis)[None]
                    inner = slice(most // 2 - size // 2, most // 2 + size // 2 + 1)
                    cut[..., inner, inner] = 0
                    left = image_error(cut, np.zeros_like(cut))[0]
                    if left <= error:
                        return size, left
        raise OutOfRange(
            "field variation",
            f"kernels at the frame's corner wider than {WIDER[-1][-1]} pixels",
            "narrower ones; or a coarser pixel",
        )


def _flips(places, symmetry) -> np.ndarray:
    """Return the signs along rows and columns that move places to the ones whose kernels are computed, int (n, 2)."""
    signs = np.where(places < -1e-9, -1, 1)
    if symmetry.is_mirrored:
        return signs
    if not symmetry.is_opposite:
        return np.ones_like(signs)
    first = np.where(np.abs(places[:, 0]) > 1e-9, signs[:, 0], signs[:, 1])
    return np.repeat(first[:, None], 2, axis=1)


def farthest_corner(shape, axis) -> np.ndarray:
    """The corner of a frame of `shape` that lies farthest from `axis`, (row, column) [pixel], seen from there."""
    last = np.array(shape) - 1.0
    return np.where(axis <= last / 2, last - axis, -axis)


def _with_zero_sum(differences):
    """The same with sums of zero: light beyond the kernels, on the axis or elsewhere, is spread evenly."""
    return differences - differences.mean(axis=(1, 2), keepdims=True)
