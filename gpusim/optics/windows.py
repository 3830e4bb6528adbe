"""Windows of a picture: parts in which errors are computed, drawn near its edges.

Errors of a blur are at edges. Windows are drawn with a probability that grows with the energy of
the edges in them, and weighted by its inverse (Horvitz and Thompson, J. Am. Stat. Assoc. 47, 1952).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gpusim.optics.fusion import in_range

MOST_STEPS = 2**18  # between neighbours that are read to locate edges
EDGES = 0.7  # part of the windows drawn with the energy of edges; the others are drawn evenly


@dataclass(frozen=True, eq=False)
class Windows:
    """Which parts of a picture are looked at.

    rows, cols: places of each one's samples, int (n, side), which may lie outside the picture. weight: of the frame's
    samples that each stands for, sums to 1, (n,). steepest: largest step between neighbours anywhere over the largest
    in any window's inner part, at least 1.
    """

    rows: np.ndarray
    cols: np.ndarray
    weight: np.ndarray
    steepest: float

    @classmethod
    def of(
        cls, brightness, margin: int, border: str, count: int, side: int, rim: int, beside: int = 0
    ) -> "Windows":
        """Return at most `count` windows of the frame.

        Args:
            brightness: Light of the frame and of `margin` around it, shape (rows, cols).
            margin: Samples around the frame.
            border: The scene's border.
            count: Most windows.
            side: Side of a window [sample].
            rim: Samples on each side of a window around its inner part, which is in the frame.
            beside: Neighbouring inner parts on each side whose edges count for an inner part,
                too.
        """
        starts, energy, largest = _edges(brightness, margin, border, side - 2 * rim)
        if beside:
            energy = average_boxes(energy, 2 * beside + 1, "constant")
        drawn, weight = _draw(energy.ravel(), count)
        y, x = np.unravel_index(drawn, energy.shape)
        at = margin - rim + np.arange(side)
        seen = largest[y, x].max()
        steepest = float(largest.max() / seen) if seen > 0 else 1.0
        rows, cols = starts[0][y, None] + at, starts[1][x, None] + at
        return cls(rows, cols, weight / weight.sum(), steepest)


def take_windows(array: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Return windows of an array (..., height, width) at rows (n, h) and columns (n, w): new, (n, ..., h, w)."""
    shape = len(rows), *array.shape[:-2], rows.shape[1], cols.shape[1]
    found = np.empty(shape, array.dtype)
    for window, y, x in zip(found, rows, cols, strict=True):
        if (np.diff(y) == 1).all() and (np.diff(x) == 1).all():
            window[:] = array[..., y[0] : y[-1] + 1, x[0] : x[-1] + 1]
        else:
            window[:] = array[..., y[:, None], x]
    return found


