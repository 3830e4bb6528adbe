"""Tables of filters that are chosen on a first picture: files, and the built-in tables.

A file is a NumPy archive with the fields of `GuidedTable` under their names.
"""

import functools
from importlib import resources
from pathlib import Path

import numpy as np

from gpusim.domain.errors import UnknownName
from gpusim.domain.guided import BUILT_IN, GuidedTable
from gpusim.io.archive import TEXT, WHOLE, open_archive, write_archive
from gpusim.io.files import name_in_errors

NUMBERS = ("ratios", "diagonals", "shares", "noise", "floor", "strengths", "first", "second")
COPIES = 3.0  # of the numbers: packed, in their final types, and a sum of channels


@functools.cache
def guided_table(name: str) -> GuidedTable:
    """Return the built-in table of a mosaic by name; see its `provenance`. Raises UnknownName."""
    if name not in BUILT_IN:
        raise UnknownName("table", name, BUILT_IN)
    return read_guided(Path(str(resources.files("gpusim.data")), "learned", f"{name}.npz"))


def write_guided(path, table: GuidedTable):
    """Write a table for `read_guided`. The path ends in .npz. Raises BadFile."""
    arrays: dict = {name: getattr(table, name) for name in NUMBERS}
    for name in ("first", "second"):
        arrays[name] = arrays[name].astype(np.min_scalar_type(-abs(arrays[name]).max() - 1))
    arrays |= {name: np.array(getattr(table, name)) for name in ("mosaic", "radii", "box")}
    write_archive(path, arrays | {"provenance": np.array(table.provenance)})


def read_guided(path) -> GuidedTable:
    """Read a table. Raises BadFile and DoesNotFit."""
    with open_archive(path) as stored, name_in_errors(path):
        stored.require((*NUMBERS, "mosaic", "radii", "box", "provenance"))
        stored.shape("mosaic", TEXT, wanted=(None,))
        stored.shape("provenance", TEXT, wanted=())
        stored.shape("radii", WHOLE, wanted=(3,))
        stored.shape("box", WHOLE, wanted=())
        for name in NUMBERS:
            stored.shape(name)
        stored.require_memory(COPIES)
        return GuidedTable(
            mosaic=tuple(map(str, stored["mosaic"])),
            radii=tuple(stored["radii"].tolist()),
            box=int(stored["box"]),
            provenance=str(stored["provenance"]),
            **{name: stored[name] for name in NUMBERS},
        )
