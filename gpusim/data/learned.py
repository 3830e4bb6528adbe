"""Tables of learned filters that come with the program, and their files.

A file is a NumPy archive with the fields of `Layout` and `FilterTable` under their names; `contrast_0`, `contrast_1`
and `detail_0`, `detail_1` are the weights along columns and rows. What may be None is missing then.
"""

import functools
import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile, GpusimError
from gpusim.domain.learned import FilterTable, Layout

ARRAYS = ("taps", "groups", "ratios", "shares", "noise", "floor", "strengths", "levels")


@functools.cache
def bayer_table() -> FilterTable:
    """The table for Bayer mosaics, camera red, green and blue out; `provenance` says what it was made from."""
    return read_table(Path(__file__).parent / "learned" / "bayer.npz")


def write_table(path, table: FilterTable):
    """Write a table; `read_table` gives the same back. The path ends in .npz. Raises BadFile."""
    layout = table.layout
    arrays: dict = {name: np.array(getattr(layout, name)) for name in (*ARRAYS, "mosaic", "outputs", "domain", "box")}
    arrays |= {"filters": table.filters, "provenance": np.array(table.provenance)}
    for name in ("contrast", "detail"):
        arrays |= {f"{name}_{axis}": weights for axis, weights in enumerate(getattr(layout, name) or ())}
    if table.offsets is not None:
        arrays["offsets"] = table.offsets
    whole = io.BytesIO()
    np.savez_compressed(whole, **arrays)
    try:
        Path(path).write_bytes(whole.getvalue())
    except OSError as error:
        raise BadFile(path, str(error)) from error


def read_table(path) -> FilterTable:
    """Read a table. Raises BadFile."""
    path = Path(path)
    if not path.is_file():
        raise BadFile(path, "no such file")
    try:
        with np.load(path) as stored:
            layout = Layout(mosaic=tuple(map(str, stored["mosaic"])), outputs=tuple(map(str, stored["outputs"])),
                            domain=str(stored["domain"]), contrast=(stored["contrast_0"], stored["contrast_1"]),
                            detail=(stored["detail_0"], stored["detail_1"]) if "detail_0" in stored else None,
                            box=int(stored["box"]), **{name: stored[name] for name in ARRAYS})
            return FilterTable(layout, stored["filters"], stored["offsets"] if "offsets" in stored else None,
                               str(stored["provenance"]))
    except KeyError as error:
        raise BadFile(path, f"not a table of learned filters: {error.args[0]}") from error
    except (GpusimError, OSError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile,
            zlib.error) as error:
        raise BadFile(path, f"not a table of learned filters ({error})") from error
