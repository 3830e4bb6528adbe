"""Places where the product of blurred layers is not enough, and the points of the pupil to sum there.

Composition multiplies means over the pupil. It is exact if at most one of the layers that meet is out of focus. Where
several are, both vary over the pupil together, and `optics.occlude` sums over its points. A bound of what the sum
changes, from the variation of coverage and light within the blurs, finds the places that need it.
"""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise, starmap

import numpy as np
import scipy

from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil
from gpusim.optics.opening import Opening

FINE = 1024  # points across the pupil, of which areas are counted
SHARP = 0.5  # [sample] radius of a blur that stays within its cell
COUNTS = (128, 256, 512, 1024, 2048)
MORE_COUNTS = (4096, 8192)  # of layers that a lens displaces, each place its own way
MOST_CELLS = 4096
MANY = 2**17  # points of the pupil whose cells are counted
USUAL = 0.999  # quantile of the light of a layer that is taken for its brightest
BLOCK = 16  # [sample] of blocks whose brightest light is taken
TOGETHER = 2**16  # places times points that are summed at once
SAMPLED = 400  # places at which errors of the sum are measured
BENT = 0.01  # [sample] by which displacements of rays may err
NODES = (
    5,
    9,
    17,
    33,
)  # of the field, along rows and columns, between which displacements are cubic
STEEP = 0.25  # change of a blur's radius from sample to sample, above which it jumps
MOST_TRIED = 0.99  # quantile of these places that stands for all
PROBED = 24  # places of the field, and
PROBES = 256  # points of the pupil, at which displacements are compared


@dataclass(frozen=True, eq=False)
class Sheet:
    """A layer in brightness.

    Attributes:
        light: Brightness times coverage, shape (rows, cols).
        alpha: Coverage, the same shape.
        radius: Radius of the blur, signed [sample], a number or the same shape.
        guessed: Share of the light that is a guess, because no picture shows it, same shape; None: none.
        usual: Usual darkest and brightest light of all that the layer shows, if these are a part of it; None: of these.
    """

    light: np.ndarray
    alpha: np.ndarray
    radius: np.ndarray
    guessed: np.ndarray | None = None
    usual: tuple[float, float] | None = None

    def at(self, rows: np.ndarray, cols: np.ndarray, flux: np.ndarray, border: str) -> "Sheet":
        """Return the layer at the place to which a lens or a view moves it.

        Args:
            rows: Row of the source of each place, shape (rows, cols).
            cols: Its column, the same shape.
            flux: Factor of its light, the same shape.
            border: "zero", "edge" or "reflect"; a coverage goes on in the dark.
        """
        mode = "reflect" if border == "reflect" else "nearest"
        find = partial(scipy.ndimage.map_coordinates, coordinates=(rows, cols), mode=mode)
        light = find(np.asarray(self.light, np.float64), order=1) * flux
        if border == "zero":
            (high, wide), edge = self.light.shape, 0.5
            light = light * (
                (rows > -edge) & (rows < high - edge) & (cols > -edge) & (cols < wide - edge)
            )
        radius, alpha = (np.asarray(one, np.float64) for one in (self.radius, self.alpha))
        return Sheet(
            light,
            find(alpha, order=1) if np.ptp(alpha) else np.full(rows.shape, alpha[0, 0]),
            find(radius, order=0) if radius.ndim else radius,
            None if self.guessed is None else find(self.guessed.astype(np.float64), order=0) > 0.5,
            self.usual and (self.usual[0] * flux.min(), self.usual[1] * flux.max()),
        )


