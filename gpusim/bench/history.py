"""Results of one device over time: scores, times, and the steps between them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from gpusim.bench.compare import Column, judge_result, name_files, read_results, select_rows
from gpusim.bench.words import count_verdicts, format_ratio, format_share, short_commit
from gpusim.domain.errors import BadFile

PLACE = ("cpu", "device")  # keys of a machine that must not change


@dataclass(frozen=True)
class History:
    """Results of one device by date.

    Attributes:
        labels: Names of the files.
        results: The results.
        rows: Names of rows, each in at least one result.
        steps: Each result but the first, judged against the one before it.
    """

    labels: tuple[str, ...]
    results: tuple[dict[str, Any], ...]
    rows: tuple[str, ...]
    steps: tuple[Column, ...]

    def times(self, name: str) -> list[float | None]:
        """Return the median time of a row in each result [ms]; None without one."""
        rows = [find_row(result, name) for result in self.results]
        return [row["ms_p50"] if row and row["verified"] else None for row in rows]

    def events(self, name: str) -> list[str]:
        """Return what happened to a row, such as "slower x1.12 at b"."""
        found = []
        for before, step in zip(self.results, self.steps, strict=False):
            verdict, old = step.verdicts.get(name), find_row(before, name)
            if verdict is None or verdict.row is None:
                continue
            words = []
            if verdict.change is not None and verdict.change.sign:
                words.append(f"{verdict.words} {format_ratio(verdict.change.change)}")
            elif verdict.change is None:
                words.append(verdict.words)
            if old and old["hash"] != verdict.row["hash"]:
                words.append("other kernels")
            if words:
                found.append(f"{', '.join(words)} at {step.label}")
        return found


def find_row(result: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Return the row of a result with this name, or None."""
    return next((row for row in result["rows"] if row["name"] == name), None)


def read_history(paths: Sequence[str | Path], names: Sequence[str] = ()) -> History:
    """Return stored results by date.

    Args:
        paths: Files of `gpusim bench run`, two or more.
        names: Names of rows, or the beginnings of names. Empty: all.

    Raises:
        BadFile: A file is missing or is no result, has no date, or is of another machine.
        UnknownName: No result has a row of this name.
        BadData: There are fewer than two files.
    """
    read = [
        (_read_date(path, result), label, result)
        for path, label, result in zip(paths, name_files(paths), read_results(paths), strict=True)
    ]
    _check_place(paths, [result for _, _, result in read])
    read.sort(key=lambda each: each[0])
    labels = [label for _, label, _ in read]
    results = [result for _, _, result in read]
    all_rows = {row["name"]: row for result in results for row in result["rows"]}
    rows = tuple(select_rows(all_rows, names))
    if not rows:
        raise BadFile(paths[0], "has no row, and neither have the others; wanted a run with rows")
    counts = len(rows) * (len(results) - 1), len(results) - 1
    steps = []
    for label, before, after in zip(labels[1:], results, results[1:], strict=False):
        step = judge_result(label, before, after, counts, other_kernels=True)
        kept = {name: verdict for name, verdict in step.verdicts.items() if name in rows}
        steps.append(replace(step, verdicts=kept))
    return History(tuple(labels), tuple(results), rows, tuple(steps))


def _read_date(path, result):
    """Return the time of a result."""
    try:
        return datetime.fromisoformat(result["date"]).timestamp()
    except ValueError:
        raise BadFile(path, f'"date" is {result["date"]!r}; wanted an ISO 8601 date') from None


def _check_place(paths, results):
    """Raise BadFile if a result is of another machine than the first one."""
    for path, result in zip(paths, results, strict=True):
        for key in PLACE:
            first, this = results[0]["machine"].get(key), result["machine"].get(key)
            if first != this:
                raise BadFile(
                    path, f"{key} {this!r} is not {first!r} of {paths[0]}; wanted one machine"
                )


def history_lines(history: History) -> Iterator[str]:
    """Yield the lines of the table: a line for each result, then a line for each row.

    Args:
        history: The history.
    """
    families = list(history.results[-1]["scores"])
    width = max(len(label) for label in history.labels)
    scores = " ".join(f"{family[:10]:>10s}" for family in families)
    yield f"{'result':{width}s} {'date':16s} {'commit':11s} {scores}  against the one before"
    steps = ("", *(count_verdicts(step) for step in history.steps))
    for label, result, words in zip(history.labels, history.results, steps, strict=True):
        scores = " ".join(f"{format_share(result['scores'].get(name)):>10s}" for name in families)
        start = f"{label:{width}s} {result['date'][:16]:16s} {short_commit(result):11s}"
        yield f"{start} {scores}  {words}".rstrip()
    yield ""
    width = max(len(name) for name in history.rows)
    yield f"{'row':{width}s} {'first ms':>9s} {'last ms':>9s} {'time':>7s}  steps"
    for name in history.rows:
        first, last, ratio = ends(history.times(name))
        yield f"{name:{width}s} {first:>9s} {last:>9s} {ratio:>7s}  {'; '.join(history.events(name))}".rstrip()


def ends(times: Sequence[float | None]) -> tuple[str, str, str]:
    """Return the first and the last time [ms] and their ratio as text; "-" if there is none."""
    known = [time for time in times if time is not None]
    if not known:
        return "-", "-", "-"
    return f"{known[0]:.3f}", f"{known[-1]:.3f}", f"x{known[-1] / known[0]:.3f}"
