"""Comparisons and histories as one HTML page that needs no network and no script."""

from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path

import numpy as np

from gpusim.bench.compare import OTHER_KERNELS, SAME, Column, Comparison, Verdict
from gpusim.bench.history import History, ends
from gpusim.bench.style import STYLE
from gpusim.bench.words import (
    SIGNS,
    count_verdicts,
    describe_common,
    describe_result,
    explain,
    format_number,
    format_ratio,
    format_share,
    format_visible,
    short_commit,
    warnings_of,
)
from gpusim.io.atomic import atomic_path

WIDTH, HEIGHT = 120, 16  # [pixel] of a drawn change, and of a row's times
MOST_DIFFERENCES = 10  # rows in the block about a result
LEAST_RANGE, MOST_RANGE = np.log(1.25), np.log(16.0)  # of the axis of changes
LEGEND = (
    "<b>time</b>: time over the time of the base. <b>Bar</b>: the change and its margin; "
    "the line is the base, the dashed line the change of the median row. <b>sees</b>: the least "
    "slowdown of this row that would have been found with 90 % probability. <b>error</b>: relative "
    "RMS against float64. <b>attained</b>: share of the speed that the measured limits of the "
    "device allow."
)


def write_page(what: Comparison | History, path: str | Path) -> None:
    """Write a page with a comparison or a history.

    Args:
        what: The comparison or history.
        path: The file.

    Raises:
        BadFile: The file cannot be written.
    """
    if isinstance(what, History):
        title, parts = "gpusim bench: history", _history(what)
    else:
        title, parts = f"gpusim bench: against {what.label}", _comparison(what)
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body><main>"
    )
    with atomic_path(path) as temporary:
        text = "\n".join([head, f"<h1>{escape(title)}</h1>", *parts, "</main></body></html>\n"])
        temporary.write_text(text, encoding="utf-8")


def _comparison(comparison: Comparison) -> Iterator[str]:
    """Yield the parts of a page of a comparison."""
    base = comparison.base
    yield '<div class="cards">'
    yield _card(f"base: {comparison.label}", describe_result(base), (), warnings_of(base))
    for column in comparison.columns:
        facts = [
            count_verdicts(column),
            describe_common(column),
            *column.notes,
            *_differences(column),
        ]
        about = describe_result(column.result)
        yield _card(column.label, about, facts, warnings_of(column.result))
    yield f'</div><p class="legend">{LEGEND}</p><div class="scroll"><table><thead><tr>'
    yield f'<th rowspan="2">row</th><th colspan="3">{escape(comparison.label)}</th>'
    for column in comparison.columns:
        yield f'<th class="first" colspan="7">{escape(column.label)}</th>'
    yield "</tr><tr><th>ms</th><th>error</th><th>attained</th>"
    heads = ("verdict", "ms", "time", "", "sees", "error", "attained")
    for _ in comparison.columns:
        yield '<th class="first">' + "</th><th>".join(heads) + "</th>"
    yield "</tr></thead>"
    span = _range(comparison)
    for family in dict.fromkeys(row["family"] for row in comparison.rows.values()):
        yield f"<tbody>{_family(comparison, family)}"
        for name, row in comparison.rows.items():
            if row["family"] != family:
                continue
            cells = [_base_cells(row)]
            for column in comparison.columns:
                cells.append(_cells(column, column.verdicts[name], span))
            yield f'<tr><th scope="row">{escape(name)}</th>{"".join(cells)}</tr>'
        yield "</tbody>"
    if "all" in base["scores"]:
        yield f"<tbody>{_family(comparison, 'all')}</tbody>"
    yield "</table></div>"


def _differences(column: Column) -> list[str]:
    """Return the rows that are not the same: wrong ones first, then the largest changes."""
    found = [
        (abs(verdict.change.change) if verdict.change else float("inf"), name, verdict)
        for name, verdict in column.verdicts.items()
        if verdict.words not in (SAME, OTHER_KERNELS)
    ]
    found.sort(key=lambda each: -each[0])
    lines = [f"{SIGNS[verdict.words]} {explain(name, verdict)}" for _, name, verdict in found]
    more = len(lines) - MOST_DIFFERENCES
    return lines[:MOST_DIFFERENCES] + ([f"and {more} more rows"] if more > 0 else [])


def _card(title: str, about: str, facts: Iterable[str], warnings: Iterable[str]) -> str:
    """Return a block about one result."""
    lines = [f"<li>{escape(fact)}</li>" for fact in facts if fact]
    lines += [f'<li class="warning">! {escape(words)}</li>' for words in warnings]
    body = f"<ul>{''.join(lines)}</ul>" if lines else ""
    return f"<section><h2>{escape(title)}</h2><p>{escape(about)}</p>{body}</section>"


def _family(comparison: Comparison, family: str) -> str:
    """Return the row with the scores of a family."""
    cells = [f'<td colspan="3">{format_share(comparison.base["scores"].get(family))}</td>']
    for column in comparison.columns:
        score = format_share(column.result["scores"].get(family))
        cells.append(f'<td class="first" colspan="7">{score}</td>')
    return f'<tr class="family"><th scope="row">score {escape(family)}</th>{"".join(cells)}</tr>'


def _base_cells(row: dict) -> str:
    """Return the cells of a row of the base."""
    if not row["verified"]:
        return f'<td colspan="3" class="wrong" title="{escape(row["failed"])}">wrong</td>'
    return (
        f"<td>{row['ms_p50']:.3f}</td><td>{format_number(row.get('rel_rms_error'), '.1e')}</td>"
        f"<td>{format_share(row['attained'])}</td>"
    )