@dataclass(frozen=True, eq=False)
class Bending:
    """Displacements of rays by the aberrations of a lens, as sums of few terms.

    A ray through the point u of the pupil meets the image at -2 lambda N grad W(u) from its ideal place. So a place
    of the image sees through u what lies as far on the other side.

    Attributes:
        optics: The lens.
        pitch: Distance of the samples [m].
        axis: Row and column at which the optical axis meets the frame [sample].
        corner: Distance of field height 1 from there [sample].
        box: Rows and columns between which places may lie, (least, greatest).
    """

    optics: Optics
    pitch: float
    axis: tuple[float, float]
    corner: float
    box: tuple[tuple[int, int], tuple[int, int]]

    @cached_property
    def _made(self):
        """Nodes along rows and columns, weights (n, n, K), wavefronts of the terms (K, i, j), error [sample]."""
        points = pupil_points(self.optics.pupil, PROBES)
        random = np.random.default_rng(0)
        low, high = np.array(self.box, float)
        tried = low + (high - low) * random.random((PROBED, 2))
        wanted = self._waves(tried)
        error = np.inf
        for count in NODES if self.is_local else (1,):
            nodes = [np.linspace(*ends, count) for ends in zip(low, high, strict=True)]
            at = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 2)
            waves = self._waves(at)
            bends = self._bends(waves, points).reshape(len(at), -1)
            own, size, _ = np.linalg.svd(bends, full_matrices=False)
            # what is left of each of them is at most the rest's
            rest = np.sqrt(np.cumsum(size[::-1] ** 2))[::-1]
            terms = max(int((rest > BENT / 4).sum()), 1)
            weights = (own * size)[:, :terms].reshape(count, count, terms)
            parts = np.tensordot(own[:, :terms] / np.maximum(size[:terms], 1e-300), waves, (0, 0))
            found = np.tensordot(self._interpolate(nodes, weights, tried), parts, (0, 0))
            error = float(np.abs(self._bends(found - wanted, points)).max(initial=0))
            if error <= BENT:
                break
        return nodes, weights, parts, error

    @property
    def error(self) -> float:
        """Largest error of displacements that was found [sample]."""
        return self._made[-1]

    @cached_property
    def reach(self) -> float:
        """Largest displacement at the nodes [sample]."""
        _, weights, parts, _ = self._made
        bends = self.of_points(pupil_points(self.optics.pupil, PROBES)).astype(np.float64)
        every = np.tensordot(weights.reshape(-1, len(parts)), bends, 1)
        return float(np.hypot(every[..., 0], every[..., 1]).max(initial=0))

    def of_places(self, places: np.ndarray) -> np.ndarray:
        """Return the weight of each term at places (E, 2) of the frame, float32 (K, E)."""
        nodes, weights, _, _ = self._made
        return self._interpolate(nodes, weights, np.asarray(places, float)).astype(np.float32)

    def slopes(self, places: np.ndarray) -> np.ndarray:
        """Return the derivatives of the weights along rows and columns at places (E, 2), float32 (K, 2, E)."""
        nodes, weights, parts, _ = self._made
        if not self.is_local:
            return np.zeros((len(parts), 2, len(places)), np.float32)
        places = np.asarray(places, float)
        along = [self._interpolate(nodes, weights, places, *step) for step in ((1, 0), (0, 1))]
        return np.stack(along, axis=1).astype(np.float32)

    def of_points(self, points: np.ndarray) -> np.ndarray:
        """Return the displacement of each term at points (M, 3) of the pupil, float32 (K, M, 2) [sample]."""
        return self._bends(self._made[2], points).astype(np.float32)

    @property
    def is_local(self) -> bool:
        """Whether they depend on the place."""
        own = self.optics.wavefront
        return bool(own.heights) or any(own.seidel[1:])

    def _waves(self, places):
        """Wavefronts at places, (n, i, j) [wave at the reference]."""
        y, x = ((np.asarray(places, float) - self.axis) / self.corner).T
        if not self.is_local:
            y, x = 0 * np.abs(y), 0 * np.abs(x)
        polynomial = self.optics.wavefront.polynomial
        return np.stack(
            [polynomial(*one) for one in zip(np.hypot(y, x), np.arctan2(y, x), strict=True)]
        )

    def _bends(self, waves, points):
        """Displacements (n, M, 2) [sample] of wavefronts (n, i, j)."""
        y, x = points[:, 0], points[:, 1]
        power = np.arange(waves.shape[1])
        down, across = (
            np.einsum("nij,mi,mj->nm", waves, xs, ys)
            for xs, ys in (
                (x[:, None] ** power, power * y[:, None] ** np.maximum(power - 1, 0)),
                (power * x[:, None] ** np.maximum(power - 1, 0), y[:, None] ** power),
            )
        )
        scale = 2e-9 * self.optics.wavefront.reference * self.optics.working_f_number / self.pitch
        return scale * np.stack([down, across], axis=-1)

    @staticmethod
    def _interpolate(nodes, weights, places, dx=0, dy=0):
        """Weights (K, E) between nodes, or their derivatives."""
        if len(nodes[0]) == 1:
            return np.repeat(weights[0, 0][:, None], len(places), axis=1)
        along = []
        for axis, (at, order) in enumerate(zip(nodes, (dx, dy), strict=True)):
            spline = scipy.interpolate.make_interp_spline(at, np.eye(len(at)))
            inside = np.clip(places[:, axis], at[0], at[-1])
            along.append((spline.derivative(order) if order else spline)(inside))
        rows, count = along[0] @ weights.reshape(len(nodes[0]), -1), weights.shape[2]
        rows = rows.reshape(len(places), -1, count)
        return np.einsum("pn,pnk->kp", along[1], rows, optimize=True)


