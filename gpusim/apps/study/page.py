"""The page of a study: one HTML file with plots that needs no network and no script."""

import math
from collections.abc import Iterable, Iterator
from html import escape
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from gpusim.apps.study.requirements import CONFIDENCE
from gpusim.apps.study.svg import histogram, scatter

if TYPE_CHECKING:
    from gpusim.apps.study.run import Study

MOST_ERRORS = 20  # rows with errors that are listed
MOST_KEYS = 12  # of which scatter plots are drawn for each measure
QUANTILES = (0.05, 0.5, 0.95)
STYLE = """
:root { color-scheme: light dark; --page: #fff; --text: #1b1f26; --quiet: #5b6470; --line: #d9dde3;
  --mark: #1d4ed8; --limit: #b4380b; --panel: #f5f6f8; }
@media (prefers-color-scheme: dark) { :root { --page: #14171c; --text: #e6e9ee; --quiet: #a2abb8;
  --line: #353c47; --mark: #8ab4ff; --limit: #ff9466; --panel: #1e232b; } }
body { margin: 0 auto; padding: 24px; max-width: 84rem; background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
h3 { font-size: 1rem; margin: 1.25rem 0 .25rem; }
p { max-width: 90ch; } .quiet { color: var(--quiet); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 12px 3px 0; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
.plots { display: flex; flex-wrap: wrap; gap: 8px; }
svg { max-width: 100%; height: auto; } svg text { font-size: 10px; fill: var(--quiet); }
svg .axes { fill: none; stroke: var(--line); } svg .bars { fill: var(--mark); opacity: .75; }
svg .dots { fill: var(--mark); opacity: .5; }
svg .limit { stroke: var(--limit); stroke-width: 1.5; stroke-dasharray: 4 3; }
pre { background: var(--panel); padding: 12px; overflow-x: auto; font-size: 13px; }
"""
METHODS = {
    "latin": "Latin hypercube",
    "montecarlo": "Monte Carlo",
    "grid": "all combinations",
    "one-at-a-time": "one key at a time",
}


def study_page(made: "Study") -> str:
    """Return the page of a study. The same table gives the same page."""
    title = escape(made.design.name)
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{STYLE}</style></head><body><main><h1>{title}</h1>",
        *_about(made),
        *_yields(made),
        *_measures(made),
        *_sensitivities(made),
        *_errors(made),
        "<h2>Study file</h2><p class='quiet'>gpusim study makes this page again from this file.</p>",
        f"<pre>{escape(made.design.text)}</pre></main></body></html>\n",
    ]
    return "\n".join(parts)


def _about(made) -> Iterator[str]:
    design = made.design
    cameras, scenes, seeds = len(design.sampling), list(design.places), len(design.seeds)
    words = (
        f"{cameras} cameras ({METHODS[design.sampling.method]}) in {len(scenes)} "
        f"scene{'s' if len(scenes) > 1 else ''} ({', '.join(scenes)})"
    )
    if seeds > 1:
        words += f" with {seeds} seeds of the noise each"
    failed = len(made.errors)
    words += f": {len(made.rows)} rows, {failed or 'none'} with an error."
    yield f"<p>{escape(words)} Base camera: {escape(design.varied.base.name)}.</p>"


def _yields(made) -> Iterator[str]:
    if not made.yields:
        return
    yield "<h2>Yield</h2>"
    rows = []
    for one in made.yields:
        cells = [one.words, f"{one.passed} of {one.count}", f"{100 * one.share:.2f} %"]
        for interval in (one.exact, one.wilson):
            words = "" if interval is None else " .. ".join(f"{100 * end:.2f}" for end in interval)
            cells.append(words and f"{words} %")
        rows.append(cells)
    yield _table(("requirement", "cameras", "yield", "Clopper-Pearson", "Wilson"), rows)
    words = (
        "A camera meets a requirement if it does in each of its rows; one with an error does not. "
    )
    if made.design.sampling.is_random:
        words += (
            f"Intervals of {100 * CONFIDENCE:g} % confidence, of cameras drawn independently; a Latin "
            "hypercube is usually more precise."
        )
    else:
        words += "These cameras are no random sample: the share is no estimate of a production."
    yield f"<p class='quiet'>{words}</p>"


