"""Bars, pictures and tables of the panels, and files of what a panel shows."""

import base64
import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Protocol

import numpy as np

from gpusim.apps.preview.curves import (
    ACCENT,
    LETTER,
    QUIET,
    ROW,
    SECOND,
    SMALL,
    WIDE,
    Mark,
    element,
    short_number,
    ticks,
)

PARTS_STYLE = """
.panel-note { font-size: 12px; margin: 2px 0; }
.panel-table { font-size: 12px; width: 100%; }
.panel-table td, .panel-table th { text-align: right; padding: 0 4px; font-weight: normal; }
"""


class Part(Protocol):
    """A part of a panel's content."""

    def svg(self) -> str:
        """Return an SVG element; "" if it is no drawing."""

    def html(self) -> str:
        """Return the part for the page."""

    def rows(self) -> Iterable[Sequence]:
        """Return the lines of a CSV file, a header first."""


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars.

    Attributes:
        title: Above the bars.
        label: Quantity and unit.
        values: Value of each bar by its name, 0 or more.
        colors: Colours of some bars by name.
        limit: A labelled place on the axis, or None.
        form: Format of the values.
    """

    title: str
    label: str
    values: dict[str, float]
    colors: dict[str, str] = field(default_factory=dict)
    limit: Mark | None = None
    form: str = "{:.3g}"

    def rows(self) -> Iterable[Sequence]:
        """See `Part`."""
        yield "name", self.label
        yield from self.values.items()
        if self.limit is not None:
            yield self.limit.label, self.limit.at

    def html(self) -> str:
        """See `Part`."""
        return self.svg()

    def svg(self) -> str:
        """See `Part`."""
        named = min(max((len(name) for name in self.values), default=0), 30) * LETTER + 8
        room = WIDE - named - 58
        most = max([*self.values.values(), self.limit.at if self.limit else 0.0]) or 1.0
        parts = [f'<text x="2" y="12" {SMALL}>{escape(self.title)}: {escape(self.label)}</text>']
        for number, (name, value) in enumerate(self.values.items()):
            y = 18 + ROW * number
            width = room * value / most
            color = self.colors.get(name, SECOND)
            parts.append(
                f'<text x="{named - 4:.1f}" y="{y + 10:.1f}" text-anchor="end" {SMALL}>'
                f"{escape(name[:30])}</text>"
                f'<rect x="{named:.1f}" y="{y + 2:.1f}" width="{width:.1f}" height="{ROW - 3}" '
                f'fill="{color}"/><text x="{named + width + 3:.1f}" y="{y + 10:.1f}" {SMALL}>'
                f"{escape(self.form.format(value))}</text>"
            )
        end = 20 + ROW * len(self.values)
        if self.limit is not None:
            x = named + room * self.limit.at / most
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="16" y2="{end:.1f}" stroke="{ACCENT}" '
                f'stroke-dasharray="3 2"/><text x="{x:.1f}" y="{end + 10:.1f}" '
                f'text-anchor="end" {SMALL}>{escape(self.limit.label)}</text>'
            )
            end += ROW
        return element(f"{self.title}: {self.label}", end + 2, "".join(parts))


@dataclass(frozen=True, eq=False)
class Image:
    """A picture of values between axes of one unit, logarithmic over `decades` below its peak.

    Attributes:
        title: Above the picture.
        label: Unit of the axes.
        values: Values (rows, cols), the largest above 0.
        step: Distance of the samples, in the axes' unit.
        frame: Height and width of a rectangle around the middle, in the axes' unit.
        decades: Range of the greys.
    """

    title: str
    label: str
    values: np.ndarray
    step: float
    frame: tuple[float, float]
    decades: float = 4.0

    def rows(self) -> Iterable[Sequence]:
        """See `Part`."""
        at = [(np.arange(n) - (n - 1) / 2) * self.step for n in self.values.shape]
        yield (f"y, then columns at x {self.label}", *at[1].tolist())
        for y, row in zip(at[0].tolist(), self.values.tolist(), strict=True):
            yield (y, *row)

    def html(self) -> str:
        """See `Part`."""
        return self.svg()

    def svg(self) -> str:
        """See `Part`."""
        from PIL import Image as Pictures

        peak = float(self.values.max())
        part = np.log10(np.maximum(self.values / peak, 10**-self.decades)) / self.decades + 1
        file = io.BytesIO()
        Pictures.fromarray(np.uint8(255 * part + 0.5)).save(file, "PNG")
        data = base64.b64encode(file.getvalue()).decode()
        high, wide = (self.step * n / 2 for n in self.values.shape)
        side = 190.0
        left, scale = (WIDE - side) / 2, side / (2 * max(high, wide))

        def place(value):
            return side / 2 + scale * value

        parts = [
            f'<text x="{WIDE / 2}" y="12" text-anchor="middle" {SMALL}>{escape(self.title)}</text>',
            f'<svg x="{left}" y="18" width="{side}" height="{side}">'
            f'<image x="{place(-wide):.1f}" y="{place(-high):.1f}" width="{2 * scale * wide:.1f}" '
            f'height="{2 * scale * high:.1f}" preserveAspectRatio="none" '
            f'style="image-rendering:pixelated" href="data:image/png;base64,{data}"/>'
            f'<rect x="{place(-self.frame[1] / 2):.1f}" y="{place(-self.frame[0] / 2):.1f}" '
            f'width="{scale * self.frame[1]:.1f}" height="{scale * self.frame[0]:.1f}" '
            f'fill="none" stroke="{ACCENT}"/></svg>',
        ]
        for value in ticks(-wide, wide):
            x = left + place(value)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{18 + side}" y2="{22 + side}" {QUIET}/>'
                f'<text x="{x:.1f}" y="{32 + side}" text-anchor="middle" {SMALL}>'
                f"{short_number(value)}</text>"
            )
        for value in ticks(-high, high):
            y = 18 + place(value)
            parts.append(
                f'<line x1="{left - 4}" x2="{left}" y1="{y:.1f}" y2="{y:.1f}" {QUIET}/>'
                f'<text x="{left - 6}" y="{y + 3:.1f}" text-anchor="end" {SMALL}>'
                f"{short_number(value)}</text>"
            )
        words = f"{self.label}; grey: {self.decades:g} decades; frame: the pixel's aperture"
        parts.append(
            f'<text x="{WIDE / 2}" y="{46 + side}" text-anchor="middle" {SMALL}>'
            f"{escape(words)}</text>"
        )
        return element(self.title, side + 52, "".join(parts))


@dataclass(frozen=True, eq=False)
class Table:
    """A table of texts and numbers. header: names of the columns. body: the lines."""

    title: str
    header: Sequence[str]
    body: Sequence[Sequence[str | float]]

    def rows(self) -> Iterable[Sequence]:
        """See `Part`."""
        return [self.header, *self.body]

    def svg(self) -> str:
        """See `Part`: a table is none."""
        return ""

    def html(self) -> str:
        """See `Part`."""
        head = "".join(f'<th scope="col">{escape(name)}</th>' for name in self.header)
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(_cell(value))}</td>" for value in line) + "</tr>"
            for line in self.body
        )
        return (
            f'<table class="panel-table" aria-label="{escape(self.title)}"><thead><tr>{head}</tr>'
            f"</thead><tbody>{body}</tbody></table>"
        )


def save_csv(parts: Sequence[Part]) -> str:
    """Return the text of a CSV file with all parts, an empty line between them."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    for number, part in enumerate(parts):
        if number:
            file.write("\n")
        writer.writerows(part.rows())
    return file.getvalue()


def save_svg(parts: Sequence[Part]) -> str:
    """Return the text of an SVG file with all drawings, dark on white, one below the other."""
    drawings = [text for text in (part.svg() for part in parts) if text]
    heights = [
        float(text.split('viewBox="0 0 ', 1)[1].split('"')[0].split()[1]) for text in drawings
    ]
    moved = [
        text.replace("<svg ", f'<svg y="{sum(heights[:number]):.0f}" height="{high:.0f}" ', 1)
        for number, (text, high) in enumerate(zip(drawings, heights, strict=True))
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE:.0f} {sum(heights):.0f}" '
        f'width="{2 * WIDE:.0f}" height="{2 * sum(heights):.0f}" color="#202020">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(moved)}</svg>'
    )


@dataclass(frozen=True)
class Note:
    """A line of text."""

    text: str

    def rows(self) -> Iterable[Sequence]:
        """See `Part`."""
        return [(self.text,)]

    def svg(self) -> str:
        """See `Part`: a text is none."""
        return ""

    def html(self) -> str:
        """See `Part`."""
        return f'<p class="panel-note">{escape(self.text)}</p>'


def _cell(value):
    return value if isinstance(value, str) else f"{value:.4g}"
