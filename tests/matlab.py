"""Files of MATLAB 7.3 as MATLAB lays them out, written with h5py: a user block, classes, reversed axes, references."""

import h5py
import numpy as np

USER_BLOCK = 512
CLASSES = {"f8": "double", "f4": "single", "b1": "logical"}


def save73(path, variables, compression="gzip"):
    """Write {name: value} of numbers, texts, dicts (structs), lists (cell arrays), tuples of dicts (struct arrays)."""
    with h5py.File(path, "w", userblock_size=USER_BLOCK) as file:
        writer = _Writer(file, compression)
        for name, value in variables.items():
            writer.put(file, name, value)
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Wed Nov 25 2026 HDF5 schema 1.00 ."
    with open(path, "r+b") as file:
        file.write(text.ljust(116, b" ") + bytes(8) + b"\x00\x02IM")


class _Writer:
    def __init__(self, file, compression):
        self.file, self.compression = file, compression

    def put(self, group, name, value):
        if isinstance(value, dict):
            own = group.create_group(name)
            own.attrs["MATLAB_class"] = np.bytes_("struct")
            for field, part in value.items():
                self.put(own, field, part)
        elif isinstance(value, tuple):
            own = group.create_group(name)
            own.attrs["MATLAB_class"] = np.bytes_("struct")
            for field in value[0]:
                self.references(own, field, [one[field] for one in value])
        elif isinstance(value, list):
            self.references(group, name, value).attrs["MATLAB_class"] = np.bytes_("cell")
        elif isinstance(value, str):
            codes = np.frombuffer(value.encode("utf-16-le"), np.uint16)[:, None]
            made = self.array(group, name, codes, (1, len(codes)))
            made.attrs["MATLAB_class"] = np.bytes_("char")
            made.attrs["MATLAB_int_decode"] = np.int32(2)
        else:
            array = np.asarray(value)
            array = array.reshape((1,) * (2 - array.ndim) + array.shape)
            kind = CLASSES.get(array.dtype.str[1:], array.dtype.name)
            array = array.astype(np.uint8) if kind == "logical" else array
            self.array(group, name, array.T, array.shape).attrs["MATLAB_class"] = np.bytes_(kind)

    def array(self, group, name, stored, shape):
        if 0 in shape:  # MATLAB keeps the shape in place of the numbers
            made = group.create_dataset(name, data=np.array(shape, np.uint64))
            made.attrs["MATLAB_empty"] = np.uint8(1)
            return made
        return group.create_dataset(
            name, data=stored, compression=self.compression if stored.size > 8 else None
        )

    def references(self, group, name, values):
        kept = self.file.require_group("#refs#")
        found = []
        for value in values:
            label = f"a{len(kept)}"
            self.put(kept, label, value)
            found.append(kept[label].ref)
        return group.create_dataset(
            name, data=np.array(found, h5py.ref_dtype)[:, None], dtype=h5py.ref_dtype
        )
