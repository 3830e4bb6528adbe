"""The page of a comparison, in one file: verdicts, intervals and figures."""

from html import escape

from gpusim.fit.compare import Comparison
from gpusim.fit.page import STYLE, list_lines, plot_figures
from gpusim.fit.verdicts import AGREES, Finding


def compare_page(found: Comparison) -> str:
    """Return the page of a comparison.

    Args:
        found: The comparison.

    Returns:
        HTML that needs no network.

    Raises:
        Missing: Matplotlib is not installed.
    """
    title = escape(f"{found.camera}: simulated against real")
    count = sum(one.state == found.state for one in found.findings)
    body = [
        f"<h1>{title}</h1>",
        f"<p><strong>{escape(found.state)}</strong>: {count} of {len(found.findings)} statistics.</p>",
        '<p class="soft">A statistic agrees if the difference is as small as agreed with a confidence of 95 %. It '
        "differs if its interval excludes 0 and the difference is larger than agreed; all intervals together hold "
        "with 95 %. Otherwise there are too few frames.</p>",
        list_lines("Not compared", found.unknown, "Nothing is left out."),
        "<h2>Statistics</h2>",
        _table(found.findings),
    ]
    if found.plots:
        body += [
            "<h2>Figures</h2>",
            f'<div class="plots">{"".join(plot_figures(list(found.plots)))}</div>',
        ]
    text = "\n".join(body)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head>\n<body><main>\n{text}\n</main></body></html>\n"
    )


def _table(findings: tuple[Finding, ...]) -> str:
    head = "".join(
        f'<th scope="col">{name}</th>'
        for name in ("Frames", "Statistic", "Real", "Simulated", "Verdict")
    )
    rows, group = [], None
    for one in findings:
        shown = one.group if one.group != group else ""
        group = one.group
        words = escape(one.words)
        rows.append(
            f'<tr><th scope="row">{escape(shown)}</th><td>{escape(one.statistic)}</td>'
            f'<td class="number">{_number(one.real)}</td><td class="number">{_number(one.simulated)}</td>'
            f"<td>{words if one.state == AGREES else f'<strong>{words}</strong>'}</td></tr>"
        )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _number(value):
    return "" if value is None else f"{value:.5g}"
