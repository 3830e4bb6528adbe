"""Sensitivities: how much each varied key changes each measure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.domain.short_repr import short_repr

LEAST = 8  # rows
MOST_GROUPS = 20  # of a key's values, for the main effect
REPEATED = 3  # times that equal values occur to be a group


@dataclass(frozen=True)
class Sensitivity:
    """The effect of one key on one measure in one scene. A figure that is not defined is NaN.

    Args:
        measure: Name of the measure.
        scene: Name of the scene.
        key: The varied key.
        regression: Standardised coefficient of the linear regression on all keys: change of the measure, in its
            standard deviations, per standard deviation of the key.
        rank: Rank correlation of key and measure (Spearman).
        main: Part of the measure's variance that this key causes by itself, linear or not (correlation ratio).
        slope: Change of the measure per unit of the key with all other keys in the middle ("one-at-a-time").
        explained: Part of the variance that the linear regression explains (R squared).
    """

    measure: str
    scene: str
    key: str
    regression: float = math.nan
    rank: float = math.nan
    main: float = math.nan
    slope: float = math.nan
    explained: float = math.nan

    __repr__ = short_repr


def find_sensitivities(
    measure: str, scene: str, keys: dict[str, Sequence], values: np.ndarray
) -> list[Sensitivity]:
    """Return the effect of each key on a measure of a sample or a grid of cameras.

    Args:
        measure: Its name.
        scene: Name of the scene.
        keys: The values of each key, N each.
        values: The measure (N,); NaN if it could not be measured.
    """
    known = np.isfinite(values)
    values = values[known]
    if len(values) < LEAST or values.std() == 0:
        return [Sensitivity(measure, scene, key) for key in keys]
    numbers = {
        key: np.array([one for one, is_known in zip(given, known, strict=True) if is_known], float)
        for key, given in keys.items()
        if all(isinstance(one, int | float) and not isinstance(one, bool) for one in given)
    }
    varied = {key: given for key, given in numbers.items() if given.std() > 0}
    slopes, explained = _regress(varied, values)
    found = []
    for key, given in keys.items():
        kept = [one for one, is_known in zip(given, known, strict=True) if is_known]
        found.append(
            Sensitivity(
                measure,
                scene,
                key,
                slopes.get(key, math.nan),
                _correlate_ranks(varied[key], values) if key in varied else math.nan,
                _main_effect(kept, values),
                explained=explained,
            )
        )
    return found


def find_slopes(
    measure: str, scene: str, points: dict[str, list[tuple[float, float]]]
) -> list[Sensitivity]:
    """Return the least-squares slope of a measure along each key.

    Args:
        measure: Its name.
        scene: Name of the scene.
        points: Values of the key and of the measure, by key.
    """
    found = []
    for key, given in points.items():
        pairs = np.array([pair for pair in given if np.isfinite(pair).all()], float).reshape(-1, 2)
        slope = math.nan
        if len(pairs) > 1 and pairs[:, 0].std() > 0:
            away = pairs - pairs.mean(axis=0)
            slope = float(away[:, 0] @ away[:, 1] / (away[:, 0] @ away[:, 0]))
        found.append(Sensitivity(measure, scene, key, slope=slope))
    return found


def _regress(varied, values):
    """Return standardised regression coefficients by key, and R squared."""
    if not varied or len(values) <= len(varied) + 1:
        return {}, math.nan
    table = np.stack([(one - one.mean()) / one.std() for one in varied.values()], axis=1)
    target = (values - values.mean()) / values.std()
    slopes = np.linalg.lstsq(table, target, rcond=None)[0]
    rest = target - table @ slopes
    explained = 1 - float(rest @ rest) / len(rest)
    return dict(zip(varied, map(float, slopes), strict=True)), explained


def _correlate_ranks(given, values):
    """Return Spearman's rank correlation, with mean ranks of equal values."""
    ranks = [_rank(one) - (len(one) - 1) / 2 for one in (given, values)]
    size = math.sqrt(float(ranks[0] @ ranks[0]) * float(ranks[1] @ ranks[1]))
    return float(ranks[0] @ ranks[1]) / size if size else math.nan


def _rank(values):
    """Return the ranks of values from 0; equal values have their mean rank."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - (counts + 1) / 2)[place]


def _main_effect(given, values):
    """Return the correlation ratio, corrected for chance: 1 - (variance within groups) / (variance).

    Equal values of the key are a group, or neighbouring ones if there are many different ones.
    """
    names = sorted(set(map(repr, given)))
    is_repeated = REPEATED * len(names) <= len(given)
    if (is_repeated and len(names) <= MOST_GROUPS) or not all(
        isinstance(one, int | float) for one in given
    ):
        group = np.array([names.index(repr(one)) for one in given])
    else:
        groups = min(MOST_GROUPS, max(2, round(math.sqrt(len(values)))))
        group = (_rank(np.array(given, float)) * groups / len(values)).astype(int)
    counts = np.bincount(group)
    counts, size = counts[counts > 0], len(values)
    if len(counts) < 2 or size <= len(counts):
        return math.nan
    sums = np.bincount(group, values - values.mean())
    between = float((sums[np.bincount(group) > 0] ** 2 / counts).sum())
    within = float(((values - values.mean()) ** 2).sum()) - between
    total = values.var() * size
    return max(0.0, 1 - (within / (size - len(counts))) / (total / (size - 1)))
