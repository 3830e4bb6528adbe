"""Bounds of the samples that pixels take their light from, through a grid of places (`optics.distort`)."""

import numpy as np

# of cubics through four nodes, between any of them: the most that they exceed the nodes' range, along both axes
LEBESGUE = 1.632**2
REACH = 3  # samples around a place that a pixel takes light from, and one for rounding


class Placed:
    """Bounds of the samples of a source that rectangles of a frame take their light from, and the other way.

    Args:
        nodes: Grid of places, see `optics.distort`, shape (ny, nx, 3).
        shape: Rows and columns of the frame.
        source: Rows and columns of the source.
    """

    def __init__(self, nodes: np.ndarray, shape: tuple[int, int], source: tuple[int, int]):
        self._source = source
        self._known: dict[tuple, tuple[slice, slice]] = {}
        count = nodes.shape[:2]
        near = np.lib.stride_tricks.sliding_window_view(nodes[..., :2], (4, 4), axis=(0, 1))
        low, high = near.min(axis=(3, 4)), near.max(axis=(3, 4))
        middle, half = (low + high) / 2, (high - low) / 2 * LEBESGUE
        cells = np.ix_(*(np.clip(np.arange(n - 1) - 1, 0, n - 4) for n in count))
        self._low, self._high = (middle - half)[cells], (middle + half)[cells]
        # first pixel of each cell between nodes, and one beyond its last
        self._first, self._end = [], []
        for n, size in zip(count, shape, strict=True):
            bounds = np.arange(n) * size / (n - 1)
            self._first.append(np.clip(np.floor(bounds[:-1] - 0.5), 0, size).astype(int))
            self._end.append(np.clip(np.ceil(bounds[1:] + 0.5), 0, size).astype(int))

    def find_sources(self, part: tuple[slice, slice]) -> tuple[slice, slice]:
        """Return rows and columns of the source, at least all that pixels of a rectangle take light from."""
        key = tuple((one.start, one.stop) for one in part)
        if key not in self._known:  # layers have the same rectangles
            self._known[key] = self._find_sources(part)
        return self._known[key]

    def _find_sources(self, part):
        cells = tuple(
            slice(np.searchsorted(end, one.start, "right"), np.searchsorted(first, one.stop))
            for one, first, end in zip(part, self._first, self._end, strict=True)
        )
        found = []
        for axis, (one, size) in enumerate(zip(part, self._source, strict=True)):
            first = one.start + self._low[cells][..., axis].min() - REACH
            last = one.stop + self._high[cells][..., axis].max() + REACH
            # what lies beyond the source is folded back, or is its outermost sample
            low, high = min(first, 2 * size - last), max(last, -first)
            start = int(np.clip(np.floor(low), 0, size - 1))
            found.append(slice(start, int(np.clip(np.ceil(high), start + 1, size))))
        return found[0], found[1]

    def find_window(self, lit: tuple[slice, slice]) -> tuple[slice, slice]:
        """Return rows and columns of the frame, at least all that take light from a rectangle of the source."""
        takes = np.full(self._low.shape[:2], all(one.stop > one.start for one in lit))
        for axis, (one, size) in enumerate(zip(lit, self._source, strict=True)):
            along = (slice(None), None) if axis == 0 else (None, slice(None))
            first = self._first[axis][along] + self._low[..., axis] - REACH
            last = self._end[axis][along] + self._high[..., axis] + REACH
            low = np.minimum(np.minimum(first, 2 * size - last), size - 1)
            high = np.maximum(np.maximum(last, -first), 1)
            takes &= (low < one.stop) & (high > one.start)
        if not takes.any():
            return slice(0, 0), slice(0, 0)
        found = []
        for axis in (0, 1):
            cells = np.flatnonzero(takes.any(axis=1 - axis))
            found.append(slice(int(self._first[axis][cells[0]]), int(self._end[axis][cells[-1]])))
        return found[0], found[1]


def find_box(values: np.ndarray) -> tuple[slice, slice]:
    """Return rows and columns outside of which values (rows, cols) are 0."""
    found = []
    for axis in (0, 1):
        some = np.flatnonzero(values.any(axis=1 - axis))
        found.append(slice(int(some[0]), int(some[-1]) + 1) if len(some) else slice(0, 0))
    return found[0], found[1]
