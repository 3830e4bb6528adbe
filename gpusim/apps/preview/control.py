"""One key of a camera file as a control of the preview's page, and values as they are typed."""

import json
import tomllib
from dataclasses import dataclass
from math import isfinite, log
from typing import Any

from gpusim.domain.camera_keys import SECTIONS, value_of
from gpusim.domain.errors import BadData, OutOfRange, format_value

PLACES = 1000  # of a slider between numbers that are not whole
BEYOND, BEYOND_LOG = 2, 10  # a number that is typed may be as many times as large as a slider's end


@dataclass(frozen=True)
class Control:
    """One key of a camera file, or one item of its value.

    It is a slider with a number, a choice, or a text: a value as a camera file has it.

    Attributes:
        section: Section of the file.
        key: Key of the section.
        item: Index in the key's list, or key in its table. None: the whole value.
        label, unit: Texts of the page.
        low, high: Ends of the slider.
        is_log: Whether the slider is even in the logarithm.
        is_whole: Whether only whole numbers are allowed.
        choices: Choices in place of a slider.
        off: Value for "none", which a switch next to the slider sets.
        default: Value if neither the file nor the class has one.
        named: Choice -> value in the file. None, of the first choice: the file's own value.
        is_text: Whether it is a text.
        suggested: Values that the page offers for a text.
        words: Which values a text may have.
    """

    section: str
    key: str
    label: str
    low: float = 0.0
    high: float = 1.0
    unit: str = ""
    is_log: bool = False
    is_whole: bool = False
    choices: tuple[Any, ...] = ()
    item: int | str | None = None
    off: Any = None
    default: Any = None
    named: dict[str, Any] | None = None
    is_text: bool = False
    suggested: tuple[str, ...] = ()
    words: str = ""

    @property
    def places(self) -> int:
        """Last place of the slider; the first one is 0. Whole numbers have one place each."""
        return round(self.high - self.low) if self.is_whole else PLACES

    @property
    def name(self) -> str:
        """Name of the control, for links and tests."""
        return f"{self.section}.{self.key}" + ("" if self.item is None else f".{self.item}")

    def to_place(self, value: float) -> int:
        """Return the place of the slider for a value, 0 .. `places`."""
        low, high = self.low, self.high
        value = min(max(value, low), high)
        part = log(value / low) / log(high / low) if self.is_log else (value - low) / (high - low)
        return round(self.places * part)

    def to_value(self, place: int) -> float:
        """Return the value at a place of the slider, to four digits."""
        low, high = self.low, self.high
        part = place / self.places
        value = low * (high / low) ** part if self.is_log else low + (high - low) * part
        return round(value) if self.is_whole else float(f"{value:.4g}")

    def check(self, value):
        """Raise BadData or OutOfRange for a value that the control cannot set.

        A typed number may lie a little beyond the slider's ends. Far beyond, a picture would take
        minutes.
        """
        if self.is_text:
            value_of(self.label, SECTIONS[self.section][self.key][1], value)
            return
        if self.choices:
            if not any(type(value) is type(one) and value == one for one in self.choices):
                known = ", ".join(map(str, self.choices))
                raise BadData(f"{self.label} = {format_value(value)}: wanted one of {known}")
            return
        if self.off is not None and type(value) is type(self.off) and value == self.off:
            return
        if type(value) not in (int, float) or (self.is_whole and type(value) is not int):
            kind = "a whole number" if self.is_whole else "a number"
            or_off = f", or {self.off}" if self.off is not None else ""
            raise BadData(f"{self.label} = {format_value(value)}: wanted {kind}{or_off}")
        low, high = min(self.low, 0) * BEYOND, self.high * BEYOND
        if self.is_log:
            low, high = self.low / BEYOND_LOG, self.high * BEYOND_LOG
        if not low <= value <= high:
            allowed = f"{low:g} .. {high:g}"
            raise OutOfRange(self.label, f"{format_value(value)} {self.unit}".rstrip(), allowed)

    def value_in(self, given: Any) -> Any:
        """Return the control's value in a key's value of a camera file; None if it has no number there."""
        if self.item is None:
            return given
        if isinstance(self.item, str):
            given = given if isinstance(given, dict) else {}
            return given.get(self.item, self.default)
        items = _fill_places(given, self)
        return None if items is None else items[self.item]

    def put_in(self, given: Any, value: Any) -> Any:
        """Return a key's value of a camera file with the control's value in it. Raises BadData."""
        if self.item is None:
            return value
        if isinstance(self.item, str):
            return (given if isinstance(given, dict) else {}) | {self.item: value}
        items = _fill_places(given, self)
        if items is None:
            raise BadData(f"{self.label}: {self.key} is no list of numbers in the camera's file")
        items[int(self.item)] = value
        return items


def _fill_places(given, control):
    """Return a list of numbers with a place for a control's item; None if it is of another kind."""
    if given is None:
        return [*control.default]
    if not isinstance(given, list) or any(isinstance(one, list) for one in given):
        return None
    return [*given, *control.default[len(given) :]]


def parse(text: str) -> Any:
    """Return the value that a typed text stands for.

    A value as in a camera file (TOML): a number, true, a list, a table. Everything else is a text,
    with or without quotes.
    """
    try:
        found = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    return found["value"] if found.keys() == {"value"} else text


def as_text(value: Any) -> str:
    """Return a value as it is typed: as in a camera file, but a text without quotes."""
    if isinstance(value, str):
        return value if parse(value) == value else json.dumps(value)
    return "" if value is None else _toml(value)


def _toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return json.dumps(value)
