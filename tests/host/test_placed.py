"""Bounds of samples through a grid of places, against the place of every pixel."""

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator

from gpusim.optics.placed import Placed, find_box


def _places(nodes, shape):
    """Row and column offsets at each pixel: cubics through the four nearest nodes, in float64."""
    for axis, size in enumerate(shape):
        count = nodes.shape[axis]
        at = (np.arange(size) + 0.5) * (count - 1) / size
        first = np.clip(np.floor(at) - 1, 0, count - 4).astype(int)
        moved = np.moveaxis(nodes, axis, 0)
        rows = [
            BarycentricInterpolator(np.arange(4.0), moved[f : f + 4])(t - f)
            for f, t in zip(first, at, strict=True)
        ]
        nodes = np.moveaxis(np.stack(rows), 0, axis)
    return nodes


def _taken(place, size, fold):
    """The samples that cubics take around places, folded at the border of a source: one array for each of four."""
    every = np.floor(place).astype(int)[..., None] + np.arange(-1, 3)
    if fold == "edge":
        return every.clip(0, size - 1)
    every = every % (2 * size)
    return np.minimum(every, 2 * size - 1 - every)


@pytest.mark.parametrize("fold", ["edge", "reflect"])
@pytest.mark.parametrize(("shape", "source"), [((61, 83), (61, 83)), ((40, 90), (70, 55))])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_hold_all_that_is_taken_and_little_more(fold, shape, source, seed):
    random = np.random.default_rng(seed)
    count = random.integers(4, 9, 2)
    rows, cols = (np.linspace(0, n, c) - 0.5 for n, c in zip(shape, count, strict=True))
    wanted = np.stack(
        np.broadcast_arrays(
            (rows * (source[0] / shape[0]))[:, None] + random.uniform(-9, 9),
            cols * (source[1] / shape[1]) + random.uniform(-9, 9),
        ),
        axis=-1,
    )
    nodes = wanted - np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
    nodes += random.uniform(-2, 2, nodes.shape)
    offsets = _places(nodes, shape)
    taken = [
        _taken(
            offsets[..., axis] + np.arange(n).reshape((-1, 1) if axis == 0 else (1, -1)), s, fold
        )
        for axis, (n, s) in enumerate(zip(shape, source, strict=True))
    ]
    placed = Placed(np.concatenate([nodes, nodes[..., :1]], axis=-1), shape, source)
    for _ in range(20):
        part = tuple(
            slice(a, b) for a, b in (np.sort(random.choice(n + 1, 2, False)) for n in shape)
        )
        found = placed.find_sources(part)
        for axis in (0, 1):
            own = taken[axis][part]
            assert found[axis].start <= own.min()
            assert found[axis].stop > own.max()
        lit = tuple(
            slice(a, b) for a, b in (np.sort(random.choice(n + 1, 2, False)) for n in source)
        )
        takes = np.ones(shape, bool)
        for axis, one in enumerate(lit):
            takes &= ((taken[axis] >= one.start) & (taken[axis] < one.stop)).any(axis=-1)
        seen = np.zeros(shape, bool)
        seen[placed.find_window(lit)] = True
        assert not (takes & ~seen).any()
    assert placed.find_window((slice(0, 0), slice(0, 0))) == (slice(0, 0), slice(0, 0))


def test_a_small_lit_part_has_a_small_window():
    nodes = np.zeros((9, 9, 3))
    placed = Placed(nodes, (800, 800), (800, 800))
    rows, cols = placed.find_window((slice(395, 405), slice(10, 20)))
    # cells between nodes have 100 pixels, and one more for a pixel that two of them share
    assert 299 <= rows.start <= 395
    assert 405 <= rows.stop <= 501
    assert cols.start == 0
    assert 20 <= cols.stop <= 101


def test_box_holds_all_values():
    values = np.zeros((7, 9))
    assert find_box(values) == (slice(0, 0), slice(0, 0))
    values[2, 3] = values[5, 4] = 1
    assert find_box(values) == (slice(2, 6), slice(3, 5))
