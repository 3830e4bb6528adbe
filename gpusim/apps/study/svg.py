"""Small plots as SVG text for a page: histograms and scatter plots."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np

WIDTH, HEIGHT = 300, 200  # [pixel] of a plot
LEFT, RIGHT, TOP, BOTTOM = 52, 10, 10, 36  # [pixel] around its axes
MOST_BINS = 30
MOST_POINTS = 600  # of a scatter plot; more are thinned evenly
TICKS = 4


def histogram(values: np.ndarray, label: str, limits: Sequence[float] = ()) -> str:
    """Return a histogram.

    Args:
        values: Finite values, one or more.
        label: Name and unit of the axis.
        limits: Values that are marked by a line.
    """
    low, high = _ends([*values, *limits])
    bins = int(min(max(2 * math.sqrt(len(values)), 8), MOST_BINS))
    counts, edges = np.histogram(values, bins, (low, high))
    across, up = _axis(low, high, LEFT, WIDTH - RIGHT), _axis(0, counts.max(), HEIGHT - BOTTOM, TOP)
    bars = "".join(
        f'<rect x="{across(start):.1f}" y="{up(count):.1f}" width="{across(end) - across(start):.1f}" '
        f'height="{up(0) - up(count):.1f}"/>'
        for count, start, end in zip(counts, edges, edges[1:], strict=False)
        if count
    )
    lines = "".join(_vertical(across(one)) for one in limits)
    return _plot(
        f"{len(values)} values of {label}",
        f'<g class="bars">{bars}</g>{lines}',
        _ticks_across(low, high, across, label) + _ticks_up(0, float(counts.max()), up, "rows", 1),
    )


def scatter(
    x: Sequence, y: np.ndarray, x_label: str, y_label: str, limits: Sequence[float] = ()
) -> str:
    """Return a scatter plot.

    Args:
        x: Numbers, or names, which are spread evenly.
        y: Finite values, as many.
        x_label: Name of the axis of x.
        y_label: Name and unit of the other.
        limits: Values of y that are marked by a line.
    """
    names: list[str] = []
    if not all(isinstance(one, int | float) and not isinstance(one, bool) for one in x):
        names = list(dict.fromkeys(map(str, x)))
        x = [names.index(str(one)) for one in x]
    step = max(1, math.ceil(len(y) / MOST_POINTS))
    places, heights = np.array(x, float)[::step], y[::step]
    low, high = (-0.5, len(names) - 0.5) if names else _ends(places)
    least, most = _ends([*heights, *limits])
    across, up = _axis(low, high, LEFT, WIDTH - RIGHT), _axis(least, most, HEIGHT - BOTTOM, TOP)
    dots = "".join(
        f'<circle cx="{across(one):.1f}" cy="{up(other):.1f}" r="2"/>'
        for one, other in zip(places, heights, strict=True)
    )
    lines = "".join(
        f'<line class="limit" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{up(one):.1f}" y2="{up(one):.1f}"/>'
        for one in limits
    )
    if names:
        ticks = "".join(_text(across(k), HEIGHT - 22, name[:12]) for k, name in enumerate(names))
        ticks += _text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 5, x_label)
    else:
        ticks = _ticks_across(low, high, across, x_label)
    return _plot(
        f"{y_label} against {x_label}",
        f'<g class="dots">{dots}</g>{lines}',
        ticks + _ticks_up(least, most, up, y_label),
    )


def _plot(words, content, ticks):
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape(words)}"><title>{escape(words)}</title>'
        f'<path class="axes" d="M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}"/>{ticks}{content}</svg>'
    )


def _ends(values):
    """Return ends of an axis that shows all values."""
    low, high = float(np.min(values)), float(np.max(values))
    room = 0.03 * (high - low) or abs(high) * 0.05 or 1.0
    return low - room, high + room


def _axis(low, high, first, last):
    """Return the function from a value to its place on an axis [pixel]."""
    scale = (last - first) / ((high - low) or 1)
    return lambda value: first + (value - low) * scale


def _round_numbers(low, high, least=0.0):
    """Return a few round numbers between two ends. least: step between them."""
    step = 10 ** math.floor(math.log10((high - low) / TICKS))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= TICKS)
    step = max(step, least)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _ticks_across(low, high, across, label):
    marks = "".join(
        _text(across(one), HEIGHT - 22, f"{one:.6g}") for one in _round_numbers(low, high)
    )
    return marks + _text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 5, label)


def _ticks_up(low, high, up, label, least=0.0):
    marks = "".join(
        _text(LEFT - 4, up(one) + 4, f"{one:.6g}", "end")
        for one in _round_numbers(low, high, least)
    )
    middle = (TOP + HEIGHT - BOTTOM) / 2
    return marks + (
        f'<text transform="translate(10 {middle:.0f}) rotate(-90)" text-anchor="middle">{escape(label)}</text>'
    )


def _text(x, y, words, anchor="middle"):
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _vertical(x):
    return f'<line class="limit" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>'
