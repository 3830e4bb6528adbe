"""Pictures of comparisons and histories, with matplotlib."""

from datetime import datetime
from pathlib import Path

import numpy as np

from gpusim.bench.compare import Comparison
from gpusim.bench.history import History
from gpusim.io.atomic import atomic_path
from gpusim.plot.canvas import matplotlib

# slower, the same, faster; they differ in lightness, and markers differ too
COLORS = {1: ("#c2410c", "^"), 0: ("0.55", "o"), -1: ("#1d4ed8", "v")}
MOST_LINES = 8  # rows of a history that get a line of their own
ROW_HEIGHT = 0.2  # [inch]


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Write a picture of all changes, with their margins, one panel for each result.

    Args:
        comparison: The comparison.
        path: File to write.

    Raises:
        Missing: Matplotlib is not installed.
        BadFile: The file cannot be written.
    """
    pyplot = matplotlib()
    names, columns = list(comparison.rows), comparison.columns
    figure, panels = pyplot.subplots(
        1,
        len(columns),
        figsize=(4.0 + 3.2 * len(columns), 1.6 + ROW_HEIGHT * len(names)),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axes, column in zip(panels[0], columns, strict=True):
        if column.common is not None:
            axes.axvline(np.exp(column.common.change), color="0.7", ls="--", lw=1)
        axes.axvline(1.0, color="0.2", lw=1)
        for place, name in enumerate(names):
            change = column.verdicts[name].change
            if change is None:
                words = column.verdicts[name].words
                axes.text(
                    0.5,
                    place,
                    words,
                    transform=axes.get_yaxis_transform(),
                    va="center",
                    ha="center",
                    fontsize=7,
                )
                continue
            color, marker = COLORS[change.sign]
            ends = np.exp(change.change + np.array([-change.margin, change.margin]))
            axes.plot(ends, [place, place], color=color, lw=1.5)
            axes.plot(np.exp(change.change), place, marker, color=color, ms=5)
        axes.set(xscale="log", xlabel="time / time of the base", title=column.label)
        _mark_ratios(axes)
    panels[0, 0].set_yticks(range(len(names)), names, fontsize=7)
    panels[0, 0].set_ylim(len(names) - 0.4, -0.6)
    figure.suptitle(f"against {comparison.label}: change and margin at 99 % for the whole table")
    _save(figure, path, pyplot)


def draw_history(history: History, path: str | Path) -> None:
    """Write a picture of a history: scores above, times relative to the first below.

    Args:
        history: The history.
        path: File to write.

    Raises:
        Missing: Matplotlib is not installed.
        BadFile: The file cannot be written.
    """
    pyplot = matplotlib()
    dates = [datetime.fromisoformat(result["date"]) for result in history.results]
    figure, (above, below) = pyplot.subplots(
        2, 1, figsize=(9, 8), sharex=True, layout="constrained"
    )
    for family in history.results[-1]["scores"]:
        scores = [result["scores"].get(family) for result in history.results]
        shown = [np.nan if score is None else 100 * score for score in scores]
        above.plot(dates, shown, "o-", label=family, lw=2.5 if family == "all" else 1)
    above.set(ylabel="score [%]", ylim=(0, None))
    above.legend(fontsize=7, ncols=2)
    for name in sorted(history.rows, key=lambda name: -_range(history.times(name)))[:MOST_LINES]:
        times = [np.nan if time is None else time for time in history.times(name)]
        first = next((time for time in times if np.isfinite(time)), np.nan)
        below.plot(dates, np.array(times) / first, "o-", lw=1, label=name)
    for date, label, step in zip(dates[1:], history.labels[1:], history.steps, strict=True):
        if any(verdict.change and verdict.change.sign for verdict in step.verdicts.values()):
            below.axvline(date, color="0.7", ls=":", lw=1)
            place = below.get_xaxis_transform()
            below.text(
                date, 0.99, f"step at {label} ", transform=place, fontsize=7, va="top", ha="right"
            )
    below.set(yscale="log", ylabel=f"time / first time ({MOST_LINES} rows that changed most)")
    _mark_ratios(below, below.yaxis)
    below.legend(fontsize=7)
    below.tick_params(axis="x", rotation=30)
    _save(figure, path, pyplot)


def _range(times):
    """Return the log of the largest over the smallest known time."""
    known = [time for time in times if time is not None]
    return float(np.log(max(known) / min(known))) if known else 0.0


def _mark_ratios(axes, axis=None):
    """Write the ticks of a logarithmic axis as ratios, and draw a grid."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis = axes.xaxis if axis is None else axis
    low, high = axis.get_view_interval()
    fine = (
        (1.0,)
        if high / low > 30
        else (1.0, 2.0, 5.0)
        if high / low > 4
        else (0.8, 0.9, 1.0, 1.1, 1.2, 1.5, 2, 3)
    )
    axis.set_major_locator(LogLocator(subs=fine))
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter("x{x:.3g}")
    axes.grid(alpha=0.3)


def _save(figure, path, pyplot):
    """Write a figure and close it."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120)
    pyplot.close(figure)
