"""Tables of learned filters: files, and the built-in table.

A file is a NumPy archive with the fields of `Layout` and `FilterTable` under their names;
`contrast_0`, `contrast_1` and `detail_0`, `detail_1` are the weights along columns and rows. Fields
that are None are missing.
"""

import functools
from importlib import resources
from pathlib import Path

import numpy as np

from gpusim.domain.learned import FilterTable, Layout
from gpusim.io.archive import TEXT, WHOLE, open_archive, write_archive
from gpusim.io.files import name_in_errors

ARRAYS = ("taps", "groups", "ratios", "shares", "noise", "floor", "strengths", "levels")
CONTRAST, DETAIL = (tuple(f"{name}_{axis}" for axis in (0, 1)) for name in ("contrast", "detail"))
TEXTS = {"mosaic": (None,), "outputs": (None,), "domain": (), "provenance": ()}  # names and shapes
COPIES = 2.0  # of the numbers: in their final types, and whether each is finite


@functools.cache
def bayer_table() -> FilterTable:
    """Return the table for Bayer mosaics with camera RGB as output; see its `provenance`."""
    return read_table(Path(str(resources.files("gpusim.data")), "learned", "bayer.npz"))


def write_table(path, table: FilterTable):
    """Write a table for `read_table`. The path ends in .npz. Raises BadFile."""
    layout = table.layout
    arrays: dict = {
        name: np.array(getattr(layout, name))
        for name in (*ARRAYS, "mosaic", "outputs", "domain", "box")
    }
    arrays |= {"filters": table.filters, "provenance": np.array(table.provenance)}
    for name in ("contrast", "detail"):
        for axis, weights in enumerate(getattr(layout, name) or ()):
            arrays[f"{name}_{axis}"] = weights
    if table.offsets is not None:
        arrays["offsets"] = table.offsets
    write_archive(path, arrays)


@np.errstate(
    invalid="ignore", over="ignore"
)  # damaged files; numbers that are not finite are refused
def read_table(path) -> FilterTable:
    """Read a table. Raises BadFile and DoesNotFit."""
    with open_archive(path) as stored, name_in_errors(path):
        detail = DETAIL if DETAIL[0] in stored else ()
        numbers = (*ARRAYS, *CONTRAST, *detail, "filters")
        stored.require((*TEXTS, *numbers, "box"))
        for name, shape in TEXTS.items():
            stored.shape(name, TEXT, wanted=shape)
        for name in (*numbers, *stored.keys() & {"offsets"}):
            stored.shape(name)
        stored.shape("box", WHOLE, wanted=())
        stored.require_memory(COPIES)
        layout = Layout(
            mosaic=tuple(map(str, stored["mosaic"])),
            outputs=tuple(map(str, stored["outputs"])),
            domain=str(stored["domain"]),
            contrast=tuple(stored[name] for name in CONTRAST),
            detail=tuple(stored[name] for name in detail) or None,
            box=int(stored["box"]),
            **{name: stored[name] for name in ARRAYS},
        )
        offsets = stored["offsets"] if "offsets" in stored else None
        provenance = str(stored["provenance"])
        return FilterTable(layout, stored["filters"], offsets, provenance)
