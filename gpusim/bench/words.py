"""Texts of a comparison: numbers, heads and verdicts as all outputs write them."""

from math import expm1, inf
from typing import Any

import numpy as np

from gpusim.bench.compare import (
    FASTER,
    MENDED,
    NOT_JUDGED,
    OTHER_KERNELS,
    SAME,
    SLOWER,
    WRONG,
    WRONG_IN_BOTH,
    Column,
    Verdict,
)
from gpusim.bench.noise import Change

# a sign for each verdict: colours are never the only difference
SIGNS = {
    SLOWER: "▲",
    FASTER: "▼",
    SAME: "=",
    WRONG: "✗",
    WRONG_IN_BOTH: "✗",
    MENDED: "✓",
    OTHER_KERNELS: "?",
    NOT_JUDGED: "?",
}
MOST_WARNINGS = 3
NO_LIMIT = 3.0  # [log] a least visible slowdown beyond this is "none"


def format_ratio(change: float) -> str:
    """Return the ratio of times of a log, such as "x1.10"."""
    return f"x{np.exp(change):.3g}" if abs(change) > 2 else f"x{np.exp(change):.3f}"


def format_visible(change: Change | None) -> str:
    """Return the least visible slowdown in percent; "none" if no slowdown would have been found."""
    if change is None:
        return ""
    if change.visible == inf or change.visible > NO_LIMIT:
        return "none"
    percent = 100 * expm1(change.visible)
    return f"{percent:.1f} %" if percent < 10 else f"{percent:.0f} %"


def format_number(value: float | None, form: str) -> str:
    """Return a number, or "-" for None."""
    return "-" if value is None else format(value, form)


def format_share(value: float | None) -> str:
    """Return a score or `attained` in percent."""
    return "-" if value is None else f"{100 * value:.1f} %"


def short_commit(result: dict[str, Any]) -> str:
    """Return the beginning of the commit of a result, with "+" if the tree had changes."""
    return (result["commit"] or "-")[:10] + ("+" if result["dirty"] else "")


def describe_result(result: dict[str, Any]) -> str:
    """Return device, driver, commit and date of a result in one line."""
    machine = result["machine"]
    commit = f"commit {short_commit(result)}"
    named = [machine.get("device"), machine.get("driver"), commit, result["date"][:16]]
    return "; ".join([result["device"], *(str(part) for part in named if part)])


def warnings_of(result: dict[str, Any]) -> list[str]:
    """Return the first warnings of a result about its machine, and how many more there are."""
    found = [str(words) for words in result["machine"].get("warnings") or ()]
    more = len(found) - MOST_WARNINGS
    return found[:MOST_WARNINGS] + ([f"and {more} more warnings"] if more > 0 else [])


def count_verdicts(column: Column) -> str:
    """Return how many rows have each verdict, such as "1 slower, 46 same"."""
    found = [verdict.words for verdict in column.verdicts.values()]
    counts = [(words, found.count(words)) for words in SIGNS]
    return ", ".join(f"{count} {words}" for words, count in counts if count)


def describe_common(column: Column) -> str:
    """Return what all rows have in common; "" if it is not known."""
    change = column.common
    if change is None:
        return ""
    words = {0: SAME, 1: SLOWER, -1: FASTER}[change.sign]
    start = f"all rows: {words}, {format_ratio(change.change)}"
    if change.sign:
        return start
    return f"{start} (the least slowdown of all rows that is visible: {format_visible(change)})"


def explain(name: str, verdict: Verdict) -> str:
    """Return a row that is not the same in one line: its name, the verdict and why."""
    if verdict.change is None:
        return f"{verdict.words}: {name}: {verdict.reason}"
    return f"{verdict.words}: {name}: {format_ratio(verdict.change.change)}"
