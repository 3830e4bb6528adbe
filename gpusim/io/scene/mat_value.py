"""Variables of MATLAB files of any version."""

import math

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.files import reading

WHAT = "a MATLAB file"
HDF5 = b"\x89HDF\r\n\x1a\n"
USER_BLOCK = 512  # [byte] before the HDF5 data in MATLAB's files
LONGEST_TEXT = 2**16  # [byte] of names and comments
MOST_NAMES = 4096  # of variables in a file, and of fields in a struct


class Value:
    """A variable or a field: numbers, a text, a struct, or another kind.

    kind: "numbers", "text", "struct" (of one element), or other kinds in words. shape: as in
    MATLAB. names: names of a struct's fields.
    """

    def __init__(
        self, path, label: str, kind: str, shape: tuple[int, ...], names: tuple[str, ...] = ()
    ):
        self.path, self.label, self.kind, self.shape, self.names = path, label, kind, shape, names

    def get(self, *names: str) -> "Value | None":
        """Return the field of a field ...; None if one is missing, empty or no struct.

        Raises BadFile, DoesNotFit.
        """
        value = self
        for name in names:
            if name not in value.names:
                return None
            with reading(self.path, WHAT):
                value = value._field(name)
        return value if math.prod(value.shape) else None

    def numbers(self) -> np.ndarray:
        """Return real numbers of `shape` in the type of their MATLAB class.

        Raises BadFile, DoesNotFit.
        """
        if self.kind != "numbers":
            raise BadFile(self.path, f"{self.label}: {self.kind}, wanted real numbers")
        with reading(self.path, WHAT):
            self._check()
            require_memory(f"{self.path}: {self.label}", 8 * math.prod(self.shape))
            return self._array()

    def text(self) -> str | None:
        """Return a text of one line; None for anything else. Raises BadFile."""
        is_line = len(self.shape) == 2 and self.shape[0] == 1 and self.shape[1] <= LONGEST_TEXT
        if self.kind != "text" or not is_line:
            return None
        with reading(self.path, WHAT):
            self._check()
            return self._text()

    def _field(self, name: str) -> "Value":
        raise NotImplementedError

    def _check(self):
        """Raise BadFile if the file cannot hold the declared size of a value."""
        raise NotImplementedError

    def _array(self) -> np.ndarray:
        raise NotImplementedError

    def _text(self) -> str:
        raise NotImplementedError
