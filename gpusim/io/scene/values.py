"""Named values of MATLAB and HDF5 files: a tree of structs with numbers and texts."""

import math

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.files import reading

HDF5 = b"\x89HDF\r\n\x1a\n"
LONGEST_TEXT = 2**16  # [byte] of names and comments
MOST_NAMES = 4096  # of variables in a file, and of fields in a struct


class Value:
    """A variable or a field: numbers, a text, a struct, or another kind.

    what: kind of file in words. label: its name, with the names of the structs around it. kind:
    "numbers", "text", "struct" (of one element), or other kinds in words. shape: as its program
    shows it. names: names of a struct's fields. rows_first: whether the program has the axes
    (rows, cols, bands) by convention, as MATLAB. A value is used if its numbers or text are read.
    """

    what = "a MATLAB file"
    rows_first = True

    def __init__(
        self, path, label: str, kind: str, shape: tuple[int, ...], names: tuple[str, ...] = ()
    ):
        self.path, self.label, self.kind, self.shape, self.names = path, label, kind, shape, names
        self.is_used, self._got = False, dict[str, Value]()

    def get(self, *names: str) -> "Value | None":
        """Return the field of a field ...; None if one is missing, empty or no struct.

        Raises BadFile, DoesNotFit.
        """
        value = self
        for name in names:
            if name not in value.names:
                return None
            if name not in value._got:
                with reading(self.path, self.what):
                    value._got[name] = value._field(name)
            value = value._got[name]
        return value if math.prod(value.shape) else None

    def numbers(self) -> np.ndarray:
        """Return real numbers of `shape` in the type of the file.

        Raises BadFile, DoesNotFit.
        """
        if self.kind != "numbers":
            raise BadFile(self.path, f"{self.label}: {self.kind}, wanted real numbers")
        self.is_used = True
        with reading(self.path, self.what):
            self._check()
            require_memory(f"{self.path}: {self.label}", 8 * math.prod(self.shape))
            return self._array()

    def text(self) -> str | None:
        """Return a text of one line; None for anything else. Raises BadFile."""
        is_line = len(self.shape) == 2 and self.shape[0] == 1 and self.shape[1] <= LONGEST_TEXT
        if self.kind != "text" or not is_line:
            return None
        self.is_used = True
        with reading(self.path, self.what):
            self._check()
            return self._text()

    def attributes(self) -> dict[str, np.ndarray | str]:
        """Return the attributes of a value in HDF5: numbers and texts by name. Raises BadFile."""
        return {}

    def leaves(self) -> list["Value"]:
        """Return the values inside that are neither structs nor empty, in the order of the file.

        Raises BadFile.
        """
        found, seen, rest = [], 0, [self.get(name) for name in reversed(self.names)]
        while rest:
            value, seen = rest.pop(), seen + 1
            if seen > MOST_NAMES:  # groups of HDF5 may hold themselves
                raise BadFile(self.path, f"more than {MOST_NAMES} values in {self.label}")
            if value is not None and value.kind == "struct":
                rest += [value.get(name) for name in reversed(value.names)]
            elif value is not None:
                found.append(value)
        return found

    def unused(self) -> list[str]:
        """Return the labels of the values inside that were not read. Raises BadFile."""
        return [value.label for value in self.leaves() if not value.is_used]

    def _field(self, name: str) -> "Value":
        raise NotImplementedError

    def _check(self):
        """Raise BadFile if the file cannot hold the declared size of a value."""

    def _array(self) -> np.ndarray:
        raise NotImplementedError

    def _text(self) -> str:
        raise NotImplementedError
