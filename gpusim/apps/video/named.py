"""Lists of the command line: NAME=VALUE,NAME=VALUE,..."""

import argparse
from collections.abc import Callable
from math import isfinite
from typing import Any

from gpusim.domain.exposure import parse_seconds


def read_named(text: str, read: Callable[[str, str], Any], wanted: str) -> dict[str, Any]:
    """Return the values of a list by name.

    Args:
        text: NAME=VALUE,... with each NAME once.
        read: Function from name and text to a value. It raises ValueError or KeyError.
        wanted: Allowed lists in words, for the error.

    Raises:
        ArgumentTypeError: If a part of the text is malformed.
    """
    found: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        try:
            if not equals or name in found:
                raise ValueError
            found[name] = read(name, value)
        except (ValueError, KeyError):
            raise argparse.ArgumentTypeError(f"{part!r}: wanted {wanted}") from None
    return found


def read_positive(name: str, text: str) -> float:
    """Return a number above 0, for the name "exposure" a time [s]. Raises ValueError."""
    number = parse_seconds(text) if name == "exposure" else float(text)
    if not (isfinite(number) and number > 0):
        raise ValueError(text)
    return number
