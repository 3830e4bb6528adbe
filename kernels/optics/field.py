"""Field-varying blur: planes weighted by coefficient maps, convolved with kernels, and summed.

Ports: planes (planes, rows, cols) float32, coefficients (terms, rows, cols) float32 [1], kernels
(kernels, 1 or planes, m, n) float32 [1], m and n odd, index (tiles, terms) int32 or (tiles, terms,
kernels) float32, mix (channels, planes) float32 [, base (channels, rows, cols) float32] -> channels
(channels, rows, cols) float32:

    e_c = base_c + sum over tiles t, terms k, planes p of
          mix[c, p] kernels[index[t, k], p] * (coefficients_k planes_p in t)

The weights belong to the *source* pixel: light is spread from its place, and flux is conserved.
Tiles divide the source. An index of float32 holds weights: a term's kernel is then the sum over j of
index[t, k, j] kernels[j, p]. With `sources` there is a kernel for each source, and planes_p is the
plane sources[p].

Three methods are this one sum. Overlap-add of interpolated kernels has a tile for each cell of a
grid of kernels, and a term for each kernel that is mixed there. Eigen-kernels have one tile, and a
term for each of them (optics/field.py makes the maps of both). Expansions have a term for each power
of place and distance, and its kernel is a sum of eigen-kernels (optics/expansion.py). The terms of
a tile are transformed, summed, and transformed back once per channel.
"""

import functools
import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common import fft
from gpusim.kernels.common.border import BORDERS
from gpusim.kernels.stage import Array, Case, stage, warp_only
from gpusim.optics.lengths import fft_length
from gpusim.optics.memo import multiply

# of tiles transformed at once on a CPU: its caches; a GPU takes 64 times as much
BATCH_BYTES = 2**22
HOST_BATCH = 2**25  # [byte] of kernels' tables at once on a CPU
HOST_TILES = 16  # from here on, a CPU has a thread to each tile
BIN = 32  # [pixel] highlights are listed per square of this side
NEVER = float(np.finfo(np.float32).max)


