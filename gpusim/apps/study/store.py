"""Results of a study in a folder: blocks of rows while it runs, then the table. Files are complete or absent."""

import csv
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from gpusim.apps.study.design import Design
from gpusim.domain.errors import BadFile, Missing, UnknownName
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text

FORMATS = ("csv", "parquet")
AT_ONCE = 24  # rows of a block, about; those of a killed block are computed again
LARGEST = 2**26  # [byte] of a block


def blocks_of(design: Design) -> list[range]:
    """Return the rows of each block, which has whole cameras."""
    length = design.each * max(AT_ONCE // design.each, 1)
    return [
        range(first, min(first + length, len(design))) for first in range(0, len(design), length)
    ]


def block_path(folder: Path, block: range) -> Path:
    """Return the file of a block."""
    return folder / "rows" / f"{block.start:09d}.jsonl"


def write_block(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Write rows, one line of JSON each. Raises BadFile."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        for row in rows:
            file.write(json.dumps(row) + "\n")


def read_blocks(folder: Path, design: Design) -> list[dict[str, Any]]:
    """Return all rows that are there, in their order. Raises BadFile."""
    found = []
    for block in blocks_of(design):
        path = block_path(folder, block)
        if not path.exists():
            continue
        try:
            rows = [json.loads(line) for line in read_text(path, "rows", LARGEST).splitlines()]
            numbers = [row["row"] for row in rows]
        except (ValueError, KeyError, TypeError, RecursionError):
            numbers = []
        if numbers != list(block):
            raise BadFile(path, f"not the rows {block.start} .. {block.stop - 1}; remove it")
        found += rows
    return found


def check_format(name: str) -> str:
    """Return the format of a table. Raises UnknownName, or Missing without pyarrow."""
    if name not in FORMATS:
        raise UnknownName("format of the table", str(name), FORMATS)
    if name == "parquet":
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError:
            raise Missing(
                'a Parquet table needs pyarrow: pip install pyarrow, or take the table "csv"'
            ) from None
    return name


def write_table(path: Path, columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write a table: .csv or .parquet. Raises BadFile."""
    with atomic_path(path) as temporary:
        if path.suffix == ".parquet":
            _write_parquet(temporary, columns, rows)
        else:
            temporary.write_text(as_csv(columns, rows), encoding="utf-8")


def as_csv(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> str:
    """Return a table as text. Numbers have all of their digits; a cell without a value is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row[name]) for name in columns] for row in rows)
    return text.getvalue()


def _cell(value):
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value) if isinstance(value, list | dict) else value


def _write_parquet(path, columns, rows):
    """Write a table with pyarrow. Lists and mixed values are JSON."""
    import pyarrow
    import pyarrow.parquet

    arrays = []
    for name in columns:
        values = [row[name] for row in rows]
        try:
            arrays.append(pyarrow.array(values))
        except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):
            arrays.append(
                pyarrow.array([None if one is None else json.dumps(one) for one in values])
            )
    pyarrow.parquet.write_table(pyarrow.table(arrays, names=list(columns)), path)
