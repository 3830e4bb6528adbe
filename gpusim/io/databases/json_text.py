"""JSON files of data bases, some with comments, read with checks of their kind and size."""

import json
import math
import re
from pathlib import Path
from typing import Any

from gpusim.domain.errors import BadFile, format_value
from gpusim.io.files import read_text, reading

LONGEST = 16 * 2**20  # [byte]
COST = 16  # [byte] memory of the parser per byte of text
# a text, or a comment
_TOKEN = re.compile(r'"(?:[^"\\\n]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)
_LAST_COMMA = re.compile(r",(\s*[\]}])")


def read_json(path: Path, what: str, *, has_comments: bool = False) -> dict:
    """Return the object of a JSON file.

    Args:
        path: The file.
        what: Kind of file, for messages.
        has_comments: Whether // and /* */ begin comments, and a list may end in a comma.

    Raises:
        BadFile: The file is none of its kind.
    """
    text = read_text(path, what, LONGEST, older=True, cost=COST)
    if has_comments:
        text = _TOKEN.sub(lambda found: found[0] if found[0][0] == '"' else " ", text)
        text = _LAST_COMMA.sub(r"\1", text)
    with reading(path, what):
        table = json.loads(text)
    if not isinstance(table, dict):
        raise BadFile(path, f"not {what}: wanted an object, {{...}}")
    return table


def number_of(path: Path, where: str, value: Any, least: float, most: float) -> float:
    """Return a finite number in a range. Raises BadFile."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not least <= value <= most:
        why = f"{where} = {format_value(value)}; wanted a number, {least:g} .. {most:g}"
        raise BadFile(path, why)
    return float(value)


def numbers_of(path: Path, where: str, value: Any, count: int | None, most: float) -> list[float]:
    """Return a list of numbers of at most `most` in size. count: of them, None for any. Raises BadFile."""
    if not isinstance(value, list) or not value or count not in (None, len(value)):
        wanted = f"a list of {count or 'the'} numbers"
        raise BadFile(path, f"{where} = {format_value(value)}; wanted {wanted}")
    return [number_of(path, where, one, -most, most) for one in value]


def list_of(path: Path, where: str, value: Any, kind: type) -> list:
    """Return a list whose items are all of a kind. Raises BadFile."""
    if not isinstance(value, list) or not all(isinstance(one, kind) for one in value):
        names = "objects" if kind is dict else "texts"
        raise BadFile(path, f"{where} = {format_value(value)}; wanted a list of {names}")
    return value


def text_of(path: Path, where: str, value: Any) -> str:
    """Return a text. Raises BadFile."""
    if not isinstance(value, str):
        raise BadFile(path, f"{where} = {format_value(value)}; wanted a text")
    return value
