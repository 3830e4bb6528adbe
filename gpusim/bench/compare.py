"""Results side by side: a verdict for each row of each result against the first one.

`gpusim.bench.noise` has the statistics. Rows are found by their names, which include the size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import expm1, log, log1p
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.bench.noise import LEAST_ROUNDS, LEAST_ROWS, PERCENTILES, Change, judge
from gpusim.bench.result import read_result
from gpusim.domain.errors import BadData, BadFile, UnknownName

SAME, FASTER, SLOWER, WRONG, MENDED = "same", "faster", "slower", "wrong", "mended"
WRONG_IN_BOTH, OTHER_KERNELS, NOT_JUDGED = "wrong in both", "other kernels", "cannot be judged"
BY_SIGN = {0: SAME, 1: SLOWER, -1: FASTER}
# exit status: of success, of a slower or wrong row, and what `git bisect run` skips
GOOD, BAD, SKIP = 0, 1, 125
LIMITS = ("copy_gbps", "fma_gflops", "launch_us")  # that floors are made of
LIMITS_DIFFER = 0.05  # [log]


@dataclass(frozen=True)
class Verdict:
    """The verdict on one row of one result.

    Attributes:
        words: One of the constants above.
        row: The row of the result; None if it has no such row.
        change: Change against the base; None if it is not judged.
        reason: Why the row is not judged, or what is wrong with it.
    """

    words: str
    row: dict[str, Any] | None
    change: Change | None = None
    reason: str = ""


@dataclass(frozen=True)
class Column:
    """One result against the base.

    Attributes:
        label: Name of the file without its folder and suffix, unique in the table.
        result: The result.
        verdicts: Row's name -> verdict.
        common: Change of the median row; None if it is not known.
        notes: Facts about the comparison, one sentence each.
    """

    label: str
    result: dict[str, Any]
    verdicts: dict[str, Verdict]
    common: Change | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Results side by side.

    Attributes:
        label: Name of the base.
        base: The result that the others are compared with.
        rows: Rows of the base by name, in its order.
        columns: The other results.
        worst: Slowdown [ratio - 1] that is accepted; None accepts no slower row.
    """

    label: str
    base: dict[str, Any]
    rows: dict[str, dict[str, Any]]
    columns: tuple[Column, ...]
    worst: float | None = None

    def is_bad(self, verdict: Verdict) -> bool:
        """Return whether a row is wrong, or slower than what is accepted."""
        if verdict.words != SLOWER or verdict.change is None or self.worst is None:
            return verdict.words in (SLOWER, WRONG)
        return expm1(verdict.change.change) >= self.worst

    def is_unknown(self, verdict: Verdict) -> bool:
        """Return whether a row is not judged, or would hide a slowdown of `worst`."""
        if verdict.words != SAME or verdict.change is None or self.worst is None:
            return verdict.words in (NOT_JUDGED, OTHER_KERNELS)
        return verdict.change.visible > log1p(self.worst)

    def status(self) -> int:
        """Return the exit status: GOOD, BAD, or SKIP if no row is bad and one is unknown."""
        verdicts = [verdict for column in self.columns for verdict in column.verdicts.values()]
        if len(self.rows) == len(self.base["rows"]):  # the user selected none
            verdicts += [
                Verdict(SLOWER, None, column.common)
                for column in self.columns
                if column.common is not None and column.common.sign > 0
            ]
        if any(self.is_bad(verdict) for verdict in verdicts):
            return BAD
        return SKIP if any(self.is_unknown(verdict) for verdict in verdicts) else GOOD