@dataclass(frozen=True, eq=False)
class Displaced:
    """Layers before a lens or a view displaces them, and the places from which their light comes.

    Attributes:
        sheets: The layers at their own places.
        begin: Row and column of their first sample in the scene.
        rows: Row in the sheets of the source of each place of a box of the frame, shape (rows, cols).
        cols: Its column, the same shape.
        flux: Factor of its light, the same shape.
    """

    sheets: Sequence[Sheet]
    begin: tuple[int, int]
    rows: np.ndarray
    cols: np.ndarray
    flux: np.ndarray

    def maps(self, at: np.ndarray, apart: np.ndarray | int = 0) -> np.ndarray:
        """Return inputs of `optics.occlude` at places (E, 2) of the box, in the sheets, float32 (9, E).

        apart: derivatives are of places so far away (rows, cols) [sample].
        """
        beside = np.clip(at + apart, 0, np.array(self.rows.shape) - 1)
        parts = [
            [one[tuple(at.T)], *_slopes(one, beside)] for one in (self.rows, self.cols, self.flux)
        ]
        (down, across, flux), slopes = zip(*[(one[0], one[1:]) for one in parts], strict=True)
        found = [down - at[:, 0], across - at[:, 1], *slopes[0], *slopes[1], flux, *slopes[2]]
        return np.stack(found).astype(np.float32)

    def in_frame(self, at: np.ndarray, begin: tuple[int, int]) -> np.ndarray:
        """Return the same in the scene. begin: row and column of the box's first place in the frame."""
        found = self.maps(at)
        found[:2] += (np.array(self.begin) - begin)[:, None]
        return found


def _slopes(values, at):
    """Return the derivatives of values along rows and columns, at places (E, 2)."""
    found = []
    for axis, size in enumerate(values.shape):
        ends = []
        for step in (1, -1):
            place = at.copy()
            place[:, axis] = np.clip(at[:, axis] + step, 0, size - 1)
            ends.append((values[tuple(place.T)], place[:, axis]))
        (high, last), (low, first) = ends
        found.append((high - low) / np.maximum(last - first, 1))
    return found


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Inputs of `optics.occlude` that do not depend on channels.

    Attributes:
        places: Row and column of each place, margin included, int32 (E, 2).
        members: Layers that take part, int32 (n, E).
        radii: Radii of their blurs [sample], float32 (n, E).
        points: y, x and share of points of the pupil, float32 (M, 3).
        weights: Weight of each term of the rays' displacements at each place, float32 (K, E).
        bends: Displacement by each term at each point, (rows, cols) [sample], float32 (K, M, 2).
        maps: Place and flux of the displaced light at each place, and their derivatives, float32 (9, E), see
            `optics.occlude`; None: nothing is displaced.
        slopes: Derivatives of the weights and the radii, float32 (K + n, 2, E), see `optics.occlude`; None: they are 0.
        error: Bound of the changes that are not computed, and error of the sum over points where they are [brightness],
            shape (rows, cols).
        seen: Bound of what the sum changes where it is computed, scaled to the changes that were tried [brightness],
            shape (rows, cols).
        is_diffracted: Whether the blur of products by diffraction in focus is computed, too.
        sharp: Groups of layers whose blurs stay within their samples.
    """

    places: np.ndarray
    members: np.ndarray
    radii: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    bends: np.ndarray
    maps: np.ndarray | None
    slopes: np.ndarray | None
    error: np.ndarray
    seen: np.ndarray
    is_diffracted: bool = False
    sharp: tuple[int, ...] = ()

    @property
    def work(self) -> float:
        """Multiplications and additions of one channel."""
        more = self.slopes is not None
        own = (12 + 12 * (self.maps is not None) + 20 * more) * len(self.members)
        own += (4 + 8 * more) * len(self.weights)
        return float(own * len(self.places) * len(self.points))

    def within(self, margin: int, shape: tuple[int, int]) -> tuple:
        """Return places, members, radii, weights, maps and slopes in a frame of `shape`, `margin` samples inside."""
        at = self.places - margin
        some = ((at >= 0) & (at < shape)).all(axis=1)
        maps = None if self.maps is None else self.maps[:, some]
        slopes = None if self.slopes is None else self.slopes[..., some]
        every = self.members, self.radii, self.weights
        return at[some], *(one[:, some] for one in every), maps, slopes


def pupil_points(pupil: Pupil, count: int) -> np.ndarray:
    """Return `count` points that fill the opening of a pupil evenly: y, x, share of the light, shape (count, 3).

    Source: Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018): additive recurrence with the
    plastic number.
    """
    plastic = 1.32471795724474602596
    opening, total = Opening.of(pupil), 0
    wide = 4 * np.prod(opening.half)
    light = np.zeros(0)
    while np.count_nonzero(light) < count:
        total = 2 * total or int(np.ceil(1.2 * count * wide / np.pi / pupil.area)) + 64
        steps = np.outer(np.arange(1, total + 1), [1 / plastic, 1 / plastic**2])
        y, x = (2 * ((0.5 + steps) % 1) - 1).T
        y, x = opening.middle[0] + opening.half[0] * y, opening.middle[1] + opening.half[1] * x
        light = light_at(pupil, y, x)
    inside = np.flatnonzero(light)[:count]
    share = light[inside] / light[inside].sum()
    return np.stack([y[inside], x[inside], share], axis=1)


def light_at(pupil: Pupil, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the share of light that passes at points of the pupil of radius 1."""
    light = is_open(pupil, y, x).astype(np.float64)
    return light if pupil.mask is None else light * pupil.mask.light_at(y, x)


