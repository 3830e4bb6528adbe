"""HDF5 files, also those of MATLAB 7.3, whose structs are groups and whose axes are reversed."""

import math
import mmap
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.archive import LARGEST_RATIO
from gpusim.io.files import open_file, reading
from gpusim.io.scene.values import HDF5, LONGEST_TEXT, MOST_NAMES, Value

SUFFIXES = (".h5", ".hdf5", ".he5", ".nc")
WHAT = "an HDF5 file"
USER_BLOCKS = (0, *(2**power for power in range(9, 21)))  # [byte] before the HDF5 data
HIDDEN = "#"  # begins names of MATLAB's internal items
CLASS, EMPTY = "MATLAB_class", "MATLAB_empty"  # attributes
LONGEST_CLASS = 256  # letters
LARGEST_HEAP = 2**20  # [byte] of a group's names
MOST_AXES = 4  # of numbers
# filters that expand by no more than LARGEST_RATIO
FILTERS = {1: "deflate", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}


@contextmanager
def open_hdf5(path) -> Iterator[Value]:
    """Open an HDF5 file as a struct of its groups and data sets, valid inside the block.

    Raises BadFile.
    """
    import h5py

    with open_file(path) as whole, reading(path, WHAT):
        if not os.fstat(whole.fileno()).st_size:
            raise BadFile(path, "is empty")
        with mmap.mmap(whole.fileno(), 0, access=mmap.ACCESS_READ) as data:
            start = user_block(data)
            if start is None:
                raise BadFile(path, f"not {WHAT}: it has no signature of one")
            _check_ends(data, start)
            is_matlab = start > 0 and data[:6] == b"MATLAB"
    with reading(path, WHAT):
        file = h5py.File(path, "r", locking=False)
    try:
        with reading(path, WHAT):
            root = _Item(path, "the file", file, os.path.getsize(path), is_matlab)
        yield root
    finally:
        file.close()


def user_block(data) -> int | None:
    """Return the number of bytes before the HDF5 data of a file; None if it has none."""
    return next((at for at in USER_BLOCKS if data[at : at + len(HDF5)] == HDF5), None)


class _Item(Value):
    """A group or a data set."""

    what = WHAT

    def __init__(self, path, label, item, size, is_matlab):
        import h5py

        self.item, self.size, self.is_matlab = item, size, is_matlab  # size: [byte] of the file
        of = _class(item)
        if isinstance(item, h5py.Group):
            if len(item) > MOST_NAMES:
                raise BadFile(path, f"more than {MOST_NAMES} names in {label}")
            # bytes: not UTF-8
            names = [str(name, "latin-1") if isinstance(name, bytes) else name for name in item]
            names = [name for name in names if not name.startswith(HIDDEN)]
            kind = "struct" if of in ("struct", "") else f"an array of class {of}"
            is_array = of == "struct" and names and self._holds_references(names[0])
            if is_array and item[names[0]].size > 1:
                kind = "a struct array"
            super().__init__(path, label, kind, (1, 1), tuple(names) if kind == "struct" else ())
            return
        if not isinstance(item, h5py.Dataset):
            super().__init__(path, label, "a link or a type of numbers", (1, 1))
            return
        self.rows_first = is_matlab or of != ""  # other programs write the axes as they are
        shape = (0, 0) if item.shape is None or EMPTY in item.attrs else item.shape
        is_number = item.dtype.kind in "iuf" and item.dtype.itemsize <= 8
        kind = "numbers" if is_number else f"an array of {item.dtype}"
        kind = {"char": "text", "cell": "a cell array"}.get(of, kind)
        super().__init__(path, label, kind, (shape[::-1] if self.rows_first else shape) or (1, 1))

    def attributes(self):
        """Return the attributes; those that are long or of other kinds as ""."""
        import h5py

        found: dict[str, np.ndarray | str] = {}
        with reading(self.path, self.what):
            for name in list(self.item.attrs)[:MOST_NAMES]:
                stored, value = self.item.attrs.get_id(name), ""
                # of objects only texts: HDF5 2.0 crashes on damaged lists of any length
                is_text = h5py.check_string_dtype(stored.dtype) and stored.shape in ((), (1,))
                is_known = stored.dtype.kind in "iufS" or is_text
                if is_known and stored.get_storage_size() <= LONGEST_TEXT:
                    value = self.item.attrs[name]
                    value = value[0] if stored.dtype.kind == "O" and stored.shape else value
                if isinstance(value, bytes):
                    value = value.decode("utf-8", "replace")
                is_word = isinstance(value, str) or np.asarray(value).dtype.kind not in "iuf"
                text = name.decode("latin-1") if isinstance(name, bytes) else name  # not UTF-8
                found[text] = str(value) if is_word else np.asarray(value)
        return found

    def _local_item(self, name):
        """Return the item with a name, or None if it is a link, perhaps to another file."""
        import h5py

        is_here = isinstance(self.item.get(name, getlink=True), h5py.HardLink)
        return self.item[name] if is_here else None

    def _holds_references(self, name):
        """Whether a field is of a struct array: references to its values in the elements."""
        import h5py

        item = self._local_item(name)
        if not isinstance(item, h5py.Dataset):
            return False
        return h5py.check_ref_dtype(item.dtype) is h5py.Reference and not _class(item)

    def _field(self, name):
        item = self._local_item(name)
        if self._holds_references(name) and item.size == 1:
            _check(self.path, self.label, item, self.size)
            item = self.item.file[np.asarray(item[()]).item()]
        label = f"{self.label}.{name}" if self.is_matlab else f"{self.label}/{name}"
        label = name if self.label == "the file" else label
        return _Item(self.path, label, item, self.size, self.is_matlab)

    def _check(self):
        _check(self.path, self.label, self.item, self.size)

    def _array(self):
        array = self.item[()]
        array = np.asarray(array).astype(array.dtype.newbyteorder("="), copy=False)
        return (array.T if self.rows_first else array).reshape(self.shape)

    def _text(self):
        return np.asarray(self.item[()]).astype("<u2").tobytes().decode("utf-16-le", "replace")


