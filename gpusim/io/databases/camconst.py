"""Black and white levels of cameras, and colour matrices: RawTherapee's camconst.json."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile, format_value
from gpusim.io.databases.json_text import list_of, number_of, numbers_of, read_json

WHAT = "RawTherapee's camconst.json"
ABSOLUTE = 65535  # black levels above it: this is taken off


@dataclass(frozen=True)
class Constants:
    """Constants of a camera.

    Attributes:
        names: Its names, make and model.
        black, white: (ISO, level) pairs, the mean of the channels [DN]; ISO 0: for all.
        is_absolute: Whether the black level is the whole one, not an addition to the raw file's.
        matrix: From XYZ in D65 to the camera's channels, (3, 3), or None.
        size: Columns and rows that are used, or None.
    """

    names: tuple[str, ...]
    black: tuple[tuple[float, float], ...] = ()
    white: tuple[tuple[float, float], ...] = ()
    is_absolute: bool = False
    matrix: np.ndarray | None = None
    size: tuple[int, int] | None = None

    def white_at(self, iso: float) -> float | None:
        """Return the white level of the nearest ISO [DN]."""
        return _nearest(self.white, iso)

    def black_at(self, iso: float) -> float | None:
        """Return the black level of the nearest ISO [DN]."""
        return _nearest(self.black, iso)


def _nearest(levels, iso):
    """Return the level of the nearest ISO, as ratios count; None if there are no levels."""
    if not levels:
        return None
    return min(levels, key=lambda one: abs(np.log((one[0] or iso) / iso)))[1]


def read_camconst(path: Path) -> list[Constants]:
    """Read the constants of all cameras.

    Args:
        path: camconst.json, with its comments.

    Returns:
        The cameras, in the order of the file.

    Raises:
        BadFile: The file is none, or damaged.

    Source:
        The comments of camconst.json.
    """
    table = read_json(path, WHAT, has_comments=True)
    entries = list_of(path, "camera_constants", table.get("camera_constants"), dict)
    return [_constants(path, one) for one in entries]


def _constants(path, table) -> Constants:
    names = table.get("make_model")
    names = [names] if isinstance(names, str) else list_of(path, "make_model", names, str)
    if not names:
        raise BadFile(path, "make_model = []; wanted a name")
    where = names[0]
    ranges = table.get("ranges", {})
    if not isinstance(ranges, dict):
        raise BadFile(path, f"{where}: ranges = {format_value(ranges)}; wanted an object")
    black = _levels(path, f"{where}: black", ranges.get("black"))
    is_absolute = any(level >= ABSOLUTE for _, level in black)
    if is_absolute:
        black = tuple((iso, level - ABSOLUTE) for iso, level in black)
    given = table.get("dcraw_matrix")
    matrix = None
    if isinstance(given, list) and len(given) == 9:
        values = numbers_of(path, f"{where}: dcraw_matrix", given, 9, 1e6)
        matrix = np.array(values).reshape(3, 3) / 1e4
    white = _levels(path, f"{where}: white", ranges.get("white"))
    return Constants(tuple(names), black, white, is_absolute, matrix, _size(path, where, table))


def _levels(path, where, value: Any) -> tuple[tuple[float, float], ...]:
    """Return (ISO, mean level) pairs."""
    if value is None:
        return ()
    if isinstance(value, dict):
        value = [value]
    if isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
        found = []
        for one in value:
            level = _mean(path, where, one.get("levels"))
            speeds = one.get("iso", 0)
            speeds = speeds if isinstance(speeds, list) else [speeds]
            found += [(number_of(path, where, iso, 0, 1e8), level) for iso in speeds]
        return tuple(found)
    return ((0.0, _mean(path, where, value)),)


def _mean(path, where, value) -> float:
    """Return a level, or the mean of the channels' levels."""
    if isinstance(value, list):
        return float(np.mean(numbers_of(path, where, value, None, 2e5)))
    return number_of(path, where, value, 0, 2e5)


def _size(path, where, table):
    """Return columns and rows of the crop of raw values; None if it does not say."""
    crop = table.get("raw_crop")
    if not isinstance(crop, list) or len(crop) != 4:
        return None
    _, _, columns, rows = numbers_of(path, f"{where}: raw_crop", crop, 4, 1e6)
    return (int(columns), int(rows)) if columns > 0 and rows > 0 else None
