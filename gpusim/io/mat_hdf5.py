"""MATLAB's files of version 7.3, which are HDF5: variables are data sets, structs are groups, axes are reversed."""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.archive import LARGEST_RATIO
from gpusim.io.files import reading
from gpusim.io.mat import MOST_NAMES, WHAT, Value

HIDDEN = "#"  # begins the names of what MATLAB keeps beside the variables
CLASS, EMPTY = "MATLAB_class", "MATLAB_empty"  # attributes
LONGEST_CLASS = 256  # letters
FILTERS = (1, 2, 3)  # deflate, shuffle, fletcher32: those that cannot make more than LARGEST_RATIO of what is stored


@contextmanager
def open_hdf5(path) -> Iterator[Value]:
    """Open a file of version 7.3 as `open_mat` does. Raises BadFile."""
    try:
        import h5py
    except ImportError:
        raise BadFile(path, "a MATLAB file of version 7.3 (HDF5): wanted pip install 'gpusim[isetcam]', or the file "
                            "written by save('scene.mat', 'scene', '-v7')") from None
    with reading(path, WHAT):
        file = h5py.File(path, "r", locking=False)
    try:
        with reading(path, WHAT):
            root = _Item(path, "the file", file, os.path.getsize(path))
        yield root
    finally:
        file.close()


class _Item(Value):
    """A group or a data set."""

    def __init__(self, path, label, item, size):
        import h5py

        self.item, self.size = item, size  # [byte] of the file
        of = _class(item)
        if isinstance(item, h5py.Group):
            if len(item) > MOST_NAMES:
                raise BadFile(path, f"more than {MOST_NAMES} names in {label}")
            names = [str(name, "latin-1") if isinstance(name, bytes) else name for name in item]  # bytes: not UTF-8
            names = [name for name in names if not name.startswith(HIDDEN)]
            kind = "struct" if of in ("struct", "") else f"no plain array of class {of}"
            if of == "struct" and names and self._is_of_references(names[0]) and item[names[0]].size > 1:
                kind = "a struct array"
            super().__init__(path, label, kind, (1, 1), tuple(names) if kind == "struct" else ())
            return
        if not isinstance(item, h5py.Dataset):
            raise ValueError(f"{label} is neither a group nor a data set")
        shape = (0, 0) if item.shape is None or EMPTY in item.attrs else item.shape[::-1]
        if of == "char":
            kind = "text"
        elif of == "cell":
            kind = "a cell array"
        else:
            kind = "numbers" if item.dtype.kind in "iuf" and item.dtype.itemsize <= 8 else f"an array of {item.dtype}"
        super().__init__(path, label, kind, shape)

    def _linked(self, name):
        """What has a name in this file, not in another."""
        import h5py

        if not isinstance(self.item.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"{name} is a link to something else")
        return self.item[name]

    def _is_of_references(self, name):
        """Whether a field is one of a struct array: references to its values in the elements."""
        import h5py

        item = self._linked(name)
        return (isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference
                and not _class(item))

    def _field(self, name):
        item = self._linked(name)
        if self._is_of_references(name) and item.size == 1:
            _check(self.path, self.label, item, self.size)
            item = self.item.file[np.asarray(item[()]).item()]
        return _Item(self.path, f"{self.label}.{name}" if self.label != "the file" else name, item, self.size)

    def _check(self):
        _check(self.path, self.label, self.item, self.size)

    def _array(self):
        array = self.item[()]
        return np.asarray(array).astype(array.dtype.newbyteorder("="), copy=False).T

    def _text(self):
        return np.asarray(self.item[()]).astype("<u2").tobytes().decode("utf-16-le", "replace")


def _check(path, label, item, size):
    """Raise BadFile where the file does not hold what a data set declares."""
    import h5py

    made, stored, nbytes = item.id.get_create_plist(), item.id.get_storage_size(), item.size * item.dtype.itemsize
    layout = made.get_layout()
    if layout not in (h5py.h5d.CHUNKED, h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT) or made.get_external_count():
        raise BadFile(path, f"{label}: numbers that are not in the file itself")
    filters = [made.get_filter(number)[0] for number in range(made.get_nfilters())]
    if not set(filters) <= set(FILTERS):
        raise BadFile(path, f"{label}: packed by another method than MATLAB's")
    largest = max(nbytes, math.prod(made.get_chunk()) * item.dtype.itemsize if layout == h5py.h5d.CHUNKED else 0)
    if stored > size or largest > stored * (LARGEST_RATIO if filters else 1):
        raise BadFile(path, f"{label}, truncated or damaged: {largest} bytes cannot come of {stored} in a "
                            f"file of {size}")


def _class(item) -> str:
    """Class of a value in MATLAB, "" where the file does not say."""
    if CLASS not in item.attrs:
        return ""
    stored = item.attrs.get_id(CLASS)
    if stored.shape != () or stored.dtype.kind != "S" or stored.dtype.itemsize > LONGEST_CLASS:
        return ""
    return bytes(item.attrs[CLASS]).decode("latin-1")