def is_open(pupil: Pupil, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return whether points of radius 1 are inside the outline of a pupil."""
    square = y * y + x * x
    found = (square <= 1) & (square >= pupil.obscuration**2)
    for side in pupil.sides:
        found &= x * np.cos(side) + y * np.sin(side) <= pupil.inner_radius
    return found


def pupil_cells(pupil: Pupil, radii: Iterable[float]) -> np.ndarray | None:
    """Return the parts of the pupil through which the same samples are seen, one point each; None if too many.

    With them the sum over the pupil is exact for samples that are even over their cells and blurs of these radii. A
    part is a rectangle between the places where a ray passes from one sample to the next.
    """
    edges = [np.array([-1.0, 1.0])]
    for radius in {abs(float(r)) for r in radii if abs(r) > 0}:
        whole = np.arange(int(np.ceil(radius + 0.5))) + 0.5
        edges += [whole / radius, -whole / radius]
    every = np.unique(np.round(np.concatenate(edges), 9))
    every = every[np.abs(every) <= 1]
    if len(every) ** 2 > 2 * MOST_CELLS:
        return None
    fine = (2 * np.arange(FINE) + 1) / FINE - 1
    first = np.unique(np.searchsorted(fine, every[:-1]))
    first = first[first < FINE]
    light = light_at(pupil, *np.broadcast_arrays(fine[:, None], fine))
    areas = np.add.reduceat(np.add.reduceat(light, first, axis=0), first, axis=1)
    middle = (fine[first] + fine[np.append(first[1:], FINE) - 1]) / 2
    y, x = np.nonzero(areas)
    if len(y) > MOST_CELLS:
        return None
    return np.stack([middle[y], middle[x], areas[y, x] / areas.sum()], axis=1)


def bent_cells(pupil: Pupil, radii: np.ndarray, bending: Bending) -> np.ndarray | None:
    """Return the parts of the pupil of an aberrated lens through which the same samples are seen; None if too many.

    The lens is the same all over the field. A part stands for all of MANY points that see the same samples, and is one
    of them.
    """
    points = pupil_points(pupil, MANY)
    weights = bending.of_places(np.zeros((1, 2)))
    bent = np.tensordot(weights[:, 0], bending.of_points(points), 1)
    key = np.zeros(MANY, np.int64)
    for radius in np.unique(radii):
        for axis in (0, 1):
            seen = np.floor(radius * points[:, axis] + bent[:, axis] + 0.5).astype(np.int64)
            _, key = np.unique(key * (np.ptp(seen) + 1) + seen - seen.min(), return_inverse=True)
    _, first, part = np.unique(key, return_index=True, return_inverse=True)
    if len(first) > MOST_CELLS:
        return None
    return np.column_stack([points[first, :2], np.bincount(part.ravel(), points[:, 2])])


def find_occlusion(
    sheets: Sequence[Sheet],
    pupil: Pupil,
    border: str,
    least: float,
    seed: int = 0,
    bending: Bending | None = None,
    begin: tuple[int, int] = (0, 0),
    displaced: "Displaced | None" = None,
) -> Occlusion:
    """Return the places of a picture that need the sum over the pupil, and its points.

    Args:
        sheets: The layers, the nearest first.
        pupil: The pupil.
        border: "zero", "edge" or "reflect".
        least: Error of the brightness that does not count.
        seed: Of the choice of the places at which errors are measured.
        bending: Displacements of rays by aberrations; None: there are none.
        begin: Row and column of the sheets' first sample in the frame.
        displaced: The layers before the lens or a view displaces them; None: nothing is displaced.
    """
    shape = sheets[0].alpha.shape
    change, taking_part = _bounds(sheets, pupil, bending.reach if bending else 0.0)
    places = np.argwhere(change > least).astype(np.int32)
    error = np.where(change > least, 0, change)
    no_weights, no_bends = np.empty((0, len(places)), np.float32), np.empty((0, 0, 2), np.float32)
    if not len(places):
        nowhere, empty = np.empty((0, 2), np.int32), np.empty((0, 0), np.int32)
        points, unbent = np.empty((0, 3), np.float32), (no_weights, no_bends)
        radii = empty.astype(np.float32)
        return Occlusion(nowhere, empty, radii, points, *unbent, None, None, error, np.zeros(shape))
    members = _members(taking_part, places)
    kinds = np.maximum(members, 0)
    radius = np.stack([np.broadcast_to(one.radius, shape) for one in sheets])
    radii = radius[kinds, places[:, 0], places[:, 1]]
    radii = np.where(members >= 0, radii, 0).astype(np.float32)
    tilts, left = _find_tilts(sheets, members, places, displaced), 0.0
    random = np.random.default_rng(seed)
    some = random.permutation(len(places))[:SAMPLED]
    tried = places[some], members[:, some], radii[:, some]
    sources = sheets if displaced is None else displaced.sheets
    light = np.stack([one.light for one in sources])[:, None]
    alpha = np.stack([one.alpha for one in sources])
    maps_at = displaced.maps if displaced else lambda at: None

    def weights_at(at):
        return bending.of_places(at + np.array(begin)) if bending else no_weights[:, : len(at)]

    def bent_at(at):
        return bending.slopes(at + np.array(begin)) if bending else tilts[:0, :, : len(at)]

    def slopes_at(at, tilts):
        found = np.concatenate([of_tried if at is tried[0] else bent_at(at), tilts])
        return found if found.any() else None

    weights_of_tried, of_tried = weights_at(tried[0]), bent_at(tried[0])

    def values(points, at=None, maps=None):
        bends = bending.of_points(points) if bending else no_bends
        maps = maps_at(tried[0]) if maps is None else maps
        slopes = slopes_at(tried[0] if at is None else at, tilts[..., some])
        inputs = (*tried[1:], weights_of_tried, maps, slopes)  # their last axis is of the places
        count = len(tried[0])

        def value(part):
            own = [one if one is None else one[..., part] for one in inputs]
            of_places = tried[0][part], *own[:2]
            return covariance(light, alpha, *of_places, points, border, own[2], bends, *own[3:])[0]

        ends = np.linspace(0, count, min(os.cpu_count() or 1, count) + 1).astype(int)
        with ThreadPoolExecutor(len(ends)) as pool:  # NumPy lets other threads run
            return np.concatenate(list(pool.map(value, starmap(slice, pairwise(ends)))))

    if tilts.any():  # where they change little, the sum is cheaper without
        few = pupil_points(pupil, COUNTS[1])
        wrong, tilted = values(few), tilts
        tilts = np.zeros_like(tilts)
        left = float(np.quantile(np.abs(values(few) - wrong), MOST_TRIED))
        if left > least:
            tilts, left = tilted, 0.0
    distinct = np.unique(radii[members >= 0])
    cells = None
    if len(distinct) <= len(sheets) and displaced is None:
        if bending is None:
            cells = pupil_cells(pupil, distinct)
        elif not bending.is_local:
            cells = bent_cells(pupil, distinct, bending)
    if cells is not None:
        points, changed, numeric = cells, values(cells), 0.0
    elif displaced is not None or slopes_at(*tried[:1], tilts[..., some]) is not None:
        points, changed, numeric = _double_points(pupil, values, 2 * least)
    else:
        points = pupil_points(pupil, COUNTS[-1])
        changed = values(points)
        # errors fall as one over the number of points or faster
        numeric = _size(values(pupil_points(pupil, COUNTS[-2])) - changed) / 2
        for count in COUNTS[:-1]:
            fewer = pupil_points(pupil, count)
            wrong = _size(values(fewer) - changed)
            if wrong <= 2 * least:
                points, numeric = fewer, wrong
                break
    weights, bends, slopes = no_weights, no_bends, slopes_at(places, tilts)
    if bending is not None:
        weights, bends = weights_at(places), bending.of_points(points)
        numeric += _bending_error(bending, values, points, changed, tried)
    maps = None
    if displaced is not None:
        maps = displaced.in_frame(places, begin)
        numeric += _linear_error(displaced, values, points, changed, tried)
    error[places[:, 0], places[:, 1]] = numeric + left
    seen = np.where(change > least, change, 0)
    bound = _size(change[tried[0][:, 0], tried[0][:, 1]])
    seen *= _size(changed) / bound
    chosen = places, members, radii, points.astype(np.float32), weights, bends, maps, slopes
    return Occlusion(*chosen, error, seen)


def _double_points(pupil, values, most):
    """Return enough points of a pupil, their values, and the error: at most `most` at nearly all places.

    Steps that are not between the same samples everywhere take many.
    """
    points, error = pupil_points(pupil, COUNTS[0]), np.inf
    found = values(points)
    for count in (*COUNTS[1:], *MORE_COUNTS):
        more = pupil_points(pupil, count)
        better = values(more)
        # errors fall as one over the number of points or faster
        error = float(np.quantile(np.abs(better - found), MOST_TRIED))
        if error <= most:
            return points, better, error
        points, found = more, better
    return points, found, error / 2


def _bending_error(bending, values, points, changed, tried):
    """Error of the displacements: between nodes, and by slopes at the place that sees.

    Slopes half the way to the place that is seen are exact but for third derivatives; the light is thinned as slopes
    there say. values: see `find_occlusion`. tried: places, members and radii.
    """
    places, reach = tried[0], np.abs(tried[2]).max(axis=0) + bending.reach
    apart = 0.0
    for step in np.eye(2) if bending.is_local else ():
        there = values(points, places + reach[:, None] * step)
        apart += np.quantile(np.abs(there - changed), MOST_TRIED) ** 2
    between = bending.error / max(bending.reach, BENT)
    return apart**0.5 + between * np.quantile(np.abs(changed), MOST_TRIED)


def _find_tilts(sheets, members, places, displaced):
    """Return the derivatives of the radii of members along rows and columns, float32 (n, 2, E); 0 where radii jump."""
    tilts = np.zeros((len(members), 2, len(places)), np.float32)
    if displaced is not None:
        sheets, maps = displaced.sheets, displaced.maps(places)
        shape = np.array(sheets[0].alpha.shape)
        at = np.clip(np.rint(places + maps[:2].T).astype(int), 0, shape - 1)
    for k, sheet in enumerate(sheets):
        radius = np.asarray(sheet.radius)
        if not radius.ndim or np.ptp(radius) == 0:
            continue
        for s, member in enumerate(members):
            its = member == k
            if displaced is None:
                found = np.stack(_slopes(radius, places[its]))
            else:
                down, across = _slopes(radius, at[its])
                yy, yx, xy, xx = maps[2:6, its]
                found = np.stack([down * yy + across * xy, down * yx + across * xx])
            tilts[s, :, its] = np.where(np.abs(found).max(axis=0) <= STEEP, found, 0).T
    return tilts


def _linear_error(displaced, values, points, changed, tried):
    """Error of places and fluxes of displaced light that are linear around a place.

    A ray from t away meets S(x) + S'(x + t / 2) t but for third derivatives: slopes half a blur away tell the error.
    """
    apart, reach = 0.0, int(np.ceil(np.abs(tried[2]).max() / 2))
    for step in np.eye(2, dtype=int):
        there = values(points, maps=displaced.maps(tried[0], reach * step))
        apart += np.quantile(np.abs(there - changed), MOST_TRIED) ** 2
    return apart**0.5


def hidden_light(sheets: Sequence[Sheet]) -> np.ndarray:
    """Return a bound of the error of surfaces that are guessed, brightness (rows, cols).

    The share of guessed light that a pixel sees, times what the light there may be instead: any
    that the layer shows elsewhere.
    """
    error, through = np.zeros(sheets[0].alpha.shape), np.ones(sheets[0].alpha.shape)
    for sheet in sheets:
        reach = int(np.ceil(np.abs(sheet.radius).max()))
        cover, share = sheet.alpha, np.zeros(sheet.alpha.shape)
        if reach:
            cover = scipy.ndimage.uniform_filter(cover, 2 * reach + 1, mode="nearest")
        if sheet.guessed is not None and sheet.guessed.any():
            shown = (sheet.alpha > 0) & ~sheet.guessed
            low, high = sheet.usual or usual_light(
                sheet.light[shown] if shown.any() else sheet.light
            )
            other = np.maximum(high - sheet.light, sheet.light - low) * sheet.alpha * sheet.guessed
            # light may come from anywhere within the blur
            share = scipy.ndimage.uniform_filter(other, 2 * reach + 1, mode="nearest")
        error = error + through * share
        through = through * (1 - cover)
    return error


def usual_light(values: np.ndarray) -> tuple[float, float]:
    """Return the darkest and the brightest of values but for a few, see USUAL."""
    low, high = np.quantile(values, [1 - USUAL, USUAL])
    return float(low), float(high)


def _size(values):
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _members(taking_part, places):
    """Layers that take part at each place in order, -1 for none: (n, E), n the most of one place."""
    there = taking_part[:, places[:, 0], places[:, 1]]
    most = int(there.sum(axis=0).max())
    order = np.argsort(~there, axis=0, kind="stable")[:most]
    return np.where(np.take_along_axis(there, order, 0), order, -1).astype(np.int32)


def _bounds(sheets, pupil, bent=0.0):
    """Bound of what the sum changes at each pixel, (rows, cols), and the layers that take part, (layers, rows, cols).

    bent: most displacement of rays by aberrations [sample], which may crowd them anywhere.

    With L the light of a layer and of all behind it, L = b + (1 - a) L', the product's error is the covariance of a
    and L' and 1 - a of the error behind. A covariance is at most the product of the standard deviations, and that of L
    at most s(b) + (1 - a) s(L') + s(a) max L'.
    """
    # the variance within a square is at least that in the pupil, times the areas' ratio
    widen = (4 / np.pi / pupil.area) ** 0.5
    error = deviation = brightest = 0.0
    taking_part, covered = [], np.zeros(sheets[0].alpha.shape, bool)
    parts = []
    for sheet in reversed(sheets):
        reach = int(np.ceil(np.abs(sheet.radius).max() + bent + 0.5))
        sharp = np.abs(sheet.radius) + bent <= SHARP
        spread = partial(_half_range, reach=reach) if bent else partial(_widen, widen, reach)
        varies = np.where(sharp, 0, spread(sheet.alpha))
        light_varies = np.where(sharp, 0, spread(sheet.light))
        clear = np.where(sharp | (varies == 0), 1 - sheet.alpha, 1)
        error = clear * error + varies * deviation
        deviation = light_varies + clear * deviation + varies * brightest
        own = np.divide(sheet.light, sheet.alpha, where=sheet.alpha > 0, out=0 * sheet.light)
        brightest = np.maximum(brightest, _brightest(own, reach))
        parts.append(((sheet.alpha > 0) | (varies > 0), clear == 0))
    for there, opaque in reversed(parts):
        taking_part.append(there & ~covered)
        covered |= opaque
    return error, np.stack(taking_part)


def _brightest(values, reach):
    """The most of the values in a square around each sample, or more: of whole blocks."""
    side = max(reach, BLOCK)
    down, across = (np.arange(0, n, side) for n in values.shape)
    most = np.maximum.reduceat(np.maximum.reduceat(values, down, axis=0), across, axis=1)
    most = scipy.ndimage.maximum_filter(most, size=3, mode="nearest")
    rows, cols = (np.arange(n) // side for n in values.shape)
    return most[np.ix_(rows, cols)]


def _widen(widen, reach, values):
    """Largest standard deviation within the pupil."""
    return widen * _deviation(values, reach)


def _half_range(values, reach):
    """Half of the range in the square of 2 reach + 1 samples: the most deviation of any rays there."""
    size = {"size": 2 * reach + 1, "mode": "nearest"}
    most = scipy.ndimage.maximum_filter(values, **size)
    return (most - scipy.ndimage.minimum_filter(values, **size)) / 2


def _deviation(values, reach):
    """Standard deviation in the square of 2 reach + 1 samples around each sample."""
    values = np.asarray(values, np.float64)
    values = values - values.mean()
    size = 2 * reach + 1
    mean = scipy.ndimage.uniform_filter(values, size, mode="nearest")
    square = scipy.ndimage.uniform_filter(values * values, size, mode="nearest")
    rounding = 1e-12 * np.square(values).max(initial=0)  # of running sums
    variance = square - mean * mean
    return np.sqrt(np.where(variance > rounding, variance, 0))


def covariance(
    lights,
    alphas,
    places,
    members,
    radii,
    points,
    border,
    weights=(),
    bends=(),
    maps=None,
    slopes=None,
):
    """Return the mean over the pupil of the light that layers let through, minus the product of means, (channels, E).

    Inputs as of `optics.occlude`. Only the choice of the sample that a point sees is made in float32, as on devices: a
    half may round either way.
    """
    lights, alphas, members = np.asarray(lights), np.asarray(alphas), np.asarray(members)
    radii, points = np.asarray(radii, np.float32), np.asarray(points, np.float32)
    weights, bends = np.asarray(weights, np.float32), np.asarray(bends, np.float32)
    moved = None if maps is None else np.asarray(maps, np.float32)[..., None]
    sloped = None if slopes is None else np.asarray(slopes, np.float32)[..., None]
    there, kinds = (members >= 0)[..., None], np.maximum(members, 0)[..., None].astype(np.int64)
    (count, _), channels, (rows, cols) = places.shape, lights.shape[1], alphas.shape[1:]
    exact = np.zeros((channels, count))
    mean_light = np.zeros((len(members), channels, count))
    mean_alpha = np.zeros((len(members), count))
    lights, alphas = lights.ravel(), alphas.ravel()
    whole, spread, one = np.zeros(count), np.float32(1), np.float32(1)
    size = max(TOGETHER // max(count, 1), 1)
    for n in range(0, len(points), size):
        some = points[n : n + size]
        v, u, share = some[:, 0], some[:, 1], some[:, 2].astype(np.float64)
        bent = np.zeros((2, count, len(some)) if len(weights) else (2, 1, 1), np.float32)
        for weight, bend in zip(weights, bends, strict=True):
            bent += weight[:, None] * bend[n : n + size].T[:, None]
        if sloped is not None:
            steep = np.zeros((2, 2, count, len(some)), np.float32)  # of rows, columns; along them
            for slope, bend in zip(sloped, bends, strict=False):
                steep += slope * bend[n : n + size].T[:, None, None]
            (yy, yx), (xy, xx) = steep
            spread = one / ((one - yy) * (one - xx) - yx * xy)
            whole += spread @ share
        through = np.ones((count, len(some)))
        for s, radius in enumerate(radii[..., None]):
            down, across = (radius * at + more for at, more in zip((v, u), bent, strict=True))
            flux = spread
            if sloped is not None:
                tilt_y, tilt_x = sloped[len(weights) + s]
                a, b = one - (yy + v * tilt_y), yx + v * tilt_x
                c, d = xy + u * tilt_y, one - (xx + u * tilt_x)
                scale = one / (a * d - b * c)
                down, across = (d * down + b * across) * scale, (c * down + a * across) * scale
            if moved is not None:
                flux = flux * (moved[6] + (moved[7] * down + moved[8] * across))
                down, across = (
                    moved[0] + (moved[2] * down + moved[3] * across),
                    moved[1] + (moved[4] * down + moved[5] * across),
                )
            down, across = (np.floor(at + np.float32(0.5)) for at in (down, across))
            y, dark_y = _sample(places[:, :1] + down, rows, border)
            x, dark_x = _sample(places[:, 1:] + across, cols, border)
            at = cols * y + x
            alpha = alphas.take(kinds[s] * (rows * cols) + at) * there[s]
            lit = there[s] & ~dark_y & ~dark_x if border == "zero" else there[s]
            for k in range(channels):
                light = lights.take((kinds[s] * channels + k) * (rows * cols) + at) * (flux * lit)
                exact[k] += (through * light) @ share
                mean_light[s, k] += light @ share
            through *= 1.0 - alpha
            mean_alpha[s] += (alpha * spread) @ share
    if sloped is not None:
        mean_alpha /= whole
    before = np.cumprod(np.concatenate([np.ones((1, count)), 1 - mean_alpha[:-1]]), axis=0)
    return exact - (before[:, None] * mean_light).sum(axis=0)


def _sample(at, size, border):
    """Indices of samples that stand for those at `at`, and whether these are in the dark."""
    at = at.astype(np.int32)
    if border == "reflect":
        at = at % (2 * size)
        return np.where(at < size, at, 2 * size - 1 - at), np.zeros(at.shape, bool)
    inside = np.clip(at, 0, size - 1)
    return inside, (at != inside) & (border == "zero")
