"""NumPy archives (.npz) of plain arrays, read with bounded memory and written atomically."""

import io
import math
import sys
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.account import note_of
from gpusim.io.atomic import atomic_path
from gpusim.io.files import file_size, open_file, reading

NUMBERS, WHOLE, TEXT = "uif", "ui", "U"  # NumPy's letters for kinds of types
KINDS = {NUMBERS: "real numbers", WHOLE: "whole numbers", TEXT: "text"}
WHAT = "an .npz archive of plain arrays"
# of an array's header; the last two differ only in the encoding of names
VERSIONS = ((1, 0), (2, 0), (3, 0))
# NumPy's methods; zipfile inflates others without a bound
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1  # bit of a zip member's flags
LARGEST_RATIO = 1032  # of deflate: 258 bytes of 2 bits (RFC 1951)
LONGEST_DIRECTORY = 2**20  # [byte]; some ten thousand arrays
LONGEST_HEADER = 10_000  # [byte] of an array, NumPy's own limit
LONGEST_TEXT = 2**20  # [byte] of an array of texts: names and the source of a table
PIECE = 2**18  # [byte] read at once


@dataclass(frozen=True)
class _Member:
    """An array's header: shape, dtype and order; its numbers begin at byte `start`."""

    info: zipfile.ZipInfo
    shape: tuple[int, ...]
    dtype: np.dtype
    fortran: bool
    start: int

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


class Archive(Mapping):
    """Arrays of an open .npz by name; shapes are known at once, numbers are read on access."""

    def __init__(self, path, file):
        self.path, self._size = path, file_size(file)
        self._zip, self._members = zipfile.ZipFile(_Bounded(file)), {}  # type: ignore[arg-type]
        self._used: set[str] = set()
        for info in self._zip.infolist():
            name = info.filename.removesuffix(".npy")
            if name in self._members:
                raise BadFile(path, f"holds two arrays {name!r}")
            self._members[name] = self._member(info)

    def refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def _member(self, info):
        """Return the header of a member; raise BadFile if the file cannot hold its size."""
        what = f"array {info.filename!r}"
        if info.flag_bits & ENCRYPTED or info.compress_type not in METHODS:
            self.refuse(
                f"{what} is encrypted or uses another compression than NumPy; write it with "
                "np.savez or np.savez_compressed"
            )
        if info.compress_size > self._size or info.file_size > LARGEST_RATIO * info.compress_size:
            self.refuse(
                f"{what}, truncated or damaged: {info.file_size} bytes cannot come from "
                f"{info.compress_size} in a file of {self._size}"
            )
        with self._zip.open(info) as stream:
            head = io.BytesIO(stream.read(LONGEST_HEADER))
        shape, fortran, dtype = array_header(head)
        member = _Member(info, shape, dtype, fortran, head.tell())
        if dtype.kind not in "biufcUS" or dtype.subdtype:
            self.refuse(f"{what} holds {dtype}: not {WHAT}")
        if min(shape, default=0) < 0 or member.nbytes != info.file_size - member.start:
            self.refuse(
                f"{what}, truncated or damaged: shape {shape} of {dtype} are not its "
                f"{info.file_size - member.start} bytes"
            )
        if dtype.kind in "US" and member.nbytes > LONGEST_TEXT:
            self.refuse(f"{what}: {member.nbytes} bytes of text; at most {LONGEST_TEXT} are read")
        return member

    def __contains__(self, name):  # Mapping's own would read the array
        return name in self._members

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self):
        return len(self._members)

    def require(self, names):
        """Raise BadFile if an array is missing."""
        missing = [name for name in names if name not in self]
        if missing:
            self.refuse(f"lacks {', '.join(missing)}; it has {', '.join(self) or 'nothing'}")

    def shape(self, name, kinds=NUMBERS, *, wanted=None) -> tuple[int, ...]:
        """Return the shape of an array without reading it.

        kinds: NumPy's letters for the allowed kinds of types. wanted: required shape, with None for
        any length; None is any shape. Raises BadFile if the array is missing or different.
        """
        if name not in self:
            self.refuse(f"key {name!r} is missing; there are {', '.join(self) or 'none'}")
        shape, dtype = self._members[name].shape, self._members[name].dtype
        if dtype.kind not in kinds:
            self.refuse(f"{name}: {dtype}, wanted {KINDS.get(kinds, KINDS[NUMBERS])}")
        if wanted is not None and not (
            len(shape) == len(wanted)
            and 0 not in shape
            and all(n in (None, m) for n, m in zip(wanted, shape, strict=True))
        ):
            lengths = ", ".join("any" if n is None else str(n) for n in wanted)
            self.refuse(f"{name}: shape {shape}, wanted ({lengths})")
        return shape

    def __getitem__(self, name) -> np.ndarray:
        """Read an array. Raises KeyError, BadFile."""
        member = self._members[name]
        self._used.add(name)
        with reading(self.path, WHAT), self._zip.open(member.info) as stream:
            array = np.empty(member.shape[::-1] if member.fortran else member.shape, member.dtype)
            numbers = array.reshape(-1).view(np.uint8).data if member.nbytes else memoryview(b"")
            stream.read(member.start)
            for first in range(0, member.nbytes, PIECE):
                piece = numbers[first : first + PIECE]
                if stream.readinto(piece) != len(piece):
                    raise EOFError(f"{member.info.filename!r} ends early")
            if array.dtype.kind == "U" and array.size:
                letter = np.dtype(np.uint32).newbyteorder(array.dtype.byteorder)
                letters = array.reshape(-1).view(letter)
                if letters.max() > sys.maxunicode:  # else Python raises ValueError
                    raise UnicodeError(f"{member.info.filename!r} holds invalid characters")
        return array.transpose() if member.fortran else array

    def notes(self) -> tuple[str, ...]:
        """Return a note with the names of the arrays that were not read, or nothing if there are none."""
        return note_of("keys not used", [name for name in self if name not in self._used])

    def require_memory(self, copies: float):
        """Raise DoesNotFit unless all arrays fit as stored plus `copies` of them in float64."""
        members = self._members.values()
        needed = sum(one.nbytes + 8 * copies * math.prod(one.shape) for one in members)
        require_memory(f"{self.path}: {len(self)} arrays", math.ceil(needed))


