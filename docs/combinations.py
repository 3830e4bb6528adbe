"""Writes the matrix of docs/limits.md from `gpusim verify --combinations --json FILE`.

python docs/combinations.py combinations.json
"""

import json
import sys
from collections import Counter
from pathlib import Path

from gpusim.judge.combinations import MARKS, MEANINGS, NAMES, RUNS, Cell, reasons

PAGE = Path(__file__).parent / "limits.md"
FIRST, LAST = "<!-- combinations -->", "<!-- end of combinations -->"


def cells_of(rows) -> list[Cell]:
    """Return the cells of the JSON rows of the command."""
    keys = ("first", "second", "state", "why")
    return [Cell(**{key: row[key] for key in keys}) for row in rows]


def block(cells: list[Cell]) -> str:
    """Return the matrix and the reasons in Markdown, between its marks."""
    marks = {frozenset((cell.first, cell.second)): MARKS[cell.state] for cell in cells}
    counts = Counter(cell.state for cell in cells if cell.first != cell.second)
    legend = ", ".join(
        f"{MARKS[one]} {MEANINGS[one]} ({counts[one]})" for one in MARKS if counts[one]
    )
    numbers = [str(number) for number in range(1, len(NAMES) + 1)]
    lines = ["| | | " + " | ".join(numbers) + " |", "|" + " --- |" * (len(NAMES) + 2)]
    for number, name in zip(numbers, NAMES, strict=True):
        row = " | ".join(marks.get(frozenset((name, other)), " ") for other in NAMES)
        lines.append(f"| {name} | {number} | {row} |")
    found = [f"- {line}" for line in reasons(cell for cell in cells if cell.state != RUNS)]
    head = f"{sum(counts.values())} pairs: {legend}."
    return "\n".join([FIRST, head, "", *lines, "", *found, LAST])


def filled(text: str, cells: list[Cell]) -> str:
    """Return the page with the matrix of these cells."""
    return text.partition(FIRST)[0] + block(cells) + text.partition(LAST)[2]


if __name__ == "__main__":
    rows = json.loads(Path(sys.argv[1]).read_text())
    PAGE.write_text(filled(PAGE.read_text(), cells_of(rows)))