def _measures(made) -> Iterator[str]:
    yield "<h2>Measures</h2>"
    rows, plots = [], []
    for one, scene, values in _each(made):
        known = values[np.isfinite(values)]
        ends = [f"{end:.4g}" for end in np.quantile(known, QUANTILES)] if len(known) else [""] * 3
        rows.append([f"{one.name} in {scene}", one.unit, str(len(known)), *ends])
        if len(known):
            plots.append(histogram(known, _label(one, scene), _limits(made, one, scene)))
    heads = ("measure", "unit", "values", *(f"{100 * one:g} %" for one in QUANTILES))
    yield _table(heads, rows)
    yield f"<div class='plots'>{''.join(plots)}</div>"


def _sensitivities(made) -> Iterator[str]:
    keys = made.design.sampling.keys
    if not made.sensitivities:
        return
    yield "<h2>Sensitivities</h2>"
    if made.design.sampling.method == "one-at-a-time":
        yield (
            "<p class='quiet'>Slope: change of the measure per unit of the key, with all other keys in the "
            "middle of their range.</p>"
        )
        heads = ["measure", "key", "slope"]
        rows = [
            [f"{one.measure} in {one.scene}", one.key, _figure(one.slope, "{:.4g}")]
            for one in made.sensitivities
        ]
    else:
        yield (
            "<p class='quiet'>Regression: standard deviations of the measure per standard deviation of the key. "
            "Rank: correlation of the ranks (Spearman). Both are near 0 if a key has its best value in the middle. "
            "Main effect: part of the measure's variance that the key causes by itself, linear or not. "
            f"{_chance(len(made.design.sampling))}</p>"
        )
        heads = ["measure", "key", "regression", "rank", "main effect", "R² of the regression"]
        rows = [
            [
                f"{one.measure} in {one.scene}",
                one.key,
                *(_figure(value) for value in (one.regression, one.rank, one.main, one.explained)),
            ]
            for one in made.sensitivities
        ]
    yield _table(heads, rows)
    for one, scene, values in _each(made):
        known = np.isfinite(values)
        if not known.any():
            continue
        own = [row for row in made.rows if row["scene"] == scene]
        yield f"<h3>{escape(one.name)} in {escape(scene)}</h3><div class='plots'>"
        for key in list(keys)[:MOST_KEYS]:
            places = [row[key] for row, is_known in zip(own, known, strict=True) if is_known]
            yield scatter(places, values[known], key, _label(one, ""), _limits(made, one, scene))
        yield "</div>"


def _chance(count):
    """Return in words how large the figures of a key without effect are."""
    if count < 3:
        return ""
    share = NormalDist().inv_cdf((1 + CONFIDENCE) / 2) / math.sqrt(count - 1)
    return (
        f"Regression and rank of a key without effect are within ± {share:.2f} in {100 * CONFIDENCE:g} % of studies "
        f"of {count} cameras."
    )


def _errors(made) -> Iterator[str]:
    if not made.errors:
        return
    yield "<h2>Errors</h2>"
    rows = [[str(number), words] for number, words in made.errors[:MOST_ERRORS]]
    yield _table(("row", "error"), rows)
    more = len(made.errors) - MOST_ERRORS
    if more > 0:
        yield f"<p class='quiet'>and {more} more; the table has them all</p>"


def _each(made) -> Iterator[tuple]:
    """Yield each measure, each of its scenes, and its values there; NaN without one."""
    for one in made.design.measures:
        for scene in one.scenes:
            found = (row[one.name] for row in made.rows if row["scene"] == scene)
            yield one, scene, np.array([math.nan if value is None else value for value in found])


def _limits(made, measure, scene) -> list[float]:
    """Return the limits of the requirements on a measure in a scene."""
    return [
        one.limit
        for one in made.design.requirements
        if one.measure == measure.name and one.scene in ("", scene)
    ]


def _label(measure, scene):
    words = f"{measure.name} in {scene}" if scene else measure.name
    return f"{words} [{measure.unit}]" if measure.unit else words


def _figure(value, form="{:.3f}"):
    return "" if math.isnan(value) else form.format(value)


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of HTML."""
    head = "".join(f"<th>{escape(one)}</th>" for one in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<div class='scroll'><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
