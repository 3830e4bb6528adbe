"""Charts of the panels as SVG: axes with ticks and units, lines, marks and a legend.

Texts and axes have the colour of the page's text. Lines have colours that are legible on dark and
on light.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, isfinite, log10

import numpy as np

COLOURS = {
    "R": "#e05050",
    "G": "#30a048",
    "B": "#5878e8",
    "C": "#1098ad",
    "M": "#c2409c",
    "E": "#0ca678",
    "N": "#a06040",
}  # of channels; others have the colour of the text
ACCENT, SECOND = "#c98500", "#5878e8"  # of marks and points; of a second line
WIDE, HIGH = 420.0, 200.0  # of a chart's axes and texts, without its legend
LEFT, RIGHT, ABOVE, BELOW = 46.0, 12.0, 30.0, 32.0  # margins of the axes
LETTER = 5.4  # width of a letter of the small font
ROW = 14.0  # height of a line of the legend, and of a bar
MOST = 400  # places of a line along the axis
QUIET = 'stroke="currentColor" stroke-opacity="0.35"'
SMALL = 'fill="currentColor" font-size="10" font-family="sans-serif"'


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes:
        label: Quantity and unit.
        low, high: Ends; None: those of the lines.
        is_log: Whether it is logarithmic.
    """

    label: str
    low: float | None = None
    high: float | None = None
    is_log: bool = False


@dataclass(frozen=True, eq=False)
class Line:
    """A line, or points without one. x, y: shape (N,). dash: of SVG."""

    label: str
    x: np.ndarray
    y: np.ndarray
    color: str = "currentColor"
    dash: str = ""
    is_points: bool = False


@dataclass(frozen=True)
class Mark:
    """A labelled place of the x axis, or with `is_level` of the y axis."""

    at: float
    label: str
    is_level: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines over an x axis.

    Attributes:
        title: For readers of the screen.
        x, y: Axes.
        lines, marks: Contents.
        top: Label, factor and zero of a second x axis: (x - zero) times factor.
    """

    title: str
    x: Axis
    y: Axis
    lines: Sequence[Line]
    marks: Sequence[Mark] = ()
    top: tuple[str, float, float] | None = None

    def rows(self) -> Iterable[Sequence]:
        """See `gpusim.apps.preview.figures.Part`."""
        yield "series", self.x.label, self.y.label
        for line in self.lines:
            for x, y in zip(np.asarray(line.x).tolist(), np.asarray(line.y).tolist(), strict=True):
                yield line.label, x, y
        for mark in self.marks:
            yield (mark.label, "", mark.at) if mark.is_level else (mark.label, mark.at, "")

    def html(self) -> str:
        """See `gpusim.apps.preview.figures.Part`."""
        return self.svg()

    def svg(self) -> str:
        """See `gpusim.apps.preview.figures.Part`."""
        shown = [(line, *_finite(line, self.x, self.y)) for line in self.lines]
        x_ends = _ends(self.x, [x for _, x, _ in shown])
        y_ends = _ends(self.y, [y for *_, y in shown], room=0.06)
        wide, high = WIDE - LEFT - RIGHT, HIGH - ABOVE - BELOW

        def across(value):
            return wide * _share(value, x_ends, self.x.is_log)

        def down(value):
            return high * (1 - _share(value, y_ends, self.y.is_log))

        parts = [_grid(self, x_ends, y_ends, across, down)]
        inner = []
        for line, x, y in shown:
            places = _thin(across(x), down(y))
            if line.is_points:
                inner += [
                    f'<circle cx="{one:.1f}" cy="{other:.1f}" r="4" fill="{line.color}" '
                    'stroke="currentColor"/>'
                    for one, other in zip(*places, strict=True)
                ]
                continue
            points = " ".join(f"{one:.1f},{other:.1f}" for one, other in zip(*places, strict=True))
            dash = f' stroke-dasharray="{line.dash}"' if line.dash else ""
            inner.append(
                f'<polyline points="{points}" fill="none" stroke="{line.color}" '
                f'stroke-width="1.3"{dash}/>'
            )
        for number, mark in enumerate(self.marks):
            inner.append(_draw_mark(mark, number, across, down, (wide, high), x_ends, y_ends))
        parts.append(
            f'<svg x="{LEFT}" y="{ABOVE}" width="{wide}" height="{high}">{"".join(inner)}</svg>'
        )
        legend, depth = _legend(self.lines)
        return element(self.title, HIGH + depth, "".join(parts) + legend)


def channel_color(letter: str) -> str:
    """Return the colour of a channel's line."""
    return COLOURS.get(letter, "currentColor")


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Return about `count` round numbers between two."""
    if not high > low:
        return [low]
    rough = (high - low) / count
    size = 10.0 ** floor(log10(rough))
    step = size * next(one for one in (1, 2, 5, 10) if one * size >= 0.999 * rough)
    first = ceil(low / step - 1e-9)
    last = floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Return powers of ten between two positive numbers, of less than two decades also 2 and 5."""
    first, last = floor(log10(low)), ceil(log10(high))
    step = max(1, round((last - first) / 6))
    parts = (1, 2, 5) if last - first <= 2 else (1,)
    found = [part * 10.0**power for power in range(first, last + 1, step) for part in parts]
    return [value for value in found if low * 0.999 <= value <= high * 1.001]


