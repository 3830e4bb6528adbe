"""Stacks of planes as NumPy arrays, .npy, with wavelengths from the user."""

import io

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.archive import LONGEST_HEADER, NUMBERS, array_header
from gpusim.io.files import file_size, open_file, reading
from gpusim.io.scene.stacks import read_planes, whole_scale

WHAT = "a NumPy array (.npy)"


def read_npy(path, count: int, scale: float | None = None) -> tuple[np.ndarray, list[str]]:
    """Read `count` planes as float32 (count, rows, cols), and notes.

    The array is (count, rows, cols) or (rows, cols, count). scale: number that stands for 1; None
    is 1 for floats, and the largest of uint8 and uint16. Nothing is unpickled. Raises BadFile,
    DoesNotFit.
    """
    with open_file(path) as file:
        with reading(path, WHAT):
            head = io.BytesIO(file.read(LONGEST_HEADER))
            shape, fortran, dtype = array_header(head)
        start, size = head.tell(), file_size(file)
        if dtype.kind not in NUMBERS or dtype.subdtype or dtype.itemsize > 8:
            raise BadFile(path, f"{dtype}: wanted real numbers of up to 64 bits")
        if len(shape) != 3 or min(shape) < 1 or count not in (shape[0], shape[-1]):
            raise BadFile(
                path,
                f"shape {shape} for {count} wavelengths; wanted ({count}, rows, cols) or (rows, cols, "
                f"{count})",
            )
        if shape[0] == shape[-1]:
            raise BadFile(
                path,
                f"shape {shape} for {count} wavelengths: (bands, rows, cols) or (rows, cols, bands)? "
                "Use gpusim.scene_from(array, axis=...), or an .npz, whose key determines it",
            )
        wanted = shape[0] * shape[1] * shape[2] * dtype.itemsize
        if size - start != wanted:
            raise BadFile(
                path,
                f"truncated or damaged: {wanted} bytes of numbers expected, {size - start} present",
            )
        if scale is None:
            scale = whole_scale(path, dtype)
        with reading(path, "a file that can be mapped"):
            mapped = np.memmap(file, dtype, "r", start, shape, "F" if fortran else "C")
        return read_planes(
            path, mapped if shape[0] == count else mapped.transpose(2, 0, 1), scale=scale
        )
