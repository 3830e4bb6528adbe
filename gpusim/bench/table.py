"""Comparisons as a table for the terminal."""

from collections.abc import Iterator

from gpusim.bench.compare import OTHER_KERNELS, SAME, Column, Comparison, Verdict
from gpusim.bench.words import (
    count_verdicts,
    describe_common,
    describe_result,
    explain,
    format_number,
    format_ratio,
    format_share,
    format_visible,
    warnings_of,
)

BASE_HEAD = f"{'ms':>9s} {'error':>8s} {'attained':>8s}"
HEAD = f"{'ms':>9s} {'time':>7s} {'verdict':14s} {'sees':>7s} {'error':>8s} {'attained':>8s}"


def lines(comparison: Comparison) -> Iterator[str]:
    """Yield the lines of the table: results, rows, scores, and the rows that are not the same.

    Args:
        comparison: The comparison.
    """
    yield f"base {comparison.label}: {describe_result(comparison.base)}"
    yield from (f"  warning: {words}" for words in warnings_of(comparison.base))
    for column in comparison.columns:
        yield f"{column.label}: {describe_result(column.result)}"
        yield from (f"  {words}" for words in column.notes)
        yield from (f"  warning: {words}" for words in warnings_of(column.result))
    yield ""
    width = max(len(name) for name in [*comparison.rows, *_families(comparison), "score all"])
    heads = [f"{column.label[: len(HEAD)]:{len(HEAD)}s}" for column in comparison.columns]
    base = f"{comparison.label[: len(BASE_HEAD)]:{len(BASE_HEAD)}s}"
    yield " | ".join([" " * width, base, *heads]).rstrip()
    yield " | ".join([f"{'':{width}s}", BASE_HEAD, *[HEAD] * len(heads)])
    for name, row in comparison.rows.items():
        cells = [_cell(column.verdicts[name]) for column in comparison.columns]
        yield " | ".join([f"{name:{width}s}", _figures(row), *cells]).rstrip()
    for family in _families(comparison):
        scores = [column.result["scores"].get(family) for column in comparison.columns]
        cells = [f"{format_share(score):>{len(HEAD)}s}" for score in scores]
        base = f"{format_share(comparison.base['scores'].get(family)):>{len(BASE_HEAD)}s}"
        yield " | ".join([f"{'score ' + family:{width}s}", base, *cells])
    yield ""
    for column in comparison.columns:
        yield from _summary(column)


def _families(comparison):
    """Return the families that have a score, "all" last."""
    return list(comparison.base["scores"])


def _figures(row):
    """Return the time, the error and the share attained of a row without a verdict."""
    if not row["verified"]:
        return f"{'wrong':{len(BASE_HEAD)}s}"
    error = format_number(row.get("rel_rms_error"), ".1e")
    return f"{row['ms_p50']:9.3f} {error:>8s} {format_share(row['attained']):>8s}"


def _cell(verdict: Verdict) -> str:
    """Return the cell of one row of one result."""
    row, change = verdict.row, verdict.change
    if row is None or not row["verified"]:
        return f"{'':9s} {'':7s} {verdict.words:{len(HEAD) - 18}s}"
    time = "" if change is None else format_ratio(change.change)
    error = format_number(row.get("rel_rms_error"), ".1e")
    return (
        f"{row['ms_p50']:9.3f} {time:>7s} {verdict.words:14s} {format_visible(change):>7s} "
        f"{error:>8s} {format_share(row['attained']):>8s}"
    )


def _summary(column: Column) -> Iterator[str]:
    """Yield the result of one column, and a line for each row that is not the same."""
    yield f"{column.label}: {count_verdicts(column)}"
    if common := describe_common(column):
        yield f"  {common}"
    quiet = (SAME, OTHER_KERNELS)
    for name, verdict in column.verdicts.items():
        if verdict.words not in quiet:
            yield f"  {explain(name, verdict)}"
    others = sum(verdict.words == OTHER_KERNELS for verdict in column.verdicts.values())
    if others:
        yield f"  {OTHER_KERNELS}: {others} rows; --other-kernels judges them all the same"
