"""Options of `open_scene` as texts, which the command line and the preview's fields take."""

from math import degrees, inf, nextafter, radians
from typing import Any

WAVELENGTHS = "FIRST:LAST:STEP, such as 400:700:10, or a list, such as 450,550,650"
MOST_WAVELENGTHS = 10_000


def parse_wavelengths(text: str) -> list[float]:
    """Return the wavelengths [nm] of FIRST:LAST:STEP or of a list.

    Raises ValueError, ZeroDivisionError or OverflowError for another text.
    """
    if ":" not in text:
        return [float(part) for part in text.split(",")]
    first, last, step = (float(part) for part in text.split(":"))
    count = round((last - first) / step)
    if not (0 < count < MOST_WAVELENGTHS and abs(first + count * step - last) < 1e-6 * step):
        raise ValueError
    return [first + number * step for number in range(count + 1)]


def parse_band(text: str) -> tuple[str, float]:
    """Return name and wavelength [nm] of NAME=NM. Raises ValueError."""
    name, _, value = text.rpartition("=")
    return name, float(value)


def parse_degrees(text: str) -> float:
    """Return an angle [rad] of a text in degrees. Raises ValueError."""
    return radians(float(text))


def parse_size(text: str) -> tuple[int, int]:
    """Return columns and rows of COLSxROWS. Raises ValueError."""
    cols, rows = (int(part) for part in text.lower().split("x"))
    return cols, rows


def format_size(size: tuple[int, int]) -> str:
    """Return COLSxROWS of columns and rows."""
    return "x".join(map(str, size))


def format_option(name: str, value: Any) -> str:
    """Return the text of an option's value that is read as the same value, bit for bit.

    name: Of an option of `open_scene`. value: As the command line reads it: `fov` is in radians.
    """
    if name == "size":
        return format_size(value)
    if name == "wavelengths":
        return ",".join(map(repr, map(float, value)))
    if name == "fov":
        return repr(_degrees(value))
    return repr(value) if isinstance(value, float) else str(value)


def _degrees(angle):
    """Return degrees that `parse_degrees` turns into `angle`, bit for bit, if there are any.

    They are a neighbour of the rounded ones.
    """
    near = degrees(angle)
    around = [near, nextafter(near, inf), nextafter(near, -inf)]
    return next((one for one in around if radians(one) == angle), near)