@stage
def field(
    device: Device,
    planes: Array,
    coefficients: Array,
    kernels: Array,
    index: Array,
    edges: Sequence[np.ndarray],
    mix: Array,
    border: str,
    margin: int = 0,
    base: Array | None = None,
    threshold: float | None = None,
    tables: Array | None = None,
    sources: Array | None = None,
) -> Array:
    """Spread each pixel's light with the kernel of its place.

    Args:
        planes: Light of each plane, shape (planes, rows, cols).
        coefficients: Weight of each term at every pixel [1], shape (terms, rows, cols). Outside the
            frame the outermost value is repeated.
        kernels: Kernels [1], shape (kernels, 1 or planes, m, n), m and n odd; the centre is the
            pixel itself.
        index: Kernel of each term of a tile, int (tiles, terms), tiles row by row; or the weights of
            the kernels in each term, float (tiles, terms, kernels). Tiles and terms without weights
            take no time.
        edges: Boundaries of the tiles' rows and columns: two increasing lists of source pixels,
            from -(m // 2) to rows + m // 2 and from -(n // 2) to cols + n // 2.
        mix: Weight of each plane in each channel, shape (channels, planes).
        border: "zero", "edge" or "reflect".
        margin: Pixels on each side of the planes that are surroundings and not in the result; if
            negative, pixels of the result outside the planes.
        base: Light to add to, shape of the result; None for 0.
        threshold: Values above it are spread by direct sums. Dark pixels next to them then keep
            their float32 accuracy (a transform errs by 2.5e-7 of its largest values everywhere).
            None for transforms only.
        tables: `transfer(device, kernels, edges)`, to save its time if the same kernels are used
            again.
        sources: Plane whose light each plane of the kernels spreads, int, shape (sources,); `mix`
            then has a column for each. None: planes of the light and of the kernels correspond.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Channels, shape (channels, rows - 2 margin, cols - 2 margin), float32.

    Source:
        Hirsch et al., CVPR 2010 (efficient filter flow); Lauer, Proc. SPIE 4847 (2002)
        (eigen-PSFs).
    """
    _, rows, cols = planes.shape
    m, n = kernels.shape[2:]
    planes, coefficients = device.array(planes), device.array(coefficients)
    mix, index = (np.asarray(device.numpy(values)) for values in (mix, index))
    sources = np.arange(len(planes)) if sources is None else np.asarray(device.numpy(sources))
    groups = _group(index)
    order = np.concatenate([np.empty(0, int), *(tiles for _, tiles in groups)])
    slots = np.full(len(index), -1, np.int32)
    slots[order] = np.arange(len(order))
    channels, tiles_x = len(mix), len(edges[1]) - 1
    tables = transfer(device, kernels, edges) if tables is None else tables
    period, limit = _period(kernels.shape, edges), NEVER if threshold is None else float(threshold)
    if border == "zero":  # no light comes from outside
        edges = [np.clip(edge, 0, size) for edge, size in zip(edges, (rows, cols), strict=True)]
    blur = _on_host if device.on_host and len(index) >= HOST_TILES else _on_device
    it = _Blur(
        planes, coefficients, tables, kernels.shape[1], sources, index, groups,
        edges, mix, border, limit, period,
    )  # fmt: skip
    padded = blur(device, it)
    # the frame's pixels are counted without the margin from here on
    edges_y, edges_x = (device.array(np.asarray(edge) - margin, np.int32) for edge in edges)
    out = device.empty((channels, rows - 2 * margin, cols - 2 * margin))
    covers = [
        device.array(_covering(edge, np.arange(margin, length - margin), reach // 2), np.int32)
        for edge, length, reach in zip(edges, (rows, cols), (m, n), strict=True)
    ]
    base_or_any = out if base is None else device.array(base)
    slots = device.array(slots, np.int32)
    arrays = [padded, edges_y, edges_x, *covers, slots, base_or_any, out]
    numbers = [m // 2, n // 2, int(base is not None), *out.shape, padded.shape[1], tiles_x, *period]
    device.launch("optics.field", "assemble", out.shape, *arrays, *numbers)
    if threshold is not None:
        kernels = np.asarray(device.numpy(kernels))
        _add_highlights(
            *(device, out, planes, coefficients, kernels, sources),
            *(index, edges, mix, border, limit, margin),
        )
    return out


def _group(index):
    """Return groups of tiles with the same terms: pairs (terms, tiles). Tiles without weights are in none."""
    if index.ndim == 2:
        return [(np.arange(index.shape[1]), np.arange(len(index)))]
    has, group = np.unique(index.any(axis=2), axis=0, return_inverse=True)
    groups = [
        (np.flatnonzero(one), np.flatnonzero(group.ravel() == k)) for k, one in enumerate(has)
    ]
    return [(terms, tiles) for terms, tiles in groups if len(terms)]


@dataclass(frozen=True, eq=False)
class _Blur:
    """Arguments of `field` on the device, with groups of tiles, the threshold as a number, and the tiles' period."""

    planes: Array
    coefficients: Array
    tables: Array
    own: int
    sources: np.ndarray
    index: np.ndarray
    groups: list
    edges: Sequence[np.ndarray]
    mix: np.ndarray
    border: str
    limit: float
    period: tuple[int, int]

    @property
    def tiles(self) -> int:
        """Number of blurred tiles, at least 1."""
        return max(sum(len(tiles) for _, tiles in self.groups), 1)


def _on_device(device, it):
    """Return blurred tiles in the order of the groups, (channels, tiles, *period), by transforms of many at once."""
    _, rows, cols = it.planes.shape
    channels, half, period, own = len(it.mix), it.tables.shape[2], it.period, it.own
    lights, light_of = np.unique(it.sources, return_inverse=True)
    padded = device.empty((channels, it.tiles, *period))
    # pairs of a tile and a term, tile by tile
    found = [(t, k) for terms, members in it.groups for t in members for k in terms]
    pairs = np.array(found, int).reshape(-1, 2)
    counts = [len(terms) for terms, members in it.groups for _ in members]
    ends = np.cumsum([0, *counts], dtype=int)
    own_terms = it.index[*pairs.T]  # kernel of each, or the weights of the kernels
    are_summed = own_terms.ndim == 2
    pairs, ends_there, lights, light_of = (
        device.array(one, np.int32) for one in (pairs, ends, lights, light_of)
    )
    edges = [device.array(edge, np.int32) for edge in it.edges]
    own_terms = device.array(own_terms, np.float32 if are_summed else np.int32)
    mix = device.array(it.mix)
    planes = lights.shape[0]
    each = 4 * period[0] * period[1] * (planes + own * are_summed)
    at_once = max(BATCH_BYTES * (64 if device.is_gpu else 1) // each, 1)
    launch, first = functools.partial(device.launch, "optics.field"), 0
    while first < len(counts):
        begin = int(ends[first])
        last = max(int(np.searchsorted(ends, begin + at_once, side="right")) - 1, first + 1)
        size, count = last - first, int(ends[last]) - begin
        tables = it.tables
        if are_summed:
            tables = device.empty((count * own, *it.tables.shape[1:]))
            sizes = [own_terms.shape[1], own, *tables.shape[:3]]
            launch("combine", tables.shape[:3], it.tables, own_terms, tables, begin, *sizes)
        weighted = device.empty((planes * count, *period))
        arrays = [it.planes, it.coefficients, *edges, pairs, lights, weighted]
        sizes = [rows, cols, len(it.edges[1]) - 1, count, *weighted.shape]
        launch("weigh", weighted.shape, *arrays, it.limit, begin, BORDERS[it.border], *sizes)
        spectra = fft.forward(device, weighted)
        pitch = spectra.shape[2]
        sums = device.empty((channels * size, period[0], pitch, 2))
        at = ends_there if are_summed else own_terms
        arrays = [spectra, tables, at, ends_there, light_of, mix, sums]
        settings = [first, int(are_summed), *warp_only(device, channels)]
        sizes = [count, len(it.sources), size, period[0], half, pitch, own]
        grid, defines = (size, period[0], half), {"CHANNELS": channels}
        launch("accumulate", grid, *arrays, *settings, *sizes, defines=defines)
        blurred = fft.inverse(device, sums, period[1])
        sizes = [first, channels, size, padded.shape[1], *period]
        launch("keep", (channels * size, *period), blurred, padded, *sizes)
        first = last
    return padded


def _on_host(device, it):
    """Return the same, one thread per tile: it stays in a core's cache (a third less time)."""
    import scipy.fft

    period, own, edges, limit, mix = it.period, it.own, it.edges, it.limit, it.mix
    padded = device.empty((len(mix), it.tiles, *period))
    planes, coefficients, out = (
        device.numpy(values) for values in (it.planes, it.coefficients, padded)
    )
    tables = device.numpy(it.tables).view(np.complex64)[..., : period[1] // 2 + 1, 0]
    _, rows, cols = planes.shape
    reach = [-int(edge[0]) for edge in edges]
    beyond = [_sources(size, one, it.border) for size, one in zip((rows, cols), reach, strict=True)]
    half = period[1] // 2 + 1
    tables = tables.reshape(-1, own, period[0], half)
    if it.index.ndim == 3:
        by_kernel = tables.reshape(len(tables), -1).view(np.float32)
        # of one size: fresh memory would take as long as the product
        most = max(HOST_BATCH // by_kernel[0].nbytes, it.index.shape[1])
        room = device.numpy(device.empty((most, by_kernel.shape[1])))

    def blur(job):
        at, t, used, chosen = job
        i, j = divmod(t, len(edges[1]) - 1)
        y, x = (np.arange(edge[k], edge[k + 1]) for edge, k in zip(edges, (i, j), strict=True))
        if not len(y) or not len(x):
            out[:, at] = 0
            return
        if y[0] >= 0 and y[-1] < rows and x[0] >= 0 and x[-1] < cols:
            place = weight_place = np.s_[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
        else:
            from_y, from_x = (
                source[places + one]
                for source, places, one in zip(beyond, (y, x), reach, strict=True)
            )
            place = np.ix_(from_y, from_x)
            weight_place = np.ix_(y.clip(0, rows - 1), x.clip(0, cols - 1))
        weights = coefficients[:, *weight_place]
        # the transform of rows of zeros is 0
        weighted = np.zeros((len(used), len(y), period[1]), np.float32)
        spectra = np.zeros((len(used), period[0], half), np.complex64)
        sums = np.zeros((len(mix), period[0], half), np.complex64)
        product, seen = np.empty_like(sums[0]), -1
        for p, source in enumerate(it.sources):
            if source != seen:
                light, seen = planes[source][place], source
                if limit < NEVER:
                    light = np.where(light > limit, np.float32(0), light)
                for k, term in enumerate(used):
                    np.multiply(weights[term], light, out=weighted[k, :, : len(x)])
                spectra[:, : len(y)] = scipy.fft.rfft(weighted)
                spectra[:, len(y) :] = 0
                spectra = scipy.fft.fft(spectra, axis=1, overwrite_x=True)
            own_kernels = chosen[:, min(p, own - 1)]
            passed = spectra[0] * own_kernels[0]
            for k in range(1, len(used)):
                passed += np.multiply(spectra[k], own_kernels[k], out=product)
            for total, weight in zip(sums, mix[:, p], strict=True):
                if weight == 1:
                    total += passed
                elif weight:
                    total += np.multiply(weight, passed, out=product)
        sums = scipy.fft.ifft(sums, axis=1, overwrite_x=True)
        out[:, at] = scipy.fft.irfft(sums, period[1])

    first, threads = 0, os.cpu_count() or 1
    with device.host_work(), ThreadPoolExecutor(threads) as pool:
        for used, members in it.groups:
            batch = max(HOST_BATCH // (len(used) * tables[0].nbytes), 1)
            for some in np.split(members, range(batch, len(members), batch)):
                if it.index.ndim == 2:
                    chosen = tables[it.index[some]]
                else:
                    weights = it.index[some][:, used].reshape(-1, len(tables))
                    combined = room[: len(weights)]
                    ends = np.linspace(0, by_kernel.shape[1], threads + 1).astype(int)
                    pieces = [slice(a, b) for a, b in itertools.pairwise(ends)]
                    parts = [[whole[:, one] for one in pieces] for whole in (by_kernel, combined)]
                    list(pool.map(functools.partial(multiply, weights), *parts))
                    chosen = combined.view(np.complex64)
                    chosen = chosen.reshape(len(some), len(used), *tables.shape[1:])
                jobs = [(first + k, t, used, chosen[k]) for k, t in enumerate(some)]
                for _ in pool.map(blur, jobs):  # raises the threads' errors
                    pass
                first += len(some)
    return padded


def transfer(device, kernels, edges):
    """Return the spectra of kernels in the tiles' period.

    Args:
        device: The device.
        kernels: As for `field`.
        edges: As for `field`.

    Returns:
        Spectra, shape (kernels times 1 or planes, period rows, pitch, 2), float32 of the device.
    """
    kernels = np.asarray(device.numpy(kernels), np.float32)
    count, own, m, n = kernels.shape
    padded = np.zeros((count * own, *_period(kernels.shape, edges)), np.float32)
    padded[:, :m, :n] = kernels.reshape(-1, m, n)
    return fft.forward(device, device.array(padded))


def _period(shape, edges):
    return tuple(
        fft_length(int(np.diff(edge).max()) + reach - 1)
        for edge, reach in zip(edges, shape[2:], strict=True)
    )


def _covering(edges, pixels, reach):
    """Return the first and last tile whose light reaches each of `pixels`, (pixels, 2)."""
    edges = np.asarray(edges)
    first = np.searchsorted(edges, pixels - reach, side="right") - 1
    last = np.searchsorted(edges, pixels + reach, side="right") - 1
    return np.clip(np.stack([first, last], axis=1), 0, len(edges) - 2)


def _sources(length, reach, border):
    """Return the source pixel for each place from -reach to length + reach, -1 if there is none."""
    places = np.arange(-reach, length + reach)
    if border == "zero":
        return np.where((places < 0) | (places >= length), -1, places)
    if border == "edge":
        return np.clip(places, 0, length - 1)
    places = places % (2 * length)
    return np.minimum(places, 2 * length - 1 - places)


def _add_highlights(
    device,
    out,
    planes,
    coefficients,
    kernels,
    sources,
    index,
    edges,
    mix,
    border,
    threshold,
    margin,
):
    """Add the bright pixels that `weigh` left out.

    Their kernels are mixed on the host in float64 and summed on the device.
    """
    values = np.asarray(device.numpy(planes))
    bright = np.unique(np.concatenate([np.flatnonzero(value > threshold) for value in values]))
    if not len(bright):
        return
    channels, (rows, cols) = out.shape[0], values.shape[1:]
    m, n = kernels.shape[2:]
    row_of, col_of = _sources(rows, m // 2, border), _sources(cols, n // 2, border)
    # a pixel near the border is seen in the surroundings too
    places = np.array(
        [
            (y, x)
            for row, col in zip(*np.unravel_index(bright, (rows, cols)), strict=True)
            for y in np.flatnonzero(row_of == row)
            for x in np.flatnonzero(col_of == col)
        ]
    )
    places -= m // 2, n // 2
    weights = np.asarray(device.numpy(coefficients))
    mixed = np.empty((len(places), channels, m, n), np.float32)
    tiles = [
        np.searchsorted(edge, places[:, axis], side="right") - 1 for axis, edge in enumerate(edges)
    ]
    for k, (y, x) in enumerate(places):
        at = row_of[y + m // 2], col_of[x + n // 2]
        light = np.where(values[:, *at] > threshold, values[:, *at], 0).astype(np.float64)
        weight = weights[:, min(max(y, 0), rows - 1), min(max(x, 0), cols - 1)].astype(np.float64)
        tile = tiles[0][k] * (len(edges[1]) - 1) + tiles[1][k]
        if index.ndim == 2:
            own = np.tensordot(weight, kernels[index[tile]], 1)
        else:
            own = np.tensordot(weight @ index[tile], kernels, 1)
        light = light[sources]
        mixed[k] = np.einsum("cp,pij->cij", mix * light, np.broadcast_to(own, (len(light), m, n)))
    places -= margin
    bins_y, bins_x = (-(-length // BIN) for length in out.shape[1:])
    lists = [[] for _ in range(bins_y * bins_x)]
    for k, (y, x) in enumerate(places):
        for i in range(max(0, (y - m // 2) // BIN), min(bins_y, (y + m // 2) // BIN + 1)):
            for j in range(max(0, (x - n // 2) // BIN), min(bins_x, (x + n // 2) // BIN + 1)):
                lists[i * bins_x + j].append(k)
    squares = [k for k, one in enumerate(lists) if one]
    starts = np.cumsum([0, *(len(lists[k]) for k in squares)])
    listed = np.concatenate([np.array(lists[k], np.int32) for k in squares])
    corners = BIN * np.stack(np.divmod(squares, bins_x), axis=1)
    lists = [device.array(numbers, np.int32) for numbers in (corners, starts, listed)]
    arrays = [device.array(places, np.int32), device.array(mixed), *lists, out]
    sizes = [*out.shape, m, n, len(squares)]
    device.launch("optics.field", "spread", (channels, len(squares) * BIN, BIN), *arrays, *sizes)


def cases():
    """Yield cases.

    One tile and many, all borders, own kernels per plane, one to many pixels, a highlight of 1e6
    spread directly; weights of kernels, tiles and terms without weights, several kernels of a plane.
    """
    random = np.random.default_rng(11)
    for rows, cols, count, channels, terms, tiles, own, border, m, threshold in (
        (1, 1, 1, 1, 1, (1, 1), 0, "edge", 1, None),
        (7, 9, 2, 1, 3, (1, 1), 1, "zero", 5, None),
        (40, 61, 3, 2, 4, (3, 5), 0, "reflect", 9, None),
        (40, 61, 2, 3, 4, (4, 3), 1, "edge", 15, 100.0),
        (40, 61, 2, 3, 4, (4, 5), 1, "zero", 15, 100.0),
        (40, 61, 3, 2, 9, (5, 7), 0, "edge", 9, None),
        (5, 200, 1, 1, 4, (2, 9), 0, "reflect", 7, 100.0),
        (64, 48, 2, 2, 12, (1, 1), 0, "reflect", 21, None),
        (40, 61, 2, 3, 4, (4, 5), 1, "edge", 9, 100.0),
        (40, 61, 3, 2, 5, (2, 3), 0, "zero", 9, None),
    ):
        has_weights = (m, terms) in ((9, 5), (9, 4)) and tiles in ((4, 5), (2, 3))
        planes = random.random((count, rows, cols))
        if threshold:
            planes[0, 0, -1] = planes[-1, rows // 2, cols // 2] = 1e6
        kernels = random.random((7, count if own else 1, m, m))
        edges = [
            np.unique(np.round(np.linspace(-(m // 2), size + m // 2, parts + 1)).astype(int))
            for size, parts in zip((rows, cols), tiles, strict=True)
        ]
        number = (len(edges[0]) - 1) * (len(edges[1]) - 1)
        why = (
            "a float32 transform errs by 2.5e-7 of the root mean square of its input, at most 5 such sigmas over "
            "1e4 pixels; a kernel of noise with mean 1/2 raises sum and error equally; three transforms"
        )
        if threshold:
            why += "; values above the threshold are summed directly, relative to the local value"
        inputs = {
            "planes": planes.astype(np.float32),
            "coefficients": random.random((terms, rows, cols)).astype(np.float32),
            "kernels": (kernels / m**2).astype(np.float32),
            "index": random.integers(0, 7, (number, terms)).astype(np.int32),
            "mix": random.random((channels, count)).astype(np.float32),
            "edges": edges,
            "border": border,
            "threshold": threshold,
            "base": None,
            "margin": {15: 3, 21: -2}.get(m, 0),
        }
        if has_weights:
            weights = random.random((number, terms, 7)).astype(np.float32) / 7
            weights[::3, 1:] = weights[1::4] = 0
            inputs["index"] = weights
            inputs["sources"] = np.array([0, 0, *range(1, count)])
            inputs["mix"] = random.random((channels, count + 1)).astype(np.float32)
            if own:
                kernels = np.concatenate([kernels, kernels[:, :1]], axis=1)
                inputs["kernels"] = (kernels / m**2).astype(np.float32)
        if m == 15:
            inputs["base"] = random.random((channels, rows - 6, cols - 6)).astype(np.float32)
        yield Case(
            f"{rows}x{cols}, {terms} terms, {number} tiles, {border}",
            inputs,
            4e-6,
            why,
            metric="local" if threshold else "peak",
            floor=0.05,
        )


def bench(rows, cols):
    """Return inputs: one plane, 8 x 8 kernels of 31 x 31, bilinear between them."""
    random = np.random.default_rng(11)
    y, x = (np.round(np.linspace(0, size - 1, 8)).astype(int) for size in (rows, cols))
    fractions = []
    for size, at in ((rows, y), (cols, x)):
        cell = np.repeat(np.arange(7), np.diff([0, *at[1:-1], size]))
        fractions.append(np.clip((np.arange(size) - at[cell]) / np.diff(at)[cell], 0, 1))
    v, u = fractions[0][:, None], fractions[1]
    corner = np.arange(7)[:, None] * 8 + np.arange(7)
    kernels = random.random((64, 1, 31, 31))
    index = np.stack([corner + d for d in (0, 1, 8, 9)], axis=-1).reshape(49, 4)
    coefficients = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u])
    return {
        "planes": random.random((1, rows, cols), np.float32),
        "coefficients": coefficients.astype(np.float32),
        "kernels": (kernels / kernels.sum(axis=(2, 3), keepdims=True)).astype(np.float32),
        "index": index.astype(np.int32),
        "edges": [np.array([-15, *at[1:-1], size + 15]) for at, size in ((y, rows), (x, cols))],
        "mix": np.ones((1, 1), np.float32),
        "border": "edge",
    }
