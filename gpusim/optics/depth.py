"""From a depth map to kernels and layers: how far out of focus each pixel is, and which surface hides which.

Within a surface, each point's light is spread with the kernel of its own distance. Kernels are
computed for a few distances, spaced for a stated error of cubic interpolation between them; a
pixel's light is shared among the four nearest. This neglects that near things hide far ones: if the
circle of confusion jumps by more than about a pixel, the error is percents. Then the picture is cut
into layers, each blurred together with its coverage and laid over the farther ones (Barsky and
Kosloff, "Algorithms for Rendering Depth of Field Effects in Computer Graphics", 2008). Cuts are
placed where they remove the most predicted error.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial

import numpy as np
import scipy
from scipy.special import jv

from gpusim.domain.account import Bound
from gpusim.domain.content import Basis, Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.interpolation import stencil
from gpusim.domain.optics import Optics
from gpusim.domain.scene import Layer, Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.domain.stored import stored
from gpusim.optics.edges import MOST_LAYERS, SAMPLES, Edges, find_changes, span_of
from gpusim.optics.mixed import Mixed, find_mixed
from gpusim.optics.occlusion import SHARP, Occlusion, Sheet, usual_light

MOST_KERNELS = 64
BETWEEN = "depth, distances between displaced samples"
NODE = 1e-6  # [pixel] by which circles of confusion may miss those known
SAME = 0.02  # [pixel] between circles of confusion that count as one, for layers in focus
BINS = 4096  # of circles of confusion in a large picture
SPARSE = 8  # one row of so many tells the usual light of a layer of a large picture
TOLERANCE = 1e-4  # relative root mean square error by default


def circle_of_confusion(optics: Optics, distance, pitch: float = 1.0, wavelength: float = 550.0):
    """Signed diameter of the blur disc of a point at `distance` [m]; > 0 for points beyond the plane in focus.

    pitch: of the pixels [m], for a result in pixels; in metres without it. distance: any shape. wavelength: [nm], of
    the defocus if that depends on it. Thin lens of aperture f / N: c = (f / N) s (1 / d0 - 1 / d) for the plane d0 in
    focus, s the image distance, so c is linear in dioptres; a displaced sensor adds displacement / (N s / f).
    Source: Potmesil and Chakravarty, Computer Graphics 15 (1981).
    """
    shift = np.asarray(1 / np.asarray(distance, np.float64))
    np.subtract(1 / optics.object_distance, shift, out=shift)
    shift *= optics.displacement(1.0)
    shift += _defocus(optics, wavelength)
    shift /= optics.working_f_number * pitch
    return shift[()]


def distance_of(optics: Optics, confusion, pitch: float = 1.0, wavelength: float = 550.0):
    """Distance [m] whose `circle_of_confusion` is `confusion`; infinite or negative beyond what has an image."""
    shift = np.asarray(confusion, np.float64) * (optics.working_f_number * pitch)
    shift = shift - _defocus(optics, wavelength)
    with np.errstate(divide="ignore"):
        return 1 / (1 / optics.object_distance - shift / optics.image_distance**2)


def _defocus(optics, wavelength):
    shift = optics.defocus
    if isinstance(shift, Spectrum):
        shift = shift.at(np.array([wavelength]), outside=None)[0]
    return float(shift)


@dataclass(frozen=True, eq=False)
class DepthPlan:
    """Plan for the blur of a picture with depth.

    Attributes:
        distances: Distances at which kernels are computed [m], increasing, shape (P,).
        kernels: Their signed circles of confusion [pixel], shape (P,).
        confusion: Circle of confusion of every pixel [pixel], shape (rows, cols).
        layer: Layer of each pixel, 0 the nearest, uint8 (rows, cols).
        layers: Number of layers.
        model: The plan in words.
        predicted: Relative RMS errors, of this choice and of the alternative.
        sheets: Content, coverage and circles of confusion of each layer, if the scene has
            layers.
        groups: Number of each layer among those that are composed. Consecutive layers in focus are
            one: laid over one another before the blur.
        occlusion: Places between layers at which light is summed over the pupil; None: there are
            none.
        bounds: Errors that are located, as far as they are known without probes.
        mixed: Samples of a picture that show two layers; None: it has one layer.
    """

    distances: np.ndarray
    kernels: np.ndarray
    confusion: np.ndarray
    layer: np.ndarray
    layers: int
    model: str
    predicted: dict = field(default_factory=dict)
    sheets: tuple = ()
    groups: tuple[int, ...] = ()
    occlusion: Occlusion | None = None
    bounds: dict[str, Bound] = field(default_factory=dict)
    mixed: Mixed | None = None

    @cached_property
    def _found(self) -> dict[int, np.ndarray]:
        """Results of `_places`."""
        return {}

    @property
    def reach(self) -> float:
        """Radius of the largest circle of confusion [pixel]."""
        return float(np.abs(self.kernels).max() / 2)

    def surface(self, layer: int):
        """Return the coverage and the circles of confusion of a layer, both of shape (rows, cols).

        One picture does not show the surfaces behind a nearer layer: there the nearest pixel that
        shows nothing of a nearer layer continues. So the farthest layer covers everything; another one
        ends behind a nearer one where a farther one is closer. A layer that the scene gives is
        returned unchanged.
        """
        if self.sheets:
            return self.sheets[layer][1:]
        shown = self.shown(layer)
        if shown is None:
            return self.layer == layer, self.confusion
        return self._cover(layer), self.confusion.ravel()[shown]

    def beside(self, layer: int):
        """Return the light to take away from a layer of a picture, of samples that show other surfaces too.

        A layer's light is (1 + f) times the light of the samples `shown` minus f times the light of others.

        Returns:
            Index of the other samples, and f, float32, both (rows, cols); None: there are none.
        """
        if self.sheets:
            return None
        other, factor = self._beside(layer)
        return (other, factor) if factor.any() else None

    def _beside(self, layer):
        """Index of the sample whose light is taken away at each sample, and how often."""
        other, factor = np.zeros(self.layer.shape, int), np.zeros(self.layer.shape, np.float32)
        for at, share, _, away in self._sides(layer):
            other.flat[at] = away
            is_own = self.layer.ravel()[at] == layer
            factor.flat[at] = np.where(is_own, (1 - share) / np.maximum(share, 0.5), 0)
        return other, factor

    def _sides(self, layer):
        """Yield the mixed samples of a layer, its part of their light, and a sample of its own and of the other."""
        one, layers = self.mixed, self.layer.ravel()
        if one is None:
            return
        front = layers[one.front] == layer
        yield one.at[front], one.share[front], one.front[front], one.back[front]
        back = layers[one.back] == layer
        yield one.at[back], 1 - one.share[back], one.back[back], one.front[back]

    def _places(self, layer):
        """Index of the sample that goes on at each sample, (rows, cols): its own, or the nearest behind others."""
        if layer not in self._found:
            self._found[layer] = self._find_places(layer)
        return self._found[layer]

    def _find_places(self, layer):
        nearer = self.layer < layer
        whole = np.arange(nearer.size).reshape(nearer.shape)
        if not nearer.any():
            return whole
        hidden = nearer.copy()
        if self.mixed is not None:  # no sample that shows nearer layers too goes on
            hidden.flat[self.mixed.at[self.layer.ravel()[self.mixed.front] < layer]] = True
        box, (y, x) = _nearest_in_box(nearer if hidden.all() else hidden)
        np.copyto(whole[box], y * nearer.shape[1] + x, where=nearer[box])
        return whole

    def _cover(self, layer, box=np.s_[:, :]):
        """Part of each sample that a layer covers, (rows, cols) of a box."""
        cover = (self.layer == layer).astype(np.float32)
        if self.mixed is not None:
            front = self.layer.ravel()[self.mixed.front] == layer
            cover.flat[self.mixed.at[front]] = self.mixed.share[front]
        return cover.ravel()[self._places(layer)[box]]

    def shown(self, layer: int):
        """Index of the sample whose light and distance a layer of a picture shows, (rows, cols); None: each its own."""
        if self.mixed is None and not (self.layer < layer).any():
            return None
        shown = self._places(layer).copy()
        for at, _, own, _ in self._sides(layer):
            shown.flat[at] = np.where(self.layer.ravel()[at] == layer, at, own)
        return shown

    def edge_box(self) -> tuple[slice, slice]:
        """Return rows and columns of a box with all places at which the coverage of layers changes; empty: none."""
        rows, cols = (np.zeros(n, bool) for n in self.confusion.shape)
        for values in [alpha for _, alpha, _ in self.sheets] or [self.layer]:
            for every, some in zip((rows, cols), find_changes(values), strict=True):
                every |= some
        if not self.sheets and self.layers > 2:
            # a layer between others may end anywhere behind nearer ones
            behind = self.layer < self.layers - 2
            rows |= behind.any(axis=1)
            cols |= behind.any(axis=0)
        return span_of(rows), span_of(cols)

    def in_brightness(
        self, brightness: Callable, box: tuple[slice, slice] = np.s_[:, :]
    ) -> list[Sheet]:
        """Return the groups of layers in brightness, with radii that go on where nothing is covered.

        Args:
            brightness: Gives the brightness of a layer's content, None for the picture's, float
                (rows, cols).
            box: Rows and columns that are wanted, with all edges of layers, by default all.
        """
        found: dict[int, Sheet] = {}
        make = partial(self._in_brightness, brightness=brightness, box=box)
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets other threads run
            sheets = list(pool.map(make, range(self.layers)))
        for sheet, group in zip(sheets, self.groups, strict=True):
            if group in found:
                other = found[group]
                sheet = replace(
                    other, light=other.light + sheet.light, alpha=other.alpha + sheet.alpha
                )
            found[group] = sheet
        return list(found.values())

    def _in_brightness(self, layer, brightness, box):
        guessed = usual = None
        if self.sheets:
            content, alpha, confusion = self.sheets[layer]
            light, alpha, confusion = (one[box] for one in (brightness(content), alpha, confusion))
            light = light.astype(np.float64)
        else:
            whole, own = brightness(None), self.layer == layer
            guessed, shown = self.layer < layer, self.shown(layer)
            if shown is None:
                alpha, confusion, light = (
                    own[box],
                    self.confusion[box],
                    whole[box].astype(np.float64),
                )
            else:
                shown = shown[box]
                alpha, confusion = self._cover(layer, box), self.confusion.ravel()[shown]
                other, factor = (one[box] for one in self._beside(layer))
                light, away = (whole.ravel()[at].astype(np.float64) for at in (shown, other))
                light = (1 + factor) * light - factor * away
                if self.mixed is not None:  # or they show one surface, of a picture of points
                    back = self.layer.ravel()[self.mixed.back] == layer
                    guessed.flat[self.mixed.at[back]] = True
            guessed = guessed[box]
            if guessed.shape != own.shape and guessed.any():
                some = own[::SPARSE]
                usual = usual_light(whole[::SPARSE][some] if some.any() else whole[own])
        alpha = np.asarray(alpha, np.float64)
        if not alpha.any():
            confusion = np.zeros_like(confusion)
        elif np.ptp(confusion) > 0 and not alpha.all():
            confusion = confusion[tuple(nearest(alpha == 0))]
        return Sheet(light * alpha, alpha, confusion / 2, guessed, usual)


def nearest(missing: np.ndarray) -> np.ndarray:
    """Return rows and columns of the nearest pixel that is not missing, int (2, rows, cols)."""
    found = np.indices(missing.shape)
    if missing.any():
        box, found[:, *box] = _nearest_in_box(missing)
    return found


def _nearest_in_box(missing):
    """Return a box with all pixels that are missing, and `nearest` in it."""
    # the nearest one is within the pixels next to the box of those that are missing
    box = tuple(
        slice(max(some.start - 1, 0), some.stop + 1)
        for some in (span_of(missing.any(axis=1 - axis)) for axis in (0, 1))
    )
    found = scipy.ndimage.distance_transform_edt(
        missing[box], return_distances=False, return_indices=True
    )
    return box, found + np.array([box[0].start, box[1].start])[:, None, None]


def flatten(scene: Scene):
    """Return content and depth of the picture that a scene with layers shows.

    Light of a Basis or a Cube is mixed by the coverage. Distances, and other content, are from the layer that
    covers half of a sample. The content can be read on the host, and is then there.
    """
    content, depth = scene.content.on_host(), scene.depth
    for layer in reversed(scene.layers):
        front = np.asarray(layer.alpha) >= 0.5
        depth = np.where(front, layer.depth, depth)  # type: ignore[arg-type]  # Scene has checked
        own, alpha = layer.content.on_host(), np.asarray(layer.alpha, np.float32)
        if isinstance(content, Basis | Cube) and (front != alpha).any():
            content = content.with_planes(alpha * own.planes + (1 - alpha) * content.planes)
        else:
            content = content.behind(own, front)
    return content, depth


def plan_depth(
    optics: Optics,
    pitch: float,
    depth,
    brightness,
    tolerance: float | None = None,
    layered: bool | None = None,
    scene: Scene | None = None,
    curvature: tuple[float, float] = (0.0, 0.0),
    is_placed: bool = False,
    widest: float = np.inf,
    known: np.ndarray | None = None,
) -> DepthPlan:
    """Choose kernels and layers for one picture.

    Args:
        optics: Settings of the lens.
        pitch: Of the pixels [m].
        depth: Distance of every pixel [m], shape (rows, cols).
        brightness: The sensor's signal of every pixel without blur, any unit, same shape. Blur
            has no effect on even light.
        tolerance: Relative RMS error; kernels take a quarter of it.
        layered: Whether to use layers, instead of deciding it.
        scene: Scene with layers, see `flatten` for its depth and brightness.
        curvature: Circles of confusion that the lens adds to these over the field [pixel]: the
            smallest and the largest.
        is_placed: Whether the lens or a view displaces samples.
        widest: Largest circle of confusion for which a lens has kernels [pixel].
        known: Distances for which a lens has kernels, increasing [m]; between them cubics are right. None: any.

    Raises:
        BadData: The depth map does not fit.
        OutOfRange: A distance has no image or lies outside those known, or there are too many kernels.
    """
    depth, light = np.asarray(depth, np.float64), np.asarray(brightness)
    confusion = checked_confusion(optics, pitch, depth, light.shape)
    settings = tolerance or TOLERANCE, layered, scene, curvature, is_placed, widest, known
    with ThreadPoolExecutor(2) as pool:  # NumPy lets other threads run
        return _plan_depth(optics, pitch, light, confusion, *settings, pool)


def _plan_depth(
    optics,
    pitch,
    light,
    confusion,
    tolerance,
    layered,
    scene,
    curvature,
    is_placed,
    widest,
    known,
    pool,
):
    """Return the plan for circles of confusion (rows, cols), see `plan_depth`."""
    finding = pool.submit(Edges.of, confusion, light)
    sheets: tuple = ()
    groups: tuple[int, ...] = ()
    if scene is not None and scene.layers:
        sheets, groups = _group(_sheets(scene, optics, pitch))
    every = confusion
    if sheets:
        every = np.concatenate([its[coverage > 0] for _, coverage, its in sheets])
    low, high = float(every.min()), float(every.max())
    power, contrast = power_and_contrast(light)
    q = 550e-9 * optics.working_f_number / pitch
    circles, counts, is_distinct = _count(every, low, high)
    if known is None:
        nodes = _choose_nodes(
            *(optics, pitch, low, high, circles if is_distinct else None),
            *(contrast, tolerance / 4, q, curvature, widest),
        )
        distances = distance_of(optics, nodes, pitch)
    else:
        distances = _neighbours(known, optics, pitch, low, high)
        nodes = circle_of_confusion(optics, distances, pitch)
    if len(nodes) > MOST_KERNELS:
        raise OutOfRange(
            "depth",
            f"circles of confusion of {low:.4g} .. {high:.4g} pixels, which need {len(nodes)} "
            f"kernels for an error of {tolerance:.2g}",
            f"up to {MOST_KERNELS} kernels: a larger tolerance, a smaller aperture or less depth",
        )
    edges = finding.result()
    plain = edges.plain_error(light, power)
    span = f"circles of confusion of {low:.3g} .. {high:.3g} pixels by {len(nodes)} kernels"
    predicted = {
        "depth, kernels between those computed": float(
            contrast * _remainder(nodes, circles, q, curvature, counts) if known is None else 0
        ),
        "depth, slopes of surfaces": edges.slope_error(light, power),
    }
    if sheets:
        if inner := _inner_error(sheets, light, power):
            predicted["depth, edges inside layers"] = inner
        predicted["depth, if without layers"] = plain
        layer = np.zeros(light.shape, np.uint8)
        count = len(sheets)
        model = f"{count} layers that are given; {span}"
        if is_placed:
            errors = [_between_error(its, contrast, q, curvature) for _, _, its in sheets]
            predicted[BETWEEN] = max(errors)
        return DepthPlan(
            distances, nodes, confusion, layer, count, model, predicted, sheets, groups
        )
    cuts = edges.choose_cuts(low, high, tolerance**2 * power * light.size)
    in_layers = edges.layered_error(cuts, light, power)
    if layered is None:
        layered = plain > tolerance and in_layers < plain
    cuts = cuts if layered else np.empty(0)
    layer = np.zeros(confusion.shape, np.uint8)
    for cut in cuts:
        layer += confusion > cut
    # some may have no pixel
    present = [bool((layer == k).any()) for k in range(len(cuts) + 1)]
    count = sum(present)
    if not all(present):
        layer = (np.cumsum(present) - 1).astype(np.uint8)[layer]
    mixing = pool.submit(find_mixed, layer, confusion, light) if count > 1 else None
    if is_placed:
        predicted[BETWEEN] = _between_error(confusion, contrast, q, curvature, layer)
    if layered:
        model = f"{count} layers by depth; {span}"
        predicted["depth, in layers (hidden parts are continued)"] = in_layers
        predicted["depth, if without layers"] = plain
    else:
        model = f"by depth, without layers; {span}"
        predicted["depth, occlusion left out"] = plain
        predicted["depth, if in layers"] = in_layers
    groups = tuple(range(count))
    mixed = mixing.result() if mixing else None
    return DepthPlan(
        distances, nodes, confusion, layer, count, model, predicted, (), groups, mixed=mixed
    )


def _choose_nodes(optics, pitch, low, high, distinct, contrast, tolerance, q, curvature, widest):
    """Return circles of confusion between which kernels are interpolated: few, or those that a scene has.

    distinct: those that a scene has; None: too many.
    """
    if distinct is not None and len(distinct) <= 4:
        return distinct
    nodes = kernel_nodes(low, high, contrast, tolerance, q, curvature)
    # a node beyond the nearest or farthest object may have no image, or too wide a blur
    ends = distance_of(optics, nodes[[0, -1]], pitch)
    has_image = ends[0] > optics.focal_length and 0 < ends[1] < np.inf
    if not has_image or np.abs(nodes).max() > widest:
        nodes = np.unique(np.clip(nodes, low, high))
    return distinct if distinct is not None and len(distinct) <= len(nodes) else nodes


def _neighbours(known, optics, pitch, low, high):
    """Return the known distances from which kernels of circles of confusion are interpolated. Raises OutOfRange."""
    circles = circle_of_confusion(optics, known, pitch)
    if low < circles[0] - NODE or high > circles[-1] + NODE:
        ends = distance_of(optics, np.array([low, high]), pitch)
        raise OutOfRange(
            "depth",
            "{:.4g} .. {:.4g} m".format(*ends),
            f"{known[0]:g} .. {known[-1]:g} m, the distances of the point spreads",
        )
    first = np.searchsorted(circles, low, "right") - 2
    last = np.searchsorted(circles, high) + 2  # and one more: a stencil has two on each side
    first = max(min(first, len(known) - 4), 0)
    return known[first : max(last, first + 4)]


def power_and_contrast(light: np.ndarray) -> tuple[float, float]:
    """Return a picture's mean square, and its contrast: RMS difference of neighbours along both axes over the RMS."""
    rows, cols = light.shape
    own, sums = 0.0, [0.0, 0.0]
    size = max(SAMPLES // cols, 1)
    for begin in range(0, rows, size):
        some = light[begin : begin + size + 1].astype(np.float64)
        own += float((some[:size] ** 2).sum())
        sums[0] += float((np.diff(some, axis=0) ** 2).sum())
        sums[1] += float((np.diff(some[:size], axis=1) ** 2).sum())
    counts = (rows - 1) * cols, rows * (cols - 1)
    power = own / light.size or 1.0
    change = sum(one / max(n, 1) for one, n in zip(sums, counts, strict=True))
    return power, float(np.sqrt(change / power))


def _count(circles, low, high):
    """Return circles of confusion that stand for all, how many each stands for, and whether they are all that differ.

    low, high: the least and the greatest.
    """
    circles = circles.ravel()
    few = np.unique(circles[:: max(circles.size // SAMPLES, 1)])
    if circles.size <= SAMPLES or len(few) <= MOST_KERNELS:
        found, counts = np.unique(circles, return_counts=True)
        return found, counts, True
    step, counts = (high - low) / BINS, np.zeros(BINS + 1, int)
    for begin in range(0, circles.size, SAMPLES):
        place = (circles[begin : begin + SAMPLES] - low) / step
        counts += np.bincount(place.astype(np.int64), minlength=BINS + 1)
    some = np.flatnonzero(counts)
    return np.minimum(low + step * (some + 0.5), high), counts[some], False


def _between_error(confusion, contrast, q, curvature, layer=None):
    """Return the relative RMS error by samples between others that get the mean of their circles of confusion.

    Of two circles d apart, half of the light each, the mean errs by (d / 2)^2 / 2 times the second
    derivative. layer: samples of different layers are not mixed.
    """
    size, square, found = max(SAMPLES // confusion.shape[1], 1), 0.0, []
    for begin in range(0, len(confusion), size):
        # with the row above
        above = min(begin, 1)
        rows = slice(begin - above, begin + size)
        some, apart = confusion[rows], np.zeros_like(confusion[rows])
        for axis, inner in ((0, np.s_[1:]), (1, np.s_[:, 1:])):
            step = np.abs(np.diff(some, axis=axis))
            if layer is not None:
                step[np.diff(layer[rows], axis=axis) != 0] = 0
            np.maximum(apart[inner], step, out=apart[inner])
        many = apart > SAME
        many[:above] = False
        found.append((apart[many], some[many]))
    apart, circles = (np.concatenate(one) for one in zip(*found, strict=True))
    if not len(apart):
        return 0.0
    first, second = (_worst_at(order, circles, q, curvature) for order in (1, 2))
    wrong = apart**2 / 8 * second
    # no more than the circles differ
    wrong = np.minimum(wrong, apart / 2 * first)
    square = np.square(wrong).sum()
    return float(contrast * np.sqrt(square / confusion.size))


def _worst_at(order, circles, q, curvature):
    """Return `_worst_derivative`; of many circles the greater of those at the ends of a bin."""
    if len(circles) <= SAMPLES:
        return _worst_derivative(order, circles, q, curvature)
    low, high = circles.min(), circles.max()
    ends = np.linspace(low, high, BINS + 1)
    values = _worst_derivative(order, ends, q, curvature)
    place = (circles - low) * (BINS / max(high - low, 1e-300))
    return np.maximum(values[:-1], values[1:])[np.minimum(place.astype(np.int32), BINS - 1)]


def _sheets(scene, optics, pitch):
    """The layers that a scene gives, the background last, as `DepthPlan.sheet` returns them. Raises OutOfRange."""
    if len(scene.layers) >= MOST_LAYERS:
        raise OutOfRange("scene.layers", len(scene.layers), f"up to {MOST_LAYERS - 1}")
    shape, sheets = np.shape(scene.depth), []
    behind = Layer(scene.content, np.ones(shape, np.float32), scene.depth)
    for layer in (*scene.layers, behind):
        depth = np.broadcast_to(layer.depth, shape).astype(np.float64)
        confusion = checked_confusion(optics, pitch, depth, shape)
        sheets.append((layer.content, np.asarray(layer.alpha), confusion))
    return tuple(sheets)


def _inner_error(sheets, light, power):
    """Relative error of the edges inside the layers that are given, which are not cut; by the light of the picture."""
    square = 0.0
    for _, alpha, confusion in sheets:
        covered = np.asarray(alpha) > 0
        if covered.any() and np.ptp(confusion[covered]) > 0:
            own = confusion if covered.all() else confusion[tuple(nearest(~covered))]
            square += Edges.of(own, light).plain_error(light, power) ** 2
    return float(np.sqrt(square))


def _group(sheets):
    """Return layers whose coverage is that which nearer ones of their group leave, and the number of each one's group.

    Blurs that stay within a sample are alike: laid over one another first, the layers hide each
    other to the sample.
    """
    found, groups, through = [], [], 1.0
    for content, alpha, confusion in sheets:
        together = (
            found
            and np.abs(confusion - found[-1][2]).max() <= SAME
            and np.abs(confusion).max() <= 2 * SHARP
        )
        groups.append(groups[-1] + (not together) if groups else 0)
        through = through if together else 1.0
        found.append((content, np.asarray(alpha * through, np.float32), confusion))
        through = through * (1 - alpha)
    return tuple(found), tuple(groups)


def checked_confusion(optics: Optics, pitch: float, depth, shape) -> np.ndarray:
    """Circle of confusion of every pixel [pixel], of a depth map that has been checked. Raises BadData, OutOfRange."""
    if depth.shape != tuple(shape):
        raise BadData(f"depth {depth.shape} does not match the scene {tuple(shape)}")
    if not np.isfinite(depth).all():
        raise BadData(
            f"depth: {np.count_nonzero(~np.isfinite(depth))} values are NaN or infinite; "
            "give the sky a large distance, such as 1e6 m"
        )
    if not depth.min() > optics.focal_length:
        raise OutOfRange(
            "depth",
            f"{depth.min():.4g} m",
            f"more than the focal length ({optics.focal_length:.4g} m): "
            "nearer points have no image",
        )
    return circle_of_confusion(optics, depth, pitch)


def kernel_nodes(
    low: float,
    high: float,
    contrast: float,
    tolerance: float,
    q: float = 1.0,
    curvature: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Return circles of confusion [pixel] between which interpolation of kernels keeps `tolerance`.

    The distance of kernels follows the fourth root of the fourth derivative; one kernel is enough
    if the first derivative is small. Nodes are from a grid that starts at 0, and a step of the grid
    is a power of 2^(1/2): scenes of one camera share most of their kernels. The first and the last
    lie beyond the range, or at its ends.

    Args:
        low: Smallest circle of confusion [pixel].
        high: Largest circle of confusion [pixel].
        contrast: RMS difference of neighbouring pixels over the RMS of the picture.
        tolerance: Relative RMS error.
        q: Wavelength times f-number over pitch.
        curvature: See `plan_depth`.
    """
    grid = np.linspace(low, high, 16 * int(np.ceil(high - low)) + 17)
    one = grid[len(grid) // 2 : len(grid) // 2 + 1]
    if contrast * _remainder(one, grid, q, curvature) <= tolerance:
        return one
    step, scale = 0.125, _node_scale(q, tuple(curvature))
    at = [np.sign(end) * np.interp(abs(end), *scale) for end in (low, high)]
    most = at[1] - at[0]
    while step < most / 2:
        step *= np.sqrt(2)
    while True:
        first, last = int(np.floor(at[0] / step)), int(np.ceil(at[1] / step))
        last = max(last, first + 3)
        places = step * np.arange(first, last + 1)
        nodes = np.sign(places) * np.interp(np.abs(places), *scale[::-1])
        if (
            len(nodes) > MOST_KERNELS
            or contrast * _remainder(nodes, grid, q, curvature) <= tolerance
        ):
            return nodes
        step /= np.sqrt(2)


@lru_cache(maxsize=16)
def _node_scale(q, curvature):
    """Return circles of confusion from 0 on [pixel], and integrals of the density of nodes up to them, from 0 on."""
    circles = np.concatenate([np.arange(0, 64, 1 / 16), np.geomspace(64, 2048, 512)])
    density = _worst_derivative(4, circles, q, curvature) ** 0.25
    density = np.maximum(density, _worst_derivative(4, -circles, q, curvature) ** 0.25)
    return circles, np.append(0, np.cumsum(np.diff(circles) * (density[1:] + density[:-1]) / 2))


def _remainder(nodes, confusion, q, curvature=(0.0, 0.0), counts=None):
    """Root mean square over `confusion` of interpolation's remainder for a picture of contrast 1.

    counts: of each, by default 1. It is the product of the distances to the 4 nodes over 4! times the fourth
    derivative; of a single node the distance times the first.
    """
    first, count = stencil(nodes, confusion)
    error = _worst_derivative(count, confusion, q, curvature)
    for i in range(count):
        error = error * (confusion - nodes[first + i]) / (i + 1)
    return float(np.sqrt(np.average(error**2, weights=counts)))


def _worst_derivative(order, confusion, q, curvature):
    """Return the largest derivative over the field, where the lens adds these circles of confusion."""
    if not any(curvature):
        return _derivative(order, confusion, q)
    places = [confusion + more for more in np.linspace(*curvature, 5)]
    places.append(confusion + np.clip(-confusion, *curvature))  # in focus somewhere
    return np.max([_derivative(order, place, q) for place in places], axis=0)


def _derivative(order, confusion, q):
    """Root of the integral over frequency of P(f) |d^n T / dc^n|^2 at circles of confusion c [pixel], n = 1, 2 or 4.

    T is folded as in `optics.pupil`, O = 2 J1(v) / v with v = pi c f (1 - s), s = f over the cut-off, times what
    diffraction without defocus and the pixel leave (Stokseth, J. Opt. Soc. Am. 59, 1314 (1969)). With F_n =
    J_n(v) / v^n, whose derivative is -v F_(n+1), O' = -2 v F_2, O'' = -2 F_2 + 2 v^2 F_3 and the fourth is 6 F_3 -
    12 v^2 F_4 + 2 v^4 F_5.
    P = 1 / (4 sin^2 + 4 sin^2) is the power of white differences between neighbours.
    """
    known, values = _derivative_table(order, round(float(np.clip(q, 0.2, 3)), 2))
    return np.exp(np.interp(np.log(1 + np.abs(confusion)), known, values))


@lru_cache(maxsize=8)
@stored
def _derivative_table(order, q):
    known = np.linspace(np.log(1.05), np.log(1 + 512), 64)
    f = (np.arange(20) + 0.5) / 40
    power = 1 / (4 * np.sin(np.pi * f[:, None]) ** 2 + 4 * np.sin(np.pi * f) ** 2)
    reach = int(np.ceil(1 / q + 0.5))
    all_f = (np.arange(-reach, reach + 1)[:, None] + f).ravel()
    radius = np.hypot(all_f[:, None], all_f)
    s = np.minimum(radius * q, 1)
    passed = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    passed = passed * np.sinc(all_f[:, None]) * np.sinc(all_f)
    rate = np.pi * radius * (1 - s)
    v = np.arange(0.05, 512 * rate.max() + 0.1, 0.05)
    derivative = 6 * jv(3, v) / v**3 - 12 * jv(4, v) / v**2 + 2 * jv(5, v) / v
    if order == 1:
        derivative = -2 * jv(2, v) / v
    elif order == 2:
        derivative = -2 * jv(2, v) / v**2 + 2 * jv(3, v) / v
    values = []
    for confusion in np.expm1(known):
        some = passed * rate**order * np.interp(confusion * rate, v, derivative)
        folded = some.reshape(2 * reach + 1, len(f), 2 * reach + 1, len(f)).sum(axis=(0, 2))
        values.append(0.5 * np.log(np.mean(power * folded**2)))
    return known, np.array(values)