def element(title: str, high: float, inner: str) -> str:
    """Return an SVG element of the panels' width. title: for readers of the screen."""
    return (
        f'<svg viewBox="0 0 {WIDE:.0f} {high:.0f}" role="img" aria-label="{escape(title)}" '
        f'style="width:100%;display:block">{inner}</svg>'
    )


def _finite(line, x_axis, y_axis):
    """Return the places of a line that can be drawn."""
    x, y = (np.asarray(values, np.float64) for values in (line.x, line.y))
    there = np.isfinite(x) & np.isfinite(y)
    for axis, values in ((x_axis, x), (y_axis, y)):
        if axis.is_log:
            there &= values > 0
    return x[there], y[there]


def _ends(axis, values, room=0.0):
    """Return the ends of an axis; room: part of it beyond the largest value."""
    every = np.concatenate(values) if values else np.empty(0)
    low, high = (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
    if axis.is_log:
        low = low if axis.low is None else axis.low
        high = high if axis.high is None else axis.high
        return (low, high) if high > low > 0 else (max(low, 1e-9), max(10 * low, 1e-8))
    low = min(low, 0.0) if axis.low is None else axis.low
    high = high + room * (high - low) if axis.high is None else axis.high
    return (low, high) if high > low else (low, low + 1.0)


def _share(value, ends, is_log):
    low, high = np.log10(ends) if is_log else ends
    value = np.log10(value) if is_log else value
    return (value - low) / (high - low)


def _thin(x, y):
    """Return a line with at most about MOST places along x, its lowest and highest values kept."""
    if len(x) <= 2 * MOST:
        return x, y
    step = ceil(len(x) / MOST)
    whole = len(x) // step * step
    blocks = y[:whole].reshape(-1, step)
    start = np.arange(0, whole, step)
    picked = np.sort(np.concatenate([start + blocks.argmin(1), start + blocks.argmax(1)]))
    picked = np.append(picked, np.arange(whole, len(x)))
    return x[picked], y[picked]


def _grid(chart, x_ends, y_ends, across, down):
    """Return axes, ticks and labels."""
    wide, high = WIDE - LEFT - RIGHT, HIGH - ABOVE - BELOW
    parts = [
        f'<rect x="{LEFT}" y="{ABOVE}" width="{wide}" height="{high}" fill="none" {QUIET}/>',
        f'<text x="2" y="{ABOVE - 20}" {SMALL}>{escape(chart.y.label)}</text>',
        f'<text x="{LEFT + wide / 2}" y="{HIGH - 5}" text-anchor="middle" {SMALL}>'
        f"{escape(chart.x.label)}</text>",
    ]
    for value in (log_ticks if chart.x.is_log else ticks)(*x_ends):
        x = LEFT + float(across(value))
        parts.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{ABOVE}" y2="{ABOVE + high + 4}" {QUIET} '
            f'stroke-width="0.5"/><text x="{x:.1f}" y="{HIGH - 18}" text-anchor="middle" {SMALL}>'
            f"{short_number(value)}</text>"
        )
    for value in (log_ticks if chart.y.is_log else ticks)(*y_ends):
        y = ABOVE + float(down(value))
        parts.append(
            f'<line x1="{LEFT - 4}" x2="{LEFT + wide}" y1="{y:.1f}" y2="{y:.1f}" {QUIET} '
            f'stroke-width="0.5"/><text x="{LEFT - 6}" y="{y + 3:.1f}" text-anchor="end" {SMALL}>'
            f"{short_number(value)}</text>"
        )
    if chart.top is not None:
        label, factor, zero = chart.top
        parts.append(
            f'<text x="{WIDE - 2}" y="{ABOVE - 20}" text-anchor="end" {SMALL}>{escape(label)}</text>'
        )
        for value in ticks(*((end - zero) * factor for end in x_ends)):
            x = LEFT + float(across(value / factor + zero))
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{ABOVE - 4}" y2="{ABOVE}" {QUIET}/>'
                f'<text x="{x:.1f}" y="{ABOVE - 7}" text-anchor="middle" {SMALL}>'
                f"{short_number(value)}</text>"
            )
    return "".join(parts)


