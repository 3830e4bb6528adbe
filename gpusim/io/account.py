"""The account of a file: its fields, parts, layers and tags that a reader did not use.

A reader takes every field that it uses, ignores the names that say nothing about the light or the
geometry (compression, software, time), and puts `notes()` into its result.
"""

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Any

from gpusim.domain.errors import one_line

LONGEST_NAME, LONGEST_NOTE = 40, 240  # letters
EVEN = 0.005  # relative difference of two resolutions, from rounding to pixels per metre


class Fields:
    """Named fields of a file, some of which are used.

    Args:
        fields: Values by name, or names only: a name's value is then the name.
        what: The fields in words, in the note before their names.
    """

    def __init__(self, fields: Mapping[str, Any] | Iterable[str], what: str = "not used"):
        values = fields if isinstance(fields, Mapping) else {name: name for name in fields}
        self._values: dict[str, Any] = dict(values)
        self._what, self._done = what, set[str]()

    def __contains__(self, name: str) -> bool:
        """Return whether there is such a field. This does not use it."""
        return name in self._values

    def take(self, name: str, default: Any = None) -> Any:
        """Return the value of a field, or `default` if there is none. The field is used."""
        self._done.add(name)
        return self._values.get(name, default)

    def ignore(self, *patterns: str) -> None:
        """Leave fields out of the account.

        Args:
            patterns: Names, or patterns with * and ?. Names that the file does not have are fine.
        """
        self._done.update(
            name for name in self._values for one in patterns if fnmatchcase(str(name), one)
        )

    @property
    def unused(self) -> tuple[str, ...]:
        """Names of the fields that were neither taken nor ignored, in the order of the file."""
        return tuple(name for name in self._values if name not in self._done)

    def notes(self) -> tuple[str, ...]:
        """Return a note with the names of the unused fields, or nothing if there are none."""
        return note_of(self._what, self.unused)


def note_of(what: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return one note, "what: a, b, c", of limited length; nothing if there are no names."""
    shown = [one_line(name, LONGEST_NAME) or "(no name)" for name in names]
    kept = len(shown)
    while kept > 1 and sum(len(name) + 2 for name in shown[:kept]) > LONGEST_NOTE:
        kept -= 1
    rest = [f"{len(shown) - kept} more"] * (kept < len(shown))
    return (f"{what}: {', '.join(shown[:kept] + rest)}",) if shown else ()


def note_resolution(across, down) -> list[str]:
    """Return a note on numbers of pixels in a length that differ; nothing if they hardly do."""
    if across > 0 and down > 0 and abs(across / down - 1) > EVEN:
        return [f"resolution {across:g} x {down:g}: pixels are taken as square"]
    return []
