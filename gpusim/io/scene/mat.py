"""MATLAB files: variables by name, each read on access.

Version 5 (`save` with -v6 or -v7) is read here, version 7.3, which is HDF5, by
`gpusim.io.scene.hdf5`. Source: MathWorks, MAT-File Format (R2019b). Memory is taken only after
checking that the file has the declared bytes. A file of version 5 does not declare its number of
variables: if it is cut off between two of them, the rest is missed.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.archive import LARGEST_RATIO, PIECE
from gpusim.io.files import file_size, open_file, reading
from gpusim.io.scene.hdf5 import USER_BLOCKS, open_hdf5, user_block
from gpusim.io.scene.values import HDF5, LONGEST_TEXT, MOST_NAMES, Value

WHAT = "a MATLAB file"
HEADER = 128  # [byte] of version 5
MATRIX, COMPRESSED = 14, 15  # types of elements
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
LETTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
CLASSES = dict(enumerate("f8 f4 i1 u1 i2 u2 i4 u4 i8 u8".split(), start=6))
STRUCT, CHAR = 2, 4
OTHERS = {1: "a cell array", 5: "a sparse matrix", 16: "a function handle"}
COMPLEX = 0x800  # flag
HEAD = 1024  # [byte] of a variable that include its name: 32 dimensions and 63 letters take less


@contextmanager
def open_mat(path) -> Iterator[Value]:
    """Open a MATLAB file as a struct of its variables, valid inside the block. Raises BadFile."""
    with open_file(path) as file:
        with reading(path, WHAT):
            head = file.read(USER_BLOCKS[1] + len(HDF5))
            root = None if user_block(head) is not None else _Root(path, file, head)
        if root is not None:
            yield _require_variables(root)
            return
    with open_hdf5(path) as variables:
        yield _require_variables(variables)


def _require_variables(root):
    if not root.names:
        raise BadFile(root.path, "holds no variables; is it truncated?")
    return root


class _Root(Value):
    """A file of version 5 as the struct of its variables."""

    def __init__(self, path, file, head):
        self.order = {b"IM": "<", b"MI": ">"}.get(head[HEADER - 2 : HEADER])
        if self.order is None or 0 in head[:4]:
            raise BadFile(
                path,
                "not a MATLAB file of version 5 .. 7.3, which can hold structs; write it with "
                "save('scene.mat', 'scene', '-v7')",
            )
        self.file, self.size, self.places, start = file, file_size(file), {}, HEADER
        while start + 8 <= self.size:
            kind, length = struct.unpack(f"{self.order}II", self._read_stored(start, 8))
            if kind not in (MATRIX, COMPRESSED):
                why = f"truncated or damaged at byte {start}: a variable of type {kind}"
                raise BadFile(path, why)
            place = (start + 8, length, kind == COMPRESSED)
            self.places[_head(self._variable(path, place, HEAD), self.order)[2]] = place
            if len(self.places) > MOST_NAMES:
                raise BadFile(path, f"more than {MOST_NAMES} variables")
            start += 8 + length
        if start != self.size:
            left = self.size - start
            raise BadFile(
                path, f"truncated or damaged at byte {start}: {left} bytes left, no variable"
            )
        super().__init__(path, "the file", "struct", (1, 1), tuple(self.places))

    def _field(self, name):
        head = self._variable(self.path, self.places[name], HEAD)
        return _Matrix(self.path, name, head, self.order, lambda: self._whole(name))

    def _whole(self, name):
        return self._variable(self.path, self.places[name])

    def _variable(self, path, place, most=2**63):
        """Return the bytes of a variable, or the first `most` of them."""
        start, length, packed = place
        if start + length > self.size:
            why = f"truncated: {length} bytes from byte {start} on in a file of {self.size}"
            raise BadFile(path, why)
        if packed:
            kind, unpacked = struct.unpack(f"{self.order}II", self._inflate(start, length, 8))
            if kind != MATRIX or unpacked > LARGEST_RATIO * length:
                raise BadFile(
                    path,
                    f"truncated or damaged at byte {start}: {unpacked} bytes of type {kind} cannot be "
                    f"packed in {length}",
                )
        wanted = min(unpacked if packed else length, most)
        require_memory(f"{path}: a variable", wanted)
        if not packed:
            return self._read_stored(start, wanted)
        return self._inflate(start, length, 8 + wanted, to_end=wanted == unpacked)[8:]

    def _read_stored(self, start, length):
        self.file.seek(start)
        return memoryview(self.file.read(length))

    def _inflate(self, start, length, wanted, to_end=False):
        """Return the first `wanted` bytes packed in `length` bytes from `start`.

        to_end: nothing may follow.
        """
        self.file.seek(start)
        stream, whole, filled = zlib.decompressobj(), memoryview(bytearray(wanted)), 0
        while filled < wanted:
            packed = stream.unconsumed_tail
            if not packed:
                packed = self.file.read(min(PIECE, length))
                length -= len(packed)
            piece = stream.decompress(packed, min(PIECE, wanted - filled))
            if not piece and not packed:
                raise EOFError("packed numbers end early")
            whole[filled : filled + len(piece)] = piece
            filled += len(piece)
        if to_end:  # the checksum is there
            stream.decompress(stream.unconsumed_tail + self.file.read(min(PIECE, length)), 1)
            if not stream.eof:
                raise EOFError("more is packed than declared, or the check sum is missing")
        return whole


class _Matrix(Value):
    """A variable or field of version 5; `whole` returns its bytes, of which `view` has the head."""

    def __init__(self, path, label, view, order, whole):
        self.view, self.order, self.whole = view, order, whole
        if not len(view):  # MATLAB may write nothing for []
            super().__init__(path, label, "numbers", (0, 0))
            return
        flags, shape, _, self.start = _head(view, order)
        self.type, self.places = flags & 0xFF, {}
        kind = OTHERS.get(self.type, "an object")
        if self.type == CHAR:
            kind = "text"
        elif self.type in CLASSES:
            kind = "complex numbers" if flags & COMPLEX else "numbers"
        elif self.type == STRUCT:
            kind = "struct" if math.prod(shape) == 1 else "a struct array"
        if kind == "struct":
            self.view = whole()
            self._find_fields()
        super().__init__(path, label, kind, shape, tuple(self.places))

    def _find_fields(self):
        _, length, at = _element(self.view, self.order, self.start)
        _, letters, at = _element(self.view, self.order, at)
        (wide,) = struct.unpack(f"{self.order}i", length)
        if not 0 < wide <= LONGEST_TEXT or len(letters) > MOST_NAMES * wide:
            raise ValueError("names of fields that are too long or too many")
        for first in range(0, len(letters), wide):
            kind, data, at = _element(self.view, self.order, at)
            if kind != MATRIX:
                raise ValueError(f"a field of type {kind}")
            self.places[_letters(letters[first : first + wide])] = data

    def _field(self, name):
        data = self.places[name]
        return _Matrix(self.path, f"{self.label}.{name}", data, self.order, lambda: data)

    def _array(self):
        kind, data, _ = _element(self.whole(), self.order, self.start)
        numbers = np.frombuffer(data, self.order + TYPES[kind])
        return numbers.astype(CLASSES[self.type], copy=False).reshape(self.shape, order="F")

    def _text(self):
        kind, data, _ = _element(self.whole(), self.order, self.start)
        name = LETTERS[kind]
        ending = {"<": "-le", ">": "-be"}[self.order] if name in ("utf-16", "utf-32") else ""
        return bytes(data[: 4 * LONGEST_TEXT]).decode(name + ending, "replace")


def _element(view, order, at):
    """Return type and bytes of the element at `at`, and the start of the next one."""
    (kind,) = struct.unpack_from(f"{order}I", view, at)
    if kind >> 16:  # a small element: its length in the upper half, its bytes at once
        return kind & 0xFFFF, view[at + 4 : at + 4 + min(kind >> 16, 4)], at + 8
    (length,) = struct.unpack_from(f"{order}I", view, at + 4)
    data = view[at + 8 : at + 8 + length]
    if len(data) < length:
        raise EOFError(f"an element of {length} bytes in {len(view) - at - 8}")
    return kind, data, at + 8 + length + -length % 8


def _head(view, order):
    """Return flags, shape and name of a matrix, and the start of its content."""
    _, flags, at = _element(view, order, 0)
    _, lengths, at = _element(view, order, at)
    _, name, at = _element(view, order, at)
    shape = tuple(int(length) for length in np.frombuffer(lengths, f"{order}i4"))
    if min(shape, default=-1) < 0:
        raise ValueError(f"a variable of shape {shape}")
    return struct.unpack_from(f"{order}I", flags)[0], shape, _letters(name), at


def _letters(data):
    return bytes(data).split(b"\0")[0].decode("latin-1")
