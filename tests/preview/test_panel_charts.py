"""Charts of the panels: places of lines and marks, ticks, files, and texts from outside."""

import csv
from xml.etree import ElementTree

import numpy as np
import pytest

from gpusim.apps.preview.curves import Axis, Chart, Line, Mark, log_ticks, short_number, ticks
from gpusim.apps.preview.figures import Bars, Image, Note, Table, save_csv, save_svg

SVG = "{http://www.w3.org/2000/svg}"


def test_ticks_are_round_and_inside():
    assert ticks(0, 1023) == [0, 500, 1000] and ticks(-4.5, 16) == [0, 5, 10, 15]
    assert ticks(0, 1) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1]) and ticks(3, 3) == [3]
    assert log_ticks(1, 6000) == [1, 10, 100, 1000]
    assert log_ticks(3, 60) == pytest.approx([5, 10, 20, 50])
    assert log_ticks(1e-9, 1e9)[0] >= 1e-9 and 3 <= len(log_ticks(1e-9, 1e9)) <= 8
    shown = {
        0: "0",
        0.5: "0.5",
        1e-4: "1e-4",
        2.5e-5: "2.5e-5",
        6000: "6000",
        1e6: "1e6",
        -20: "-20",
    }
    assert {value: short_number(value) for value in shown} == shown


def polyline(svg, number=0):
    """Points of a line, (n, 2), and the size of the axes."""
    root = ElementTree.fromstring(
        svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    )
    [axes] = root.findall(f"{SVG}svg")
    line = axes.findall(f"{SVG}polyline")[number]
    points = [[float(x) for x in pair.split(",")] for pair in line.get("points").split()]
    return np.array(points), float(axes.get("width")), float(axes.get("height")), axes


def test_lines_and_marks_lie_at_their_values():
    x, y = Axis("x [DN]", 0, 1000), Axis("y", 0, 50)
    chart = Chart(
        "one",
        x,
        y,
        [Line("a", np.array([0, 250, 1000]), np.array([0, 25, 50]))],
        [Mark(64, "black")],
    )
    points, wide, high, axes = polyline(chart.svg())
    assert points == pytest.approx(np.array([[0, high], [wide / 4, high / 2], [wide, 0]]), abs=0.06)
    [mark] = axes.findall(f"{SVG}line")
    assert float(mark.get("x1")) == pytest.approx(0.064 * wide, abs=0.06)
    chart = Chart("log", Axis("x", 1, 100, True), Axis("y", 1, 1e4, True),
                  [Line("a", np.array([1, 10, 100]), np.array([1, 100, 0]))])  # fmt: skip
    points, wide, high, _ = polyline(chart.svg())
    assert points == pytest.approx(np.array([[0, high], [wide / 2, high / 2]]), abs=0.06)


def test_long_lines_keep_their_extremes():
    y = np.zeros(4000)
    y[1234], y[3777] = 7, -5
    chart = Chart("one", Axis("x"), Axis("y", -5, 7), [Line("a", np.arange(4000), y)])
    points, wide, high, _ = polyline(chart.svg())
    assert len(points) < 1000
    assert points[:, 1].min() == pytest.approx(0, abs=0.06) and points[:, 1].max() == pytest.approx(
        high, abs=0.06
    )
    assert points[points[:, 1].argmin(), 0] == pytest.approx(wide * 1234 / 3999, abs=0.06)


def test_files_hold_all_numbers_and_texts_from_outside_stay_texts():
    evil = '<script>alert("x")</script>, "&'
    lines = [Line(evil, np.array([1.5, 2.0]), np.array([0.1, np.nan]))]
    parts = [
        Chart(evil, Axis(evil), Axis(evil), lines, [Mark(3, evil)]),
        Bars(evil, evil, {evil: 2.0, "other": 0.0}, limit=Mark(1.0, evil)),
        Image(evil, evil, np.array([[1.0, 0.5, 0.0]]), 0.25, (0.5, 0.5)),
        Table(evil, ("name", evil), [("a", 1.25), (evil, "text")]),
        Note(evil),
    ]  # fmt: skip
    rows = [*csv.reader(save_csv(parts).splitlines())]
    assert [evil, "1.5", "0.1"] in rows and [evil, "2.0"] in rows and ["a", "1.25"] in rows
    assert rows.count([]) == 4 and ["0.0", "1.0", "0.5", "0.0"] in rows
    root = ElementTree.fromstring(save_svg(parts))
    assert len(root.findall(f"{SVG}svg")) == 3 and not root.findall(f".//{SVG}script")
    heights = [float(one.get("height")) for one in root.findall(f"{SVG}svg")]
    tops = [float(one.get("y")) for one in root.findall(f"{SVG}svg")]
    assert tops == pytest.approx(np.cumsum([0, *heights[:-1]]).tolist(), abs=1)
    for part in parts:
        assert "<script" not in part.html()
    assert any(text.text and "alert" in text.text for text in root.iter(f"{SVG}text"))


def test_texts_have_the_pages_colour():
    chart = Chart(
        "one", Axis("x"), Axis("y"), [Line("a", np.arange(3), np.arange(3))], [Mark(1, "m")]
    )
    for part in (
        chart,
        Bars("one", "two", {"a": 1.0}),
        Image("i", "[m]", np.ones((3, 3)), 1.0, (1, 1)),
    ):
        for text in part.svg().split("<text ")[1:]:
            assert 'fill="currentColor"' in text.split(">")[0]
