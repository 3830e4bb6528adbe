"""Levels of a photon transfer line from pairs of frames of static scenes."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.progress import announced
from gpusim.fit.intervals import Range
from gpusim.fit.levels import Level
from gpusim.fit.scene_stack import SHOOT_PAIRS, SceneStack, line_range
from gpusim.fit.sorting import Summary


def read_scenes(
    groups: Sequence[Sequence[Summary]], done: Iterator[int], total: int
) -> tuple[list[Level], Range, Range]:
    """Return the levels of static scenes, and the temporal variances of rows and columns [DN^2].

    Args:
        groups: Two frames or more of one scene at one exposure each.
        done: Counter of frames of all groups.
        total: Number of frames of all groups.

    Returns:
        Levels, one for each group of pixels, and variances of rows and of columns.

    Raises:
        BadData: A scene moved or its light changed, or frames are too small or clipped.
    """
    levels: list[Level] = []
    rows, columns = [], []
    ceilings: dict[str, float] = {}
    # the brightest first: it says where values end
    for group in sorted(groups, key=lambda group: -group[0].mean):
        frame = group[0].frame
        stack = SceneStack(frame.cfa)
        for one in group:
            with announced(f"measuring {one.frame.name}, {next(done)} of {total} frames measured"):
                stack.add(one.shot.read().values, one.frame.name)
        white = frame.white_level if frame.white_level is not None else math.inf
        for letter, top in stack.tops.items():
            ceilings[letter] = min(max(ceilings.get(letter, -math.inf), top), white)
        points = stack.groups(ceilings, _black_offsets(frame))
        for number in range(max((len(one) for one in points.values()), default=0)):
            chosen = {letter: one[number] for letter, one in points.items() if number < len(one)}
            levels.append(_level(chosen, group, stack))
        rows += stack.rows
        columns += stack.columns
    if not levels:
        name = groups[0][0].frame.name
        raise BadData(f"{name}: too few pixels that are not clipped; {SHOOT_PAIRS}")
    return levels, line_range(rows), line_range(columns)


def _black_offsets(frame):
    """Return the stated black level of each letter less their mean, 0 if there is none."""
    letters = "".join(frame.cfa)
    black = frame.black_level
    if black is None or black.size != len(letters):
        return dict.fromkeys(letters, 0.0)
    values = black.ravel() - black.mean()
    return {
        letter: float(np.mean([v for v, one in zip(values, letters, strict=True) if one == letter]))
        for letter in dict.fromkeys(letters)
    }


def _level(points, group, stack):
    """Return groups of pixels, one of each channel, as a level without spatial numbers."""
    frame = group[0].frame
    return Level(
        points,
        frame.iso,
        frame.exposure_time,
        frame.temperature,
        None,
        stack.count,
        tuple(stack.names),
        stack.highest,
        0.0,
        np.empty((0, 0)),
        [],
        ([], []),
        np.empty((0, 0)),
        np.empty((0, 0)),
        None,
        None,
        None,
        stack.mean.shape,
    )