def _cells(column: Column, verdict: Verdict, span: float) -> str:
    """Return the cells of a row of one result."""
    kind = verdict.words.replace(" ", "-")
    words = f"{SIGNS[verdict.words]} {escape(verdict.words)}"
    badge = f'<span class="badge {kind}">{words}</span>'
    row, change = verdict.row, verdict.change
    if row is None or not row["verified"]:
        return f'<td class="first">{badge}</td><td colspan="6" class="why">{escape(verdict.reason)}</td>'
    figures = (
        f"<td>{format_number(row.get('rel_rms_error'), '.1e')}</td>"
        f"<td>{format_share(row['attained'])}</td>"
    )
    start = f'<td class="first">{badge}</td><td>{row["ms_p50"]:.3f}</td>'
    if change is None:
        return f'{start}<td colspan="3" class="why">{escape(verdict.reason)}</td>{figures}'
    common = None if column.common is None else column.common.change
    drawn = _draw_change(change.change, change.margin, common, span, kind)
    times = f"<td>{format_ratio(change.change)}</td><td>{drawn}</td>"
    return f"{start}{times}<td>{format_visible(change)}</td>{figures}"


def _range(comparison: Comparison) -> float:
    """Return half the range of the axis of changes, a log: all changes and most margins fit."""
    changes = [
        verdict.change
        for column in comparison.columns
        for verdict in column.verdicts.values()
        if verdict.change is not None
    ]
    if not changes:
        return float(LEAST_RANGE)
    largest = max(abs(change.change) for change in changes)
    margin = float(np.median([change.margin for change in changes]))
    return float(np.clip(1.1 * (largest + margin), LEAST_RANGE, MOST_RANGE))


def _draw_change(change: float, margin: float, common: float | None, span: float, kind: str) -> str:
    """Return a drawing of a change with its margin. Ends beyond the axis are cut."""

    def place(log):
        return WIDTH / 2 * (1 + float(np.clip(log / span, -1, 1)))

    left, right, middle = place(change - margin), place(change + margin), HEIGHT / 2
    dashes = ""
    if common is not None:
        x = place(common)
        dashes = f'<line class="common" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{HEIGHT}"/>'
    words = f"{format_ratio(change - margin)} to {format_ratio(change + margin)}"
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="{words}"><title>{words}</title>'
        f'<line class="base" x1="{WIDTH / 2}" x2="{WIDTH / 2}" y1="0" y2="{HEIGHT}"/>{dashes}'
        f'<g class="{kind}"><line class="margin" x1="{left:.1f}" x2="{right:.1f}" '
        f'y1="{middle}" y2="{middle}"/><circle cx="{place(change):.1f}" cy="{middle}" r="4"/></g></svg>'
    )


def _history(history: History) -> Iterator[str]:
    """Yield the parts of a page of a history."""
    families = list(history.results[-1]["scores"])
    yield f'<p>{escape(describe_result(history.results[-1]))}</p><div class="scroll"><table>'
    heads = "".join(f"<th>{escape(family)}</th>" for family in families)
    yield f"<thead><tr><th>result</th><th>date</th><th>commit</th>{heads}<th>against the one before</th>"
    yield "</tr></thead><tbody>"
    steps = ("", *(count_verdicts(step) for step in history.steps))
    for label, result, words in zip(history.labels, history.results, steps, strict=True):
        scores = "".join(
            f"<td>{format_share(result['scores'].get(name))}</td>" for name in families
        )
        start = f'<tr><th scope="row">{escape(label)}</th><td>{escape(result["date"][:16])}</td>'
        yield f'{start}<td>{escape(short_commit(result))}</td>{scores}<td class="why">{words}</td></tr>'
    yield '</tbody></table></div><h2>Rows</h2><div class="scroll"><table><thead><tr><th>row</th>'
    yield "<th>first ms</th><th>last ms</th><th>time</th><th></th><th>steps</th></tr></thead><tbody>"
    for name in history.rows:
        times = history.times(name)
        figures = "".join(f"<td>{text}</td>" for text in ends(times))
        events = escape("; ".join(history.events(name)))
        start = f'<tr><th scope="row">{escape(name)}</th>{figures}<td>{_draw_times(times)}</td>'
        yield f'{start}<td class="why">{events}</td></tr>'
    yield "</tbody></table></div>"


def _draw_times(times: list[float | None]) -> str:
    """Return a drawing of the times of a row, on a logarithmic axis of a factor of 1.25 or more."""
    known = [(place, np.log(time)) for place, time in enumerate(times) if time is not None]
    if not known:
        return ""
    logs = [log for _, log in known]
    middle, span = (max(logs) + min(logs)) / 2, max(max(logs) - min(logs), float(LEAST_RANGE))
    across = (WIDTH - 8) / max(len(times) - 1, 1)
    points = [
        (4 + across * place, HEIGHT / 2 - (HEIGHT - 6) * (log - middle) / span)
        for place, log in known
    ]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    x, y = points[-1]
    words = f"{np.exp(min(logs)):.3f} to {np.exp(max(logs)):.3f} ms"
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="{words}"><title>{words}</title>'
        f'<g class="{SAME}"><polyline points="{line}"/><circle cx="{x:.1f}" cy="{y:.1f}" r="2.5"/></g></svg>'
    )