def compare_files(
    paths: Sequence[str | Path],
    names: Sequence[str] = (),
    worst: float | None = None,
    other_kernels: bool = False,
) -> Comparison:
    """Return the comparison of stored results with the first of them.

    Args:
        paths: Files of `gpusim bench run`, two or more.
        names: Names of rows, or the beginnings of names, to judge. Empty: all.
        worst: Slowdown [ratio - 1] that is accepted; None accepts no slower row.
        other_kernels: Whether to judge rows whose kernels or inputs differ.

    Raises:
        BadFile: A file is missing or is no result, or it has no row of the base.
        UnknownName: The base has no row of this name.
        BadData: There are fewer than two files.
    """
    base, *others = read_results(paths)
    label, *labels = name_files(paths)
    before = _by_name(base)
    rows = select_rows(before, names)
    for path, other in zip(paths[1:], others, strict=True):
        _check_pairs(path, paths[0], rows, _by_name(other), other_kernels)
    counts = len(rows) * len(others), len(others)
    columns = []
    for name, other in zip(labels, others, strict=True):
        column = judge_result(name, base, other, counts, other_kernels)
        verdicts = {row: column.verdicts[row] for row in rows}
        columns.append(replace(column, verdicts=verdicts))
    return Comparison(label, base, rows, tuple(columns), worst)


def read_results(paths: Sequence[str | Path]) -> list[dict[str, Any]]:
    """Return stored results, two or more. Raises BadFile, and BadData if there is one."""
    if len(paths) < 2:
        raise BadData("bench compare: one file; wanted two or more results")
    return [read_result(path) for path in paths]


def _by_name(result):
    """Return the rows of a result by name."""
    return {row["name"]: row for row in result["rows"]}


