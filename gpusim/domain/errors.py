"""Errors that a user's input can cause. Each names the value, the place and the allowed range.

The command line prints `str(error)` on one line and exits with status 2, without a traceback.
"""

import difflib
import re
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from numbers import Integral
from typing import Any, NamedTuple

LONGEST = 480  # letters of a message: with "gpusim: " and a program's words it fits 500
LONGEST_PATH, LONGEST_VALUE = 160, 120  # letters that a message repeats from the input


def one_line(text, longest: int = LONGEST) -> str:
    """Return `text` as one line of at most `longest` letters that any terminal can show.

    If the text is too long, its middle is left out and the last third stays: the beginning names
    the place and the value, the end says what to do.
    """
    try:
        text = str(text)
    # an integer of more than 4300 digits, a list that contains itself
    except (ValueError, RecursionError):
        text = f"a {type(text).__name__} too long to show"
    if len(text) > 8 * longest:  # skip the middle of a long build log
        text = f"{text[: 4 * longest]} {text[-4 * longest :]}"
    text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    end = longest // 3
    return text if len(text) <= longest else f"{text[: longest - end - 5]} ... {text[-end:]}"


def format_value(value) -> str:
    """Return a value as Python writes it, in at most LONGEST_VALUE letters, for a message."""
    return one_line(repr(value) if isinstance(value, str) else value, LONGEST_VALUE)


class GpusimError(Exception):
    """Base class of all errors that a user's input can cause. Its text is one line.

    Args:
        message: The text, shortened to one line.

    Attributes:
        details: The text before it was shortened.
    """

    def __init__(self, message: object = ""):
        self.details = str(message)
        super().__init__(one_line(message))


class OutOfRange(GpusimError):
    """A number outside its allowed range.

    Example: ``sensor.fill_factor = 1.4: allowed is 0 < fill_factor <= 1``.
    """

    def __init__(self, key: str, value: object, allowed: str):
        super().__init__(
            f"{one_line(key, LONGEST_VALUE)} = {one_line(value, LONGEST_VALUE)}: allowed is {allowed}"
        )


class UnknownName(GpusimError):
    """A name that is not known. The message suggests the nearest known one."""

    def __init__(self, what: str, name: str, known: Iterable[str]):
        super().__init__(
            f"unknown {one_line(what, LONGEST_PATH)} {format_value(name)}{near(name, sorted(known))}"
        )


class BadFile(GpusimError):
    """A file that is missing, truncated or has wrong content: ``path: problem``."""

    def __init__(self, path: object, problem: str):
        super().__init__(f"{one_line(path, LONGEST_PATH)}: {problem}")


class BadData(GpusimError):
    """An array or a spectrum that cannot be simulated (NaN, negative radiance, wrong order ...)."""


class NotMet(GpusimError):
    """The best affordable plan is not predicted to keep a tolerance that must be kept."""


class DoesNotFit(GpusimError):
    """The estimated memory exceeds the memory of the device. Raised before any allocation."""

    def __init__(self, what: str, needed: int, available: int, where: str):
        super().__init__(
            f"{what} needs about {needed / 2**30:.2f} GiB, {where} has {available / 2**30:.2f} GiB; "
            "use a smaller scene or another device"
        )


class TooLarge(DoesNotFit):
    """The estimated memory exceeds a limit that is set, as the preview does for uploaded files."""

    def __init__(self, what: str, needed: int, limit: int):
        GpusimError.__init__(
            self,
            f"{what} needs about {needed / 2**30:.2f} GiB; allowed here is {limit / 2**30:.2f} GiB; make it "
            "smaller: fewer pixels, or fewer bands",
        )


class Conflict(GpusimError):
    """An option that conflicts with others.

    Example: ``--strict: look --what mtf does not use it; leave it out``.
    """

    def __init__(self, option: str, reason: str, remedy: str):
        super().__init__(f"{option}: {reason}; {remedy}")


class Missing(GpusimError):
    """An optional library is not installed. The message says how to install it."""


class DeviceError(GpusimError):
    """A device is missing, unusable or failed. The message repeats the reason from the driver."""