class ArchivePart(Mapping):
    """The arrays whose names begin with a prefix, by the rest; other names are of the whole archive.

    whole: an open archive or a part of one. prefix: begins the names.
    """

    def __init__(self, whole: "Archive | ArchivePart", prefix: str):
        self.whole, self.prefix = whole, prefix

    def _full(self, name):
        own = self.prefix + name
        return own if own in self.whole else name

    def has_own(self, name: str) -> bool:
        """Return True if an array has this name after the prefix."""
        return self.prefix + name in self.whole

    def __contains__(self, name):
        return self._full(name) in self.whole

    def __iter__(self) -> Iterator[str]:
        own = [name.removeprefix(self.prefix) for name in self.whole if self._is_own(name)]
        return iter(dict.fromkeys([*own, *(name for name in self.whole if "." not in name)]))

    def _is_own(self, name):
        return name.startswith(self.prefix)

    def __len__(self):
        return len(list(iter(self)))

    def __getitem__(self, name) -> np.ndarray:
        return self.whole[self._full(name)]

    def shape(self, name, kinds=NUMBERS, *, wanted=None) -> tuple[int, ...]:
        """Return the shape of an array, see `Archive.shape`."""
        return self.whole.shape(self._full(name), kinds, wanted=wanted)

    def notes(self) -> tuple[str, ...]:
        """Return no notes: the whole archive has them."""
        return ()


def array_header(head: io.BytesIO) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, Fortran order and type of an array (.npy); leave `head` at its numbers.

    head: its first LONGEST_HEADER bytes. Raises any error of NumPy on damaged headers.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that Python 2 wrote
        version = np.lib.format.read_magic(head)
        if version not in VERSIONS:
            raise ValueError(f"version {version[0]}.{version[1]} of its header")
        read = np.lib.format.read_array_header_2_0
        if version == (1, 0):
            read = np.lib.format.read_array_header_1_0
        return read(head)


class _Bounded:
    """A file that refuses reads longer than a zip directory may be."""

    def __init__(self, file):
        self.file, self.seek, self.tell, self.seekable = file, file.seek, file.tell, file.seekable

    def read(self, size=-1):
        if size > LONGEST_DIRECTORY:
            raise zipfile.BadZipFile(
                f"a directory of {size} bytes; at most {LONGEST_DIRECTORY} are read"
            )
        return self.file.read(size)


def write_archive(path, arrays: Mapping[str, Any]):
    """Write arrays by name as a compressed .npz. Raises BadFile."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


@contextmanager
def open_archive(path):
    """Open an .npz as an `Archive` without unpickling. Raises BadFile."""
    with open_file(path) as file:
        with reading(path, WHAT):
            archive = Archive(path, file)
        yield archive
