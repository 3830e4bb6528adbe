"""Least squares for learned filters: normal equations gathered frame by frame, solved with a ridge.

For every noise level, level, position and class the wanted codes t (outputs, n) are predicted from
the sums s (G, n) of the groups of taps: W = argmin |W s - t|^2 + lambda |W - W_0|^2. W_0 are the
filters of all classes of that position together (Lansel & Wandell 2011; the ridge towards W_0 is
Hoerl & Kennard 1970 about a prior). Between levels filters are interpolated linearly, so a sample
counts for the two nearest, by the weights it is interpolated with.
"""

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.learned import Code, FilterTable, Layout
from gpusim.domain.mosaics import symmetries as find_symmetries
from gpusim.kernels.processor.learned_ref import classify, hats, positions, sum_groups


class NormalEquations:
    """Sums of s s', s t' and t t' in float64; `add` frames, then `solve`."""

    def __init__(self, layout: Layout, constant: bool = False):
        """constant: whether filters may add a number (`FilterTable.offsets`)."""
        self.layout, self.constant = layout, constant
        # of each noise level that has frames
        self.sums: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._sizes = layout.shape[-1] + constant, layout.shape[-2]

    def add(
        self,
        raw,
        wanted,
        code: Code,
        number: int = 0,
        phase=None,
        border: int = 0,
        weight: float = 1.0,
    ):
        """Add one frame.

        Args:
            raw: Mosaic, shape (rows, cols) [DN], whole numbers or not.
            wanted: Planes, 1 = white, shape (outputs, rows, cols).
            code: Black level, scale, noise and domain of the frame.
            number: Noise level of the layout for the frame, whose sigma should be near
                `layout.noise[number]`.
            phase: Start of the frame's mosaic, as in `learned`. None: as the table's.
            border: Pixels at each side that do not count.
            weight: Weight of the frame.

        Raises:
            BadData, UnknownName: If the frame does not fit the layout.
        """
        layout = self.layout
        raw, wanted = np.asarray(raw), np.asarray(wanted, np.float64)
        if wanted.shape != (len(layout.outputs), *raw.shape):
            expected = (len(layout.outputs), *raw.shape)
            raise BadData(f"wanted: shape {wanted.shape}; raw and layout make it {expected}")
        shift = (0, 0) if phase is None else layout.shift(phase)
        codes = code.encode_raw(raw)
        floor, strengths = layout.floor[number], layout.strengths[number]
        classes, levels = classify(codes, code, layout, floor, strengths)
        inside = np.s_[border : raw.shape[0] - border, border : raw.shape[1] - border]
        s = sum_groups(codes, layout)[:, *inside].reshape(layout.shape[-1], -1) / code.white
        if self.constant:
            s = np.vstack([s, np.ones((1, s.shape[1]))])
        t = code.encode(wanted[:, *inside] / code.scale).reshape(len(wanted), -1) / code.white
        if not (np.isfinite(s).all() and np.isfinite(t).all()):
            raise BadData("training frame: NaN or infinite values")
        bins = (positions(layout, raw.shape, shift) * layout.classes + classes)[inside].ravel()
        order = np.argsort(bins, kind="stable")
        edges = np.searchsorted(bins[order], np.arange(layout.positions * layout.classes + 1))
        a, b, c = self._sums(number)
        for at, hat in hats(levels[inside].ravel(), layout.levels):
            for k in np.flatnonzero(np.diff(edges)):
                some = order[edges[k] : edges[k + 1]]
                if not np.isscalar(hat):
                    # each sample counts for the two levels next to its own
                    some = some[hat[some] > 0]
                left, right = s[:, some], t[:, some]
                share = np.full(len(some), weight) * (hat if np.isscalar(hat) else hat[some])
                scaled = left * share
                at_bin = (at, k // layout.classes, k % layout.classes)
                a[at_bin] += scaled @ left.T
                b[at_bin] += scaled @ right.T
                c[at_bin] += right**2 @ share

    def _sums(self, number):
        terms, outputs = self._sizes
        if number not in self.sums:
            bins = self.layout.shape[1:4]
            self.sums[number] = (
                np.zeros((*bins, terms, terms)),
                np.zeros((*bins, terms, outputs)),
                np.zeros((*bins, outputs)),
            )
        return self.sums[number]

    def merge(self, other: "NormalEquations"):
        """Count the frames of others of the same layout too."""
        for number, theirs in other.sums.items():
            for mine, sums in zip(self._sums(number), theirs, strict=True):
                mine += sums

    def solve(
        self, ridge: float = 1e-5, preserve: bool = False, exchanges=(), provenance: str = ""
    ) -> FilterTable:
        """Return the table that fits the frames added so far.

        An output of the pixel's own channel that equals the sample in all frames stays the sample.

        Args:
            ridge: lambda in units of the mean variance of a term in a class (of an average class of that
                position).
            preserve: Whether every filter keeps flat fields of any colour; outputs are then named as
                channels.
            exchanges: Pairs of letters of equivalent channels, for example ("R", "B"), which share data and
                filters. Mirror images and transposes that map the mosaic to itself always share.
            provenance: Text of the table about its training.

        Raises:
            BadData: If the frames do not determine the filters of a noise level or position.
        """
        layout = self.layout
        if preserve and not set(layout.outputs) <= set(layout.channels):
            raise BadData(
                f"outputs {layout.outputs}: flat fields can be kept in channels, {layout.channels}"
            )
        maps = symmetries(layout, exchanges)
        constraints = flat_sums(layout, self.constant)
        if preserve and not constraints.any(axis=2).all():
            raise BadData(
                "taps: some position has no sample of some channel among them, and flat fields shall "
                "be kept"
            )
        bins = (*layout.shape[:2], layout.positions, layout.classes)
        filters = np.zeros((*bins, *self._sizes[::-1]))
        for number in range(len(layout.noise)):
            if number not in self.sums:
                why = f"noise level {number} ({layout.noise[number]:g} of white): no training frame"
                raise BadData(why)
            a, b, c = (
                share_mirrored(part, maps, axes, self.constant)
                for part, axes in zip(self.sums[number], ("gg", "go", "o"), strict=True)
            )
            filters[number] = self._solve_position(a, b, c, ridge, preserve, constraints, number)
        # makes sums over mirror images exact, and equal
        filters = np.rint(filters * 2.0**40) / 2.0**40
        filters = np.stack([share_mirrored(some, maps, "og", self.constant) for some in filters])
        groups = layout.shape[-1]
        offsets = filters[..., groups] if self.constant else None
        return FilterTable(layout, filters[..., :groups], offsets, provenance)

    def _solve_position(self, a, b, c, ridge, preserve, constraints, number):
        layout = self.layout
        terms = a.shape[-1]
        letters = "".join(layout.mosaic)
        flat = np.equal.outer(layout.channels, layout.outputs).astype(float)
        own = self._own()
        out = np.zeros((*a.shape[:3], b.shape[-1], terms))
        for p in range(layout.positions):
            place = f"noise level {number}, position {divmod(p, layout.period[1])} ({letters[p]})"
            total = a[:, p].sum(axis=(0, 1))
            values = np.linalg.eigvalsh(total)
            if not values[0] > 1e-13 * values[-1]:
                free = (values > 1e-13 * values[-1]).sum()
                raise BadData(
                    f"{place}: the training frames are singular, of {terms} terms {free} vary "
                    "independently; add frames with more detail or noise"
                )
            limit = (constraints[p], flat) if preserve else None
            unit = ridge * np.trace(total) / terms / layout.classes / len(layout.levels)
            everywhere = solve_ridge(total, b[:, p].sum(axis=(0, 1)), 0.0, None, limit)
            for at in range(len(layout.levels)):
                level = solve_ridge(
                    a[at, p].sum(axis=0), b[at, p].sum(axis=0), unit, everywhere, limit
                )
                for k in range(layout.classes):
                    out[at, p, k] = solve_ridge(a[at, p, k], b[at, p, k], unit, level, limit).T
            for o, name in enumerate(layout.outputs):
                if name != letters[p] or own is None:
                    continue
                square = c[:, p, :, o].sum()
                left = square - 2 * b[:, p, :, own, o].sum() + a[:, p, :, own, own].sum()
                if abs(left) <= 1e-9 * square:
                    out[:, p, :, o] = np.eye(terms)[own]
        return out

    def _own(self):
        """Return the group that has only the pixel's own sample, or None."""
        layout = self.layout
        at = layout.groups[(layout.taps == 0).all(axis=1)]
        return at[0] if len(at) == 1 and (layout.groups == at[0]).sum() == 1 else None


def solve_ridge(a, b, ridge, prior, limit):
    """Solve (A + ridge I) W = B + ridge prior for W (terms, outputs), with C W = d for a limit."""
    a = a + ridge * np.eye(len(a))
    b = b if prior is None else b + ridge * prior
    if limit is None:
        return np.linalg.solve(a, b)
    sums, values = limit
    scale = np.trace(a) / len(a)
    full = np.block([[a / scale, sums.T], [sums, np.zeros((len(sums), len(sums)))]])
    return np.linalg.solve(full, np.vstack([b / scale, values]))[: len(a)]


def flat_sums(layout: Layout, constant=False):
    """Return the terms of a flat field of 1 in one channel, shape (P, channels, terms)."""
    rows, cols = layout.period
    letters = np.array([list(text) for text in layout.mosaic])
    out = np.zeros((layout.positions, len(layout.channels), layout.shape[-1] + constant))
    for p in range(layout.positions):
        y, x = divmod(p, cols)
        for (dy, dx), group in zip(layout.taps, layout.groups, strict=True):
            out[p, layout.channels.index(letters[(y + dy) % rows, (x + dx) % cols]), group] += 1
    return out


def symmetries(layout: Layout, exchanges=()):
    """Return mirror images, transposes and shifts that map the mosaic to itself.

    They may exchange channels.

    Returns a list of (positions (P,), classes (K,), groups (G,), outputs): the new index of each of
    them.
    """
    index = {tuple(tap): n for n, tap in enumerate(layout.taps.tolist())}
    steps = np.stack(np.divmod(np.arange(layout.classes), layout.kinds))
    swaps: list[dict[str, str]] = [{}]
    for one, two in exchanges:
        swaps += [{**swap, one: two, two: one} for swap in swaps]
    found = []
    for places, transpose, sign, swap in find_symmetries(layout.mosaic, swaps):
        if transpose and not layout.alike:
            continue
        turned = (layout.taps[:, ::-1] if transpose else layout.taps) * sign
        moved = [index.get(tuple(tap), -1) for tap in turned.tolist()]
        if -1 in moved:
            continue
        groups = np.full(layout.shape[-1], -1)
        groups[layout.groups] = layout.groups[moved]
        if not np.array_equal(groups[layout.groups], layout.groups[moved]):
            continue
        direction = (2 * len(layout.ratios) - steps[0]) if transpose else steps[0]
        outputs = [swap.get(name, name) for name in layout.outputs]
        if set(outputs) <= set(layout.outputs):
            numbers = [layout.outputs.index(name) for name in outputs]
            found.append((places, direction * layout.kinds + steps[1], groups, numbers))
    return found


def share_mirrored(values, maps, axes, constant=False):
    """Return the mean of values and of all their mirror images, turned back.

    values: shape (.., P, K, *axes) with one axis before; axes: "g" for groups (and the constant),
    "o" for outputs.
    """
    out = np.zeros_like(values)
    for places, classes, groups, outputs in maps:
        orders = {"g": np.append(groups, len(groups)) if constant else groups, "o": outputs}
        out += values[np.ix_(range(len(values)), places, classes, *(orders[axis] for axis in axes))]
    return out / len(maps)