class OutOfMemory(DeviceError):
    """A driver refuses memory while a device is in use, although the estimate fitted."""

    def __init__(self, what: str, nbytes: int, where: str, available: int, reason: str):
        size = f" ({nbytes / 2**30:.3g} GiB)" if nbytes else ""
        super().__init__(
            f"{where} refused memory for {what}{size}: {one_line(reason, LONGEST_VALUE)}; it has "
            f"{available / 2**30:.2f} GiB, which other processes may be using: close them, or use a "
            "smaller scene, fewer frames in a batch or another device"
        )


def checked_count(key: str, value, least: int = 1, most: float = inf) -> int:
    """Return `value` as an int. Raise OutOfRange if it is no whole number in `least` .. `most`."""
    if (
        not isinstance(value, Integral)
        or isinstance(value, bool)
        or not least <= int(value) <= most
    ):
        raise OutOfRange(
            key,
            format_value(value),
            f"a whole number, {least}" + (" or more" if most == inf else f" .. {most}"),
        )
    return int(value)


def is_known(name, known) -> bool:
    """Return True if `name` is a string among the known ones."""
    return isinstance(name, str) and name in known


def near(name: str, known) -> str:
    """Return a hint: "; did you mean 'x'?" with the nearest known name, or "; known: x, y"."""
    nearest = difflib.get_close_matches(one_line(name)[:LONGEST_VALUE], known, n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else f"; known: {', '.join(known)}"


RANGE = re.compile(r"(\S+) (<=?) \w+ (<=?) ([^\s,]+)")


@dataclass(frozen=True)
class Interval:
    """The finite numbers between two ends, for `in`.

    It raises TypeError for values that cannot be compared, OverflowError for integers beyond all
    floating-point numbers.
    """

    lowest: float
    highest: float
    has_lowest: bool = True
    has_highest: bool = True

    def __contains__(self, value):
        is_above = self.lowest <= value if self.has_lowest else self.lowest < value
        is_below = value <= self.highest if self.has_highest else value < self.highest
        return is_above and is_below and isfinite(value)


FINITE = Interval(-inf, inf)


class Limits(NamedTuple):
    """Limits of a field of a dataclass, for `check_fields`.

    Attributes:
        words: The limits as messages write them.
        values: All allowed values, or None for all of `kind`.
        unit: Unit of the value in messages.
        kind: Class of an allowed value.
        is_pair: Whether the field is a pair of such values.
    """

    words: str
    values: Container | None = None
    unit: str = ""
    kind: type = object
    is_pair: bool = False

    def allow(self, value: Any) -> bool:
        """Return True if the value is within the limits.

        It raises TypeError, ValueError or OverflowError for a value of a kind that cannot be
        compared.
        """
        if self.is_pair:
            return len(value) == 2 and all(map(self._allow_number, value))
        return self._allow_number(value)

    def _allow_number(self, number):
        return isinstance(number, self.kind) and (self.values is None or number in self.values)


def within(words: str, unit: str = "") -> Limits:
    """Return limits from words that begin with a range: "0 < gain <= 1e12, or automatic"."""
    lowest, above, below, highest = RANGE.match(words).groups()  # type: ignore[union-attr]
    values = Interval(float(lowest), float(highest), above == "<=", below == "<=")
    return Limits(words, values, unit)


def check_fields(owner: str, part, limits: Mapping[str, Limits]):
    """Raise OutOfRange for the first field of `part` outside its limits.

    None is accepted if it is the default of the field.

    Args:
        owner: Name of `part` in messages.
        part: A dataclass.
        limits: The limits of fields by name.
    """
    for key, limit in limits.items():
        value = getattr(part, key)
        if value is None and getattr(type(part), key, 0) is None:
            continue
        shown = f"{value:.6g}" if isinstance(value, float) else value
        try:
            is_allowed = limit.allow(value)
        except (TypeError, ValueError, OverflowError):
            is_allowed, shown = False, _write(value)
        if not is_allowed:
            shown = one_line(shown, LONGEST_VALUE)
            raise OutOfRange(f"{owner}.{key}", f"{shown} {limit.unit}".rstrip(), limit.words)


def _write(value):
    """Return a value as Python writes it, for a message."""
    try:
        return repr(value)
    except (ValueError, RecursionError):  # integers of more than 4300 digits, lists in themselves
        return one_line(value)


def check_known(what: str, name, known: Iterable[str]):
    """Raise UnknownName unless `name` is a string among the known ones."""
    if not is_known(name, known):
        raise UnknownName(what, name if isinstance(name, str) else one_line(name), known)