def _check_ends(data, base):
    """Raise ValueError if the structures of a file form a loop; base: start of its HDF5 data.

    HDF5's library (2.0) follows a loop of free blocks of a heap until memory ends, a loop of tree
    nodes until its stack ends, and parts of a global heap without a length for ever. It finds all
    other loops that were tried. Source: HDF5 File Format Specification 3.0, III.A, III.D, III.E.
    """
    version = data[base + len(HDF5)]
    at = base + (13 if version < 2 else 9)
    if data[at : at + 2] != b"\x08\x08":
        raise ValueError("addresses that are not of 8 bytes")
    for at in _places(data, b"HEAP\0\0\0\0"):
        size, block, start = struct.unpack_from("<QQQ", data, at + 8)
        left = min(size, LARGEST_HEAP) // 16  # a block has 16 bytes at least
        while block != 1 and block + 16 <= size and base + start + block + 16 <= len(data):
            if not left:
                raise ValueError("a heap whose free blocks form a loop, or too many")
            left, block = left - 1, struct.unpack_from("<Q", data, base + start + block)[0]
    for at in _places(data, b"GCOL"):
        end = min(at + struct.unpack_from("<Q", data, at + 8)[0], len(data))
        part = at + 16
        while part + 16 <= end:
            index, size = struct.unpack_from("<H6xQ", data, part)
            step = (16 + size + -size % 8 if index else size) % 2**64  # as the library counts
            if not 0 < step < 2**63:
                raise ValueError("a heap of texts that leads back to itself")
            part += step
    levels = {at - base: data[at + 5] for at in _places(data, b"TREE") if at + 24 <= len(data)}
    for at, level in levels.items():
        kind, entries = data[base + at + 4], struct.unpack_from("<H", data, base + at + 6)[0]
        # keys are names in groups; sizes and places of pieces, of any number of axes, in data sets
        for wide in (8,) if kind == 0 else range(24, 24 + 8 * MOST_AXES, 8):
            first = base + at + 24 + wide
            end = min(first + entries * (wide + 8), len(data) - 7) if level else first
            for child in range(first, end, wide + 8):
                if levels.get(struct.unpack_from("<Q", data, child)[0], -1) >= level:
                    raise ValueError("a tree that contains itself")


def _places(data, signature):
    """Yield the positions of a signature."""
    at = data.find(signature)
    while at >= 0 and at + 32 <= len(data):
        yield at
        at = data.find(signature, at + 1)


def _check(path, label, item, size):
    """Raise BadFile if the file cannot hold the declared size of a data set."""
    import h5py

    plist = item.id.get_create_plist()
    stored = item.id.get_storage_size()
    nbytes = item.size * item.dtype.itemsize
    layout = plist.get_layout()
    if len(item.shape) > MOST_AXES:
        raise BadFile(path, f"{label}: {len(item.shape)} axes, wanted at most {MOST_AXES}")
    inside = (h5py.h5d.CHUNKED, h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT)
    if layout not in inside or plist.get_external_count():
        raise BadFile(path, f"{label}: numbers that are not in the file itself")
    filters = [plist.get_filter(number)[0] for number in range(plist.get_nfilters())]
    if not set(filters) <= set(FILTERS):
        known = ", ".join(FILTERS.values())
        other = next(number for number in filters if number not in FILTERS)
        raise BadFile(
            path,
            f"{label}: packed by filter {other}; wanted {known}: h5repack -f GZIP=4 unpacks it",
        )
    largest = nbytes
    if layout == h5py.h5d.CHUNKED:
        largest = max(nbytes, math.prod(plist.get_chunk()) * item.dtype.itemsize)
    if stored > size or largest > stored * (LARGEST_RATIO if filters else 1):
        raise BadFile(
            path,
            f"{label}, truncated or damaged: {largest} bytes cannot come from {stored} in a file of "
            f"{size}",
        )


def _class(item) -> str:
    """Return the MATLAB class of a value, "" if the file does not have it."""
    if item is None or CLASS not in item.attrs:
        return ""
    stored = item.attrs.get_id(CLASS)
    if stored.shape != () or stored.dtype.kind != "S" or stored.dtype.itemsize > LONGEST_CLASS:
        return ""
    return bytes(item.attrs[CLASS]).decode("latin-1")