def _draw_mark(mark, number, across, down, size, x_ends, y_ends):
    """Return a line with its label; nothing if it lies outside the axes."""
    wide, high = size
    line = f'stroke="{ACCENT}" stroke-dasharray="3 2"'
    ends = y_ends if mark.is_level else x_ends
    if not (isfinite(mark.at) and ends[0] <= mark.at <= ends[1]):
        return ""
    if mark.is_level:
        y = float(down(mark.at))
        return (
            f'<line x1="0" x2="{wide}" y1="{y:.1f}" y2="{y:.1f}" {line}/><text x="{wide - 3}" '
            f'y="{y - 3:.1f}" text-anchor="end" {SMALL}>{escape(mark.label)}</text>'
        )
    x, is_right = float(across(mark.at)), float(across(mark.at)) > 0.6 * wide
    side = f'x="{x - 3:.1f}" text-anchor="end"' if is_right else f'x="{x + 3:.1f}"'
    return (
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{high}" {line}/><text {side} '
        f'y="{11 + 12 * number}" {SMALL}>{escape(mark.label)}</text>'
    )


def _legend(lines):
    """Return the legend below the axes, and its height."""
    parts, x, y = [], LEFT, HIGH + 8
    for line in lines:
        if not line.label:
            continue
        width = LETTER * len(line.label) + 28
        if x > LEFT and x + width > WIDE:
            x, y = LEFT, y + ROW
        dash = f' stroke-dasharray="{line.dash}"' if line.dash else ""
        sign = (
            f'<circle cx="{x + 8:.1f}" cy="{y - 3:.1f}" r="4" fill="{line.color}"/>'
            if line.is_points
            else f'<line x1="{x:.1f}" x2="{x + 16:.1f}" y1="{y - 3:.1f}" y2="{y - 3:.1f}" '
            f'stroke="{line.color}" stroke-width="2"{dash}/>'
        )
        parts.append(f'{sign}<text x="{x + 20:.1f}" y="{y}" {SMALL}>{escape(line.label)}</text>')
        x += width
    return "".join(parts), (y - HIGH + 4 if parts else 0.0)


def short_number(value: float) -> str:
    """Return a short text of a tick's value."""
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}"
    digits, power = f"{value:.3e}".split("e")
    return f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
