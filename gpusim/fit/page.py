"""The page of a fit, in one file: estimates, fits, residuals, findings, unknown numbers."""

import io
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from gpusim.domain.errors import Missing
from gpusim.domain.progress import announced
from gpusim.fit.camera_text import names_of
from gpusim.fit.estimate import Estimate, Plot

if TYPE_CHECKING:
    from gpusim.fit.fitting import Fit

INK = "#0a0b0c"  # replaced by the colour of the page's text
STYLE = """
:root { color-scheme: light dark; --ink: #1c1c1e; --paper: #ffffff; --soft: #5c5f66; --line: #d5d7db; --warn: #8a4b00; }
@media (prefers-color-scheme: dark) { :root { --ink: #ececee; --paper: #17181a; --soft: #a3a7b0; --line: #3a3d43;
  --warn: #ffb454; } }
body { margin: 0 auto; padding: 1rem; max-width: 76rem; color: var(--ink); background: var(--paper);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .25rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2rem 0 .5rem; }
p, li { max-width: 56rem; } .soft { color: var(--soft); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .75rem .25rem 0; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
td.number { text-align: right; white-space: nowrap; }
.warn li::marker { color: var(--warn); }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 27rem), 1fr)); gap: 1.5rem; }
figure { margin: 0; } figcaption { color: var(--soft); font-size: .9rem; } figure h3 { font-size: 1rem; margin: 0; }
svg { width: 100%; height: auto; color: var(--ink); }
"""


def fit_page(fit: "Fit", file_name: str) -> str:
    """Return the page of a fit.

    Args:
        fit: The fit.
        file_name: Name of the camera file.

    Returns:
        HTML that needs no network.

    Raises:
        Missing: Matplotlib is not installed.
    """
    title = escape(fit.name or "A camera from its raw files")
    parts = [
        f"<h1>{title}</h1>",
        f'<p class="soft">Camera file {escape(file_name)}; values that were not measured are of the base, '
        f"{escape(_base_name(fit.base))}. {escape('; '.join(fit.lines))}.</p>",
        list_lines(
            "Not explained by the model",
            fit.unexplained,
            "All tests passed: the model explains these frames.",
            True,
        ),
        *([list_lines("Not fitted", fit.failed, "", True)] if fit.failed else []),
        list_lines("Not known from these shots", fit.unknown, "Nothing is left out."),
        "<h2>Estimates</h2><p>With intervals of 95 % confidence.</p>",
        _table(fit.estimates),
    ]
    plots = [plot for part in fit.parts for plot in part.plots]
    if plots:
        parts += [
            "<h2>Fits and residuals</h2>",
            f'<div class="plots">{"".join(plot_figures(plots))}</div>',
        ]
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head>\n<body><main>\n{body}\n</main></body></html>\n"
    )


def _base_name(base):
    from pathlib import Path

    return Path(base).name


def list_lines(title: str, lines: Sequence[str], none: str, is_warning: bool = False) -> str:
    """Return a heading with a list in HTML. none: text if there are no lines."""
    if not lines:
        return f"<h2>{title}</h2><p>{none}</p>"
    kind = ' class="warn"' if is_warning else ""
    return f"<h2>{title}</h2><ul{kind}>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _table(estimates: dict[str, Estimate]) -> str:
    rows = []
    for key, one in estimates.items():
        span = "exact" if one.low == one.high else f"{_number(one.low)} .. {_number(one.high)}"
        note = f"{one.note}; " if one.note else ""
        rows.append(
            f'<tr><th scope="row">{escape(key)}</th><td class="number">{_number(one.value)}</td>'
            f'<td class="number">{span}</td><td>{escape(one.unit)}</td>'
            f'<td class="soft">{escape(note + names_of(one))}</td></tr>'
        )
    head = "".join(
        f'<th scope="col">{name}</th>' for name in ("Key", "Value", "Interval", "Unit", "From")
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _number(value):
    return f"{value:.5g}" if math.isfinite(value) else "unbounded"


def plot_figures(plots: list[Plot]) -> Iterable[str]:
    """Yield the figures in HTML. Raises Missing if Matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError:
        raise Missing("the page of a fit needs matplotlib: pip install 'gpusim[fit]'") from None
    from matplotlib.figure import Figure

    ink: Any = {
        f"{name}color": INK for name in ("text.", "axes.edge", "axes.label", "xtick.", "ytick.")
    } | {"svg.fonttype": "none", "legend.framealpha": 0, "font.size": 9, "svg.hashsalt": "gpusim"}
    for number, plot in enumerate(plots):
        with (
            announced(f"drawing, {number} of {len(plots)} figures drawn"),
            matplotlib.rc_context(ink),
        ):
            figure = Figure(figsize=(5.6, 3.9), layout="constrained")
            plot.draw(figure)
            figure.patch.set_alpha(0)
            for axes in figure.axes:
                axes.patch.set_alpha(0)
            stream = io.StringIO()
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        svg = stream.getvalue()
        svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
        for name in (
            "figure_",
            "axes_",
            "line2d_",
            "text_",
            "patch_",
        ):  # ids must differ between figures
            svg = svg.replace(f'id="{name}', f'id="f{number}_{name}')
        svg = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(plot.title)}" ', 1)
        yield (
            f"<figure><h3>{escape(plot.title)}</h3>{svg}"
            f"<figcaption>{escape(plot.caption)}</figcaption></figure>"
        )