def select_rows(rows: dict[str, dict[str, Any]], names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the rows whose names begin with one of `names`, all of them without names.

    Raises:
        UnknownName: No row begins with a name.
    """
    for name in names:
        if not any(row.startswith(name) for row in rows):
            raise UnknownName("row", name, rows)
    return {
        row: each
        for row, each in rows.items()
        if not names or any(row.startswith(name) for name in names)
    }


def name_files(paths: Sequence[str | Path]) -> list[str]:
    """Return the name of each file without its suffix. Equal ones get their folder, or a number."""
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        names = [f"{Path(path).absolute().parent.name}/{Path(path).stem}" for path in paths]
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names, 1)
    ]


def _check_pairs(path, base, rows, pairs, other_kernels):
    """Raise BadFile if no row can be compared: other sizes, or other kernels."""
    common = [name for name in rows if name in pairs]
    if not common:
        sizes = " or ".join(sorted({row["size"] for row in rows.values()})[:3])
        raise BadFile(path, f"has no row of {base}; wanted a run of the same rows, size {sizes}")
    if not other_kernels and all(rows[name]["hash"] != pairs[name]["hash"] for name in common):
        raise BadFile(
            path,
            f"has other kernels or inputs than {base}; wanted results of one version of gpusim, "
            "or --other-kernels to judge them all the same",
        )


def judge_result(
    label: str,
    base: dict[str, Any],
    other: dict[str, Any],
    counts: tuple[int, int],
    other_kernels: bool = False,
) -> Column:
    """Return one result against another, for all rows.

    Rows that the user did not select are judged too: the common change and the noise are estimated
    from all of them.

    Args:
        label: Name of the column.
        base: The earlier result.
        other: The later one.
        counts: Comparisons in the whole table, and columns.
        other_kernels: Whether to judge rows whose kernels or inputs differ.
    """
    before, after = _by_name(base), _by_name(other)
    verdicts = {
        name: _without_times(row, after.get(name), other_kernels) for name, row in before.items()
    }
    usable = [name for name, verdict in verdicts.items() if verdict is None]
    common: Change | None = None
    notes: list[str] = []
    if usable:
        sides = [[rows[name]["rounds"] for name in usable] for rows in (before, after)]
        pairs = pair_rounds(sides)
        is_alternating = len(pairs) >= LEAST_ROUNDS
        if not is_alternating:
            kept = min(len(rounds) for side in sides for rounds in side)
            pairs = [(number, number) for number in range(kept)]
        before_logs, after_logs = (
            _logs(side, numbers)
            for side, numbers in zip(sides, zip(*pairs, strict=True), strict=True)
        )
        judgement = judge(before_logs, after_logs, is_alternating, *counts)
        common = judgement.common
        for name, change in zip(usable, judgement.rows, strict=True):
            verdicts[name] = Verdict(BY_SIGN[change.sign], after[name], change)
        notes += _notes(judgement, len(pairs), [len(side[0]) for side in sides], is_alternating)
    notes += _limit_notes(base["limits"], other["limits"])
    return Column(label, other, verdicts, common, tuple(notes))


def _without_times(before, after, other_kernels):
    """Return the verdict on a row that does not depend on times; None if times decide."""
    if after is None:
        return Verdict(NOT_JUDGED, None, reason="the result has no such row")
    if not after["verified"]:
        words = WRONG if before["verified"] else WRONG_IN_BOTH
        return Verdict(words, after, reason=after["failed"])
    if not before["verified"]:
        return Verdict(MENDED, after, reason=f"wrong in the base: {before['failed']}")
    if before["hash"] != after["hash"] and not other_kernels:
        return Verdict(OTHER_KERNELS, after, reason="kernels or inputs differ")
    rounds = min(len(before["rounds"]), len(after["rounds"]))
    if rounds < LEAST_ROUNDS:
        reason = f"{rounds} rounds; wanted {LEAST_ROUNDS} or more in each"
        return Verdict(NOT_JUDGED, after, reason=reason)
    return None


def pair_rounds(sides: Sequence[Sequence[Sequence[dict[str, Any]]]]) -> list[tuple[int, int]]:
    """Return the pairs of rounds that are neighbours in time, one of each side.

    A round that no round of the other side follows or precedes is in no pair.

    Args:
        sides: The rounds of all rows, of both sides.
    """
    events = []
    for side, rows in enumerate(sides):
        for number in range(min(len(rounds) for rounds in rows)):
            times = [rounds[number]["at"] for rounds in rows]
            events.append((min(times), max(times), side, number))
    events.sort()
    pairs, place = [], 0
    while place + 1 < len(events):
        (_, end, side, number), (begin, _, other, later) = events[place : place + 2]
        if side != other and end < begin:
            pairs.append((later, number) if side else (number, later))
            place += 1
        place += 1
    return pairs


def _logs(side, numbers):
    """Return logs of percentiles (percentiles, rows, rounds) of rounds of all rows."""
    return np.array(
        [
            [np.log(np.percentile(rounds[number]["ms"], PERCENTILES)) for number in numbers]
            for rounds in side
        ]
    ).transpose(2, 0, 1)


def _notes(judgement, rounds, counts, is_alternating):
    """Return sentences about how the rows were judged. counts: rounds of each side."""
    mean = "trimmed mean" if judgement.is_trimmed else "mean"
    name = "median" if judgement.percentile == 50 else f"{judgement.percentile}th percentile"
    notes = [f"{rounds} rounds: {mean} over rounds of the {name} of each"]
    if max(counts) > rounds:
        kept = "neighbours in time" if is_alternating else "the first ones"
        notes.append(f"{counts[0]} and {counts[1]} rounds, {rounds} of each are compared: {kept}")
    if not is_alternating:
        notes.append(
            "the rounds do not alternate: margins are wider, because two processes differ more "
            "than rounds of one do; run both in turns with gpusim bench run --append FILE"
        )
    if judgement.common is None:
        notes.append(f"fewer than {LEAST_ROWS} rows: what all rows have in common is not removed")
    return notes


def _limit_notes(before, after):
    """Return a sentence if limits that scores depend on differ by more than LIMITS_DIFFER."""
    found = [
        f"{key} x{after[key] / before[key]:.2f}"
        for key in LIMITS
        if before[key] and after[key] and abs(log(after[key] / before[key])) > LIMITS_DIFFER
    ]
    return (
        [f"other limits of the device, scores and shares differ: {', '.join(found)}"]
        if found
        else []
    )
