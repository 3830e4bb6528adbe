"""What can go wrong for a user, each with the value, the place and what is allowed.

The command line prints `str(error)` on one line and exits with status 2; nothing here is ever a traceback.
"""

import difflib
from numbers import Integral

LONGEST = 480  # letters of a message, so that "gpusim: " and a program's own words still fit on a line of 500
LONGEST_PATH, LONGEST_VALUE = 160, 120  # letters of what a message repeats from the input


def one_line(text, longest: int = LONGEST) -> str:
    """Return `text` as one line of at most `longest` letters that any terminal can show, its middle left out.

    The beginning says what and where, the end what to do: of what is too long a third of the end is kept.
    """
    try:
        text = str(text)
    except (
        ValueError,
        RecursionError,
    ):  # a whole number of more than 4300 digits, a list that holds itself
        text = f"a {type(text).__name__} too long to show"
    if len(text) > 8 * longest:  # not all of a long build log has to be looked at
        text = f"{text[: 4 * longest]} {text[-4 * longest :]}"
    text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    end = longest // 3
    return text if len(text) <= longest else f"{text[: longest - end - 5]} ... {text[-end:]}"


def shown(value) -> str:
    """`value` as it is written in Python, in at most LONGEST_VALUE letters: what a message repeats from the input."""
    return one_line(repr(value) if isinstance(value, str) else value, LONGEST_VALUE)


class GpusimError(Exception):
    """Base of every error that a user's input can cause: one line. `details` is the text before it was shortened."""

    def __init__(self, message=""):
        self.details = str(message)
        super().__init__(one_line(message))


class OutOfRange(GpusimError):
    """A number outside its allowed range.

    Example: ``sensor.fill_factor = 1.4: allowed is 0 < fill_factor <= 1``.
    """

    def __init__(self, key: str, value, allowed: str):
        super().__init__(
            f"{one_line(key, LONGEST_VALUE)} = {one_line(value, LONGEST_VALUE)}: allowed is {allowed}"
        )


class UnknownName(GpusimError):
    """A name that is not in the list of names, with the nearest one suggested."""

    def __init__(self, what: str, name: str, known):
        super().__init__(
            f"unknown {one_line(what, LONGEST_PATH)} {shown(name)}{near(name, sorted(known))}"
        )


class BadFile(GpusimError):
    """A file that is missing, truncated or does not hold what it should: ``path: what is wrong``."""

    def __init__(self, path, problem: str):
        super().__init__(f"{one_line(path, LONGEST_PATH)}: {problem}")


class BadData(GpusimError):
    """An array or a spectrum that cannot be simulated (NaN, negative radiance, unsorted wavelengths ...)."""


class NotMet(GpusimError):
    """A tolerance that the best affordable plan is not predicted to keep, where that is to be an error."""


class DoesNotFit(GpusimError):
    """The estimated memory exceeds what the device has; raised before anything is allocated."""

    def __init__(self, what: str, needed: int, available: int, where: str):
        super().__init__(
            f"{what} needs about {needed / 2**30:.2f} GiB, {where} has {available / 2**30:.2f} GiB; "
            "use a smaller scene or another device"
        )


class Conflict(GpusimError):
    """An option that has no meaning beside the others: ``--strict: look --what mtf does not use it; leave it out``."""

    def __init__(self, option: str, reason: str, remedy: str):
        super().__init__(f"{option}: {reason}; {remedy}")


class Missing(GpusimError):
    """A library that is not installed, which only some of the package needs, with the way to get it."""


class DeviceError(GpusimError):
    """A device that is missing, unusable or failed, with the reason the driver gave."""


class OutOfMemory(DeviceError):
    """Memory that a driver refuses while a device is in use, though the estimate said that it would fit."""

    def __init__(self, what: str, nbytes: int, where: str, available: int, reason: str):
        size = f" ({nbytes / 2**30:.3g} GiB)" if nbytes else ""
        super().__init__(
            f"{where} refused memory for {what}{size}: {one_line(reason, LONGEST_VALUE)}; it has "
            f"{available / 2**30:.2f} GiB, which other processes may be using: close them, or use a "
            "smaller scene, fewer frames in a batch or another device"
        )


def checked_count(key: str, value, least: int = 1, most: float = float("inf")) -> int:
    """Return a whole number of things as it is. Raises OutOfRange."""
    if (
        not isinstance(value, Integral)
        or isinstance(value, bool)
        or not least <= int(value) <= most
    ):
        raise OutOfRange(
            key,
            shown(value),
            f"a whole number, {least}" + (" or more" if most == float("inf") else f" .. {most}"),
        )
    return int(value)


def is_known(name, known) -> bool:
    """Whether `name` is a string among the known ones; what is no string is not."""
    return isinstance(name, str) and name in known


def near(name: str, known) -> str:
    """Hint at the known name nearest to `name`, or list all: "; did you mean 'x'?" or "; known: x, y"."""
    nearest = difflib.get_close_matches(one_line(name)[:LONGEST_VALUE], known, n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else f"; known: {', '.join(known)}"


def check_range(owner: str, part, key: str, allowed: str, good, unit: str = ""):
    """Raise OutOfRange unless `good` holds for the field `key` of `part`, or it is None and that is its default."""
    value = getattr(part, key)
    if value is None and getattr(type(part), key, 0) is None:
        return
    try:
        right = good(value)
    except (TypeError, ValueError, OverflowError):  # not of a kind that can be compared
        right, value = False, value if isinstance(value, int) else repr(value)
    if not right:
        short = f"{value:.6g}" if isinstance(value, float) else one_line(value, LONGEST_VALUE)
        raise OutOfRange(f"{owner}.{key}", f"{short} {unit}".rstrip(), allowed)