def average_boxes(
    values: np.ndarray, size: int, mode: Literal["constant", "symmetric"] = "symmetric"
) -> np.ndarray:
    """Return the means over size x size samples along the last two axes; size is odd.

    They have the bits of `scipy.ndimage.uniform_filter`, whose import takes longer than a frame.

    mode: of `np.pad`, for samples beyond the ends.
    """
    for axis in (-2, -1) if size > 1 else ():
        wide = np.moveaxis(values, axis, 0).astype(np.float64)
        wide = np.pad(wide, ((size // 2, size // 2), *((0, 0),) * (wide.ndim - 1)), mode=mode)
        first = np.cumsum(wide[:size], axis=0)[-1:]
        sums = np.cumsum(np.concatenate([first, wide[size:] - wide[:-size]]), axis=0)
        values = np.moveaxis(sums / size, 0, axis).astype(values.dtype)
    return values


def _edges(brightness, margin, border, inner):
    """First samples of windows' inner parts along both axes; mean square and largest step to neighbours in each one.

    By some of their rows; both have the shape (parts down, parts across). A dark world around the frame is a step, too.
    """
    rows, cols = brightness.shape[0] - 2 * margin, brightness.shape[1] - 2 * margin
    starts = _starts(rows, inner), _starts(cols, inner)
    ends = [np.minimum(own + inner, n) for own, n in zip(starts, (rows, cols), strict=True)]
    chosen, highest = _chosen_rows(brightness, margin + starts[0], margin + ends[0])
    first = np.cumsum([0, *map(len, chosen[:-1])])  # row of each part in `step`
    counts = np.array([len(one) for one in chosen])
    at = np.concatenate(chosen)
    # a power of two, in the type of the values, that scales the largest to at most 1: no square overflows
    unit = brightness.dtype.type(2.0 ** -in_range(highest)[1])
    line = brightness[at] * unit
    step = brightness[np.minimum(at + 1, len(brightness) - 1)] * unit
    step -= line
    np.abs(step, out=step)
    across = np.abs(line[:, 1:] - line[:, :-1])
    np.maximum(step[:, :-1], across, out=step[:, :-1])
    np.maximum(step[:, 1:], across, out=step[:, 1:])
    step = step[:, margin : margin + cols]
    if border == "zero":
        step[:, [0, -1]] = np.maximum(step[:, [0, -1]], line[:, [0, -1]])
        last = first + counts - 1
        for edge, row in ((0, first), (rows - 1, last)):
            there = row[(starts[0] <= edge) & (edge < starts[0] + inner)]
            step[there] = np.maximum(step[there], brightness[edge] * unit)
    largest = _reduce_parts(np.maximum, step, starts[1], ends[1])
    energy = _reduce_parts(np.add, np.square(step, out=step), starts[1], ends[1])
    largest = np.maximum.reduceat(largest, first, axis=0).astype(np.float64)
    energy = np.add.reduceat(energy, first, axis=0) / counts[:, None]
    return starts, energy / (ends[1] - starts[1]), largest


def _chosen_rows(brightness, starts, ends):
    """Rows of the parts from `starts` to `ends` that are looked at, and the largest values of all rows, or all values.

    Some of them evenly, and the brightest one if it is more than twice as bright as these.
    """
    stride = max(1, round(brightness.size / MOST_STEPS))
    chosen = [np.arange(start, end, stride) for start, end in zip(starts, ends, strict=True)]
    if stride == 1:
        return chosen, brightness
    tops = brightness.max(axis=1)
    for number, (at, end) in enumerate(zip(chosen, ends, strict=True)):
        most = at[0] + int(tops[at[0] : end].argmax())
        if tops[most] > 2 * tops[at].max():
            chosen[number] = np.union1d(at, most)
    return chosen, tops


def _reduce_parts(function, lines, starts, ends):
    """Reduce parts of lines by a function, from each start to its end: (lines, parts)."""
    # without the gaps; one more value, since an end may not be beyond the last
    places = np.stack([starts, ends], axis=1).ravel()
    if places[-1] == lines.shape[1]:
        places = places[:-1]
    dtype = np.float64 if function is np.add else None
    return function.reduceat(lines, places, axis=1, dtype=dtype)[:, ::2]


def _starts(n, inner):
    """First samples of windows' inner parts that cover an axis."""
    return np.unique(np.minimum(np.arange(0, max(n, 1), inner), max(n - inner, 0)))


def _draw(energy, count):
    """Indices that are drawn, each once, and their weights; all of them if they are few.

    One is drawn after each `count`-th part of the total probability. An index that would be drawn
    more than once is certain, and the others share the other draws by their own energy: a few
    points of light do not hide darker ones.
    """
    if len(energy) <= count:
        return np.arange(len(energy)), np.ones(len(energy))
    certain = np.zeros(len(energy), bool)
    while True:
        others = np.where(certain, 0.0, energy)
        left = np.count_nonzero(~certain)
        chance = (1 - EDGES) / left + EDGES * others / max(others.sum(), 1e-300)
        share = chance / chance[~certain].sum()
        expected = np.where(certain, 1.0, share * (count - np.count_nonzero(certain)))
        if (expected <= 1).all():
            break
        certain |= expected > 1
    drawn = np.searchsorted(np.cumsum(expected), np.arange(count) + 0.5)
    return drawn, 1 / expected[drawn]


def quantile(values, weight, part):
    """Return the quantile of values (n, C, rows, cols) with weights (n, C), part >= 1 - 1 / cols.

    The largest values of each row give a lower limit, below which values are skipped.
    """
    above = (1 - part) * weight.sum() * values[0, 0].size
    least = level_above(values.max(axis=-1), weight[..., None], above)
    some = values >= least
    weight = np.broadcast_to(weight[..., None, None], values.shape)
    return float(level_above(values[some], weight[some], above))


def level_above(values, weight, above):
    """Return the value down to which, from the largest on, the weights add up to `above`."""
    weight = np.broadcast_to(weight, values.shape).ravel()
    order = np.argsort(values, axis=None)[::-1]
    last = min(np.searchsorted(np.cumsum(weight[order]), above), len(order) - 1)
    return values.ravel()[order[last]]
