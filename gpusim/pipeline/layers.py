"""Layers by depth: each blurred for its distance, and laid over the farther ones."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.composite import composite
from gpusim.kernels.optics.distort import distort
from gpusim.kernels.optics.expand import expand
from gpusim.kernels.optics.falloff import falloff
from gpusim.kernels.optics.field import field
from gpusim.kernels.optics.occlude import occlude
from gpusim.kernels.optics.reveal import reveal
from gpusim.kernels.optics.sample import sample
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.coarse import CoarseGrid
from gpusim.optics.depth import DepthPlan, flatten
from gpusim.optics.expansion import Terms, choose_terms
from gpusim.optics.kernel_space import KernelSpace
from gpusim.optics.placed import find_box
from gpusim.pipeline.reading import planes, store
from gpusim.pipeline.tables import LensTables
from gpusim.planner.choices import Blur, Fusion, Planes
from gpusim.planner.plan import Plan


@dataclass(frozen=True, eq=False)
class PreparedLayer:
    """A layer, as far as it does not depend on its light.

    Attributes:
        shown: Inputs of `optics.reveal`, `index` and `factor`; empty if the layer shows the scene's own samples.
        covers: Coverage [1], and it times the circles of confusion above the least [pixel], (2, rows, cols).
        terms: Terms of its kernels.
        is_whole: Whether it covers all samples.
        lit: Rows and columns outside of which it covers no sample.
        window: Rows and columns outside of which it covers no displaced sample.
    """

    shown: dict
    covers: Any
    terms: Terms
    is_whole: bool
    lit: tuple[slice, slice]
    window: tuple[slice, slice]


def prepare_layers(places, *, plan: Plan, device) -> tuple[PreparedLayer, ...]:
    """Return the layers of a plan. places: see `place_layers`; None: nothing is displaced."""
    depth, space = plan.find(DepthPlan), plan.find(KernelSpace)
    assert depth is not None and space is not None
    placed = None if places is None else places[2]

    def prepare(layer):
        coverage, confusion = depth.surface(layer)
        at = None if depth.sheets else depth.shown(layer)
        shown = None if at is None else _find_shown(at, depth.beside(layer))
        covers = np.stack([coverage, coverage * (confusion - confusion.min())]).astype(np.float32)
        lit = find_box(covers[0])
        window = lit if placed is None else placed.find_window(lit)
        terms = choose_terms(space, confusion, coverage, placed, window)
        return shown, covers, terms, bool(np.all(coverage == 1)), lit, window

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets other threads run
        found = list(pool.map(prepare, range(depth.layers)))
    layers = []
    for shown, covers, *others in found:
        inputs = {}
        if shown is not None:
            index, factor = shown
            inputs = {"index": device.array(index, np.int32), "factor": device.array(factor)}
        layers.append(PreparedLayer(inputs, device.array(covers), *others))
    return tuple(layers)


def _find_shown(shown, beside):
    """Return index and factor for `optics.reveal`, less the light of others: see `DepthPlan.beside`.

    shown: samples whose light is shown, (rows, cols).
    """
    shown = shown.ravel()
    other, factor = (one.ravel() for one in beside or (shown, np.zeros(shown.size, np.float32)))
    at = np.flatnonzero((shown != np.arange(shown.size)) | (factor != 0))
    return np.stack([at, shown[at], other[at]]), factor[at]


def composite_layers(
    planes_,
    layers,
    places,
    lights,
    zoom,
    gains,
    varying,
    *,
    plan: Plan,
    tables: LensTables,
    border,
    device,
) -> Any:
    """Return channels in which each point is blurred for its distance, with nearer layers over farther ones.

    A layer's coverage is blurred in each channel with the channel's kernel for white in the scene's light. Objects
    continue outside the frame even if no light comes from there. The lens and a view displace a layer's light, its
    coverage, and its coverage times its circles of confusion, whose quotient is the circle of each displaced sample.

    layers: see `prepare_layers`. places: see `place_layers`; None: nothing is displaced. lights, zoom, gains: see
    `place_planes`. varying: see `make_depth_tables`.
    """
    depth, form, made = plan.find(DepthPlan), plan.find(Blur), plan.find(Planes)
    space = plan.find(KernelSpace)
    assert depth is not None and form is not None and space is not None
    table = made and made.table
    channels, margin = len(plan.weights), plan.scene.margin - form.spare
    beyond = "edge" if border == "zero" else border  # of coverage
    one, eye = np.ones((channels, 1), np.float32), np.eye(channels, dtype=np.float32)
    of_light, of_cover, evening, coarse = varying
    if coarse is None:
        of_planes, of_white = tables.at_distance(plan, space.reference)
    else:
        of_planes, of_white = (_Far(one, plan, margin, device) for one in coarse)
    placing = None
    if places is not None:
        placing = _Placing(places, lights, zoom, gains, plan.content.shape, border, beyond, device)
        picture = flatten(plan.scene)[0] if depth.sheets else None
        seen = planes_ if picture is None else planes(device, table, store(device, picture))
    alphas, blurred, sharp, sources = [], [], [], []
    for layer, prepared in enumerate(layers):
        own, covers, terms = planes_, prepared.covers, prepared.terms
        if depth.sheets and (content := depth.sheets[layer][0]) is not plan.content:
            own = planes(device, table, store(device, content))
        elif prepared.shown:
            own = reveal(planes_, **prepared.shown, device=device)
        if placing is None:
            cover = device.part(covers, slice(1))
            light = own if prepared.is_whole else falloff(own, cover, device=device)
        else:
            light, covers = placing.place(seen, own, prepared)
            cover = device.part(covers, slice(1))
        circles = {"spans": terms.spans, "edges": space.edges, "limits": terms.limits}
        inputs = {
            "coefficients": expand(covers, terms.degrees, **circles, device=device),
            "index": terms.index,
            "edges": space.edges,
            "margin": margin,
            "device": device,
        }
        if coarse is None:
            settings = {"period": form.period, "margin": margin, "device": device}
            blurred_light = blur(light, of_planes, form.mix, border, **settings)
            alpha = blur(cover, of_white, one, beyond, **settings)
        else:
            blurred_light, alpha = of_planes(light, form.mix, border), of_white(cover, one, beyond)
        blurred_light = field(
            light, mix=form.mix, border=border, base=blurred_light, **of_light, **inputs
        )
        alpha = field(cover, mix=eye, border=beyond, base=alpha, **of_cover, **inputs)
        if evening is not None:
            alpha = falloff(alpha, evening, device=device)
        if terms.even is not None:
            gains = expand(covers, terms.degrees[:0], **circles, even=terms.even, device=device)
            alpha = falloff(alpha, _cut(gains, margin, device), device=device)
        blurred.append(blurred_light)
        alphas.append(alpha)
        rays = depth.occlusion
        if rays is not None and rays.maps is not None:
            sources.append(_undisplaced(own, prepared, plan, device))
        # rays meet the layers undisplaced; diffraction in focus is of displaced ones
        is_needed = not sources or (rays is not None and depth.groups[layer] in rays.sharp)
        sharp.append(sharpen(light, cover, plan, device) if is_needed else sources[-1])
    composed = composite(
        device.stack(blurred), device.stack(alphas), list(depth.groups), device=device
    )
    if depth.occlusion is None:
        return composed
    groups = _Groups(blurred, alphas, sharp, sources, list(depth.groups), plan, border, device)
    return groups.occlude(groups.diffract(composed, tables), tables)


class _Far:
    """Blurs planes with the far part of a kernel, on a coarse grid. tables: of that grid."""

    def __init__(self, tables, plan, margin, device):
        form = plan.find(Blur)
        self._tables, self._margin, self._device = tables, margin, device
        self._grid = CoarseGrid.of(plan.content.shape, form.period)

    def __call__(self, planes_, mix, border):
        """Return channels without the light of the near part, (channels, rows, cols)."""
        grid, device = self._grid, self._device
        gathered = sample(planes_, *grid.gather(border), device=device)
        far = blur(gathered, self._tables, mix, "zero", grid.lengths, device=device)
        return sample(far, *grid.spread(self._margin), device=device)


def _cut(gains, margin, device):
    """Return gains (C, rows, cols) without a margin, or with more of the outermost if it is negative."""
    if not margin:
        return gains
    starts = [np.arange(margin, size - margin).clip(0, size - 1) for size in gains.shape[1:]]
    (rows, cols), one = (at.astype(np.int32) for at in starts), np.ones
    return sample(
        gains,
        rows,
        one((len(rows), 1), np.float32),
        cols,
        one((len(cols), 1), np.float32),
        device=device,
    )


def sharpen(light, cover, plan: Plan, device) -> Any:
    """Return planes as channels without blur, and their coverage; None if no light is summed over the pupil."""
    depth, form, fusion = plan.find(DepthPlan), plan.find(Blur), plan.find(Fusion)
    assert depth is not None and form is not None
    if depth.occlusion is None:
        return None
    flat = plan.flat if fusion is None else fusion.transfers @ plan.flat
    return integrate(light, (form.mix * flat).astype(np.float32), device=device), cover


def _undisplaced(own, prepared, plan, device):
    """Return the channels of a layer without blur, and its coverage, before lens and view displace them."""
    cover = device.part(prepared.covers, slice(1))
    light, _ = sharpen(own, cover, plan, device)
    return light if prepared.is_whole else falloff(light, cover, device=device), cover


class _Groups:
    """Layers that are composed, blurred and sharp: sums of their parts. See `composite_layers`.

    sources: light and coverage of the layers before they are displaced; empty: they are not.
    """

    def __init__(self, lights, alphas, sharp, sources, layers, plan, border, device):
        self._plan, self._border, self._device = plan, border, device
        self._depth, form = plan.find(DepthPlan), plan.find(Blur)
        self._margin, self._period = plan.scene.margin - form.spare, form.period
        self._count = layers[-1] + 1

        def sums(arrays):
            return [
                _sum([one for one, its in zip(arrays, layers, strict=True) if its == group], device)
                for group in range(self._count)
            ]

        self._blurred = list(zip(sums(lights), sums(alphas), strict=True))
        covers = sums([cover for _, cover in sharp])
        self._sharp = list(zip(sums([light for light, _ in sharp]), covers, strict=True))
        self._sources = self._sharp
        if sources:
            both = [sums(list(one)) for one in zip(*sources, strict=True)]
            self._sources = list(zip(*both, strict=True))

    def occlude(self, composed, tables):
        """Return composed channels with the sum over the pupil where several layers are out of focus.

        Its change is of rays, and is blurred by diffraction.
        """
        found, device = self._depth.occlusion, self._device
        places, members, radii, weights, maps, slopes = found.within(
            self._margin, composed.shape[1:]
        )
        if not len(places):
            return composed
        moved = tables.displacement(self._plan)
        base = self._move(composed, [-one for one in moved])
        change = occlude(
            base,
            device.stack([light for light, _ in self._sources]),
            device.stack([device.part(cover, 0) for _, cover in self._sources]),
            places,
            members,
            radii,
            found.points,
            self._border,
            margin=self._margin,
            change=True,
            weights=weights,
            bends=found.bends,
            maps=maps,
            slopes=slopes,
            device=device,
        )
        _, smooth = tables.in_focus(self._plan)
        if not any(moved):
            return self._spread(change, smooth, base=composed)
        return _mix([(1, composed), (1, self._move(self._spread(change, smooth), moved))], device)

    def diffract(self, composed, tables):
        """Return composed channels with the blur that diffraction in focus gives to products, and not to their factors.

        With K that blur, a the coverage of a layer and L the light behind it, K ((1 - a) L) is added
        and (1 - K a) K L taken away.
        """
        found, device = self._depth.occlusion, self._device
        if not found.is_diffracted:
            return composed
        sampled, smooth = tables.in_focus(self._plan)
        moved = tables.displacement(self._plan)
        is_sharp, behind, more = False, None, None
        for group in range(self._count - 1, -1, -1):
            light, alpha = self._blurred[group]
            cover = alpha
            if group in found.sharp:
                shape = composed.shape[1:]
                light, alpha = (self._crop(one, shape, moved) for one in self._sharp[group])
                is_sharp = True
            if behind is not None:
                table = sampled if is_sharp else smooth
                hidden = falloff(behind, alpha, device=device)
                spread = self._spread(behind, table, self._border)
                alpha = self._spread(alpha, table)
                # the change of the nearest is added to the composed channels
                base = composed if group == 0 else None
                if more is not None:
                    parts = [(1, more), (-1, falloff(more, cover, device=device))]
                    base = _mix(parts if base is None else [(1, base), *parts], device)
                product = falloff(spread, alpha, base, device=device)
                more = self._spread(hidden, table, self._border, product, -1)
                if group:
                    light = _mix([(1, light), (1, behind), (-1, hidden)], device)
            behind = light
        return more

    def _spread(self, fields, table, border="edge", base=None, factor=1):
        """Return a base plus fields, one of each channel or one of all, times a factor and blurred in focus."""
        channels, one = table.shape[0], fields.shape[0] == 1
        if not one:
            table = self._device.reshape(table, (1, channels, *table.shape[2:]))
        mix = np.ones((channels, 1), np.float32) if one else np.eye(channels, dtype=np.float32)
        mix *= factor
        return blur(fields, table, mix, border, self._period, base=base, device=self._device)

    def _crop(self, planes_, shape, moved):
        """Return planes in the frame of the blurred ones; samples beyond them go on at the edge."""
        inside = [self._margin + one for one in moved]
        return _take(planes_, inside, shape, self._device)

    def _move(self, planes_, moved):
        """Return the values (rows, cols) [sample] beyond each sample; samples go on at the edge."""
        return _take(planes_, moved, planes_.shape[1:], self._device) if any(moved) else planes_


def _take(planes_, first, shape, device):
    """Return a frame of planes from the place `first` on, (rows, cols) [sample], by cubics between samples."""
    starts, weights = [], []
    for begin, size, whole in zip(first, shape, planes_.shape[1:], strict=True):
        at = int(np.floor(begin)) + np.arange(size)
        f = begin - np.floor(begin)
        cubic = [
            -f * (f - 1) * (f - 2) / 6,
            (f * f - 1) * (f - 2) / 2,
            -f * (f + 1) * (f - 2) / 2,
            f * (f * f - 1) / 6,
        ]
        taps = np.clip(at[:, None] + np.arange(-1, 3), 0, whole - 1)
        count = min(4, whole)
        start = np.clip(at - 1, 0, whole - count)
        weight = np.zeros((size, count), np.float32)
        np.add.at(weight, (np.arange(size)[:, None], taps - start[:, None]), cubic)
        starts.append(start.astype(np.int32))
        weights.append(weight)
    return sample(planes_, starts[0], weights[0], starts[1], weights[1], device=device)


def _sum(arrays, device):
    """Return the sum of arrays (planes, rows, cols)."""
    return _mix([(1, one) for one in arrays], device) if len(arrays) > 1 else arrays[0]


def _mix(terms, device):
    """Return the sum of arrays (planes, rows, cols) times numbers: pairs (number, array)."""
    numbers, arrays = zip(*terms, strict=True)
    count, rows, cols = arrays[0].shape
    every = device.reshape(device.stack(arrays), (len(arrays), count * rows, cols))
    mixed = integrate(every, np.array([numbers], np.float32), device=device)
    return device.reshape(mixed, (count, rows, cols))


class _Placing:
    """Displaces parts of layers and their coverage. See `composite_layers`."""

    def __init__(self, places, lights, zoom, gains, shape, border, beyond, device):
        self._places, self._lights = places[:2], lights
        self._evening, self._density = gains, 1.0 if gains is not None else zoom**2
        self._shape, self._border, self._beyond, self._device = shape, border, beyond, device
        self._gain = self._limits = None
        if lights is None:  # by area: coverage of 1 remains 1
            ones = np.ones((1, *shape), np.float32)
            whole = distort(ones, places[1], shape, beyond, "area", device=device)
            self._gain = device.array(1 / np.asarray(device.numpy(whole)))

    def place(self, seen, own, prepared):
        """Return planes of a layer's light, and its coverage and what goes with it, displaced.

        seen: planes of the picture without blur. own: of the layer, not yet times its coverage.

        All samples next to which cubics would fall below 0, of the picture or of the layer, are taken by area. A part
        of a surface falls below 0 at its edges, but their sum does not.
        """
        (of_light, of_cover), shape, device = self._places, self._shape, self._device
        if self._lights is None:
            covers = prepared.covers
            light = falloff(own, device.part(covers, slice(1)), device=device)
            light = distort(
                light, of_light, shape, self._border, "area", self._density, device=device
            )
            if self._evening is not None:
                light = falloff(light, self._evening, device=device)
            covers = distort(covers, of_cover, shape, self._beyond, "area", device=device)
            return light, falloff(covers, self._gain, device=device)
        placed = distort(
            own,
            of_light,
            shape,
            self._border,
            light=self._limit(seen, own),
            cover=prepared.covers,
            lit=prepared.lit,
            window=prepared.window,
            device=device,
        )
        count = own.shape[0]
        return device.part(placed, slice(count)), device.part(placed, slice(count, None))

    def _limit(self, seen, own):
        """Return the channels of the picture, and of the layer if it has other light."""
        table, device = self._lights.astype(np.float32), self._device
        if self._limits is None:
            self._limits = integrate(seen, table, device=device)
        if own is seen:
            return self._limits
        both = device.stack([self._limits, integrate(own, table, device=device)])
        return device.reshape(both, (2 * len(table), *both.shape[2:]))
