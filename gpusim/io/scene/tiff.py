"""TIFF: photographs, and stacks of planes with wavelengths from the user.

Source: TIFF Revision 6.0 (Adobe, 1992); tifffile reads its directories and pixels.
"""

import math
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.files import file_size, open_file, reading, silence
from gpusim.io.orientation import turn

SUFFIXES = (".tif", ".tiff")
MOST_PAGES = 4096
LZW = 5
FLOATING = 3  # predictor
# Largest expansion of a stored byte: uncompressed; LZW, codes of 12 bits for up to 4096 bytes
# (section 13); deflate with two codes, 258 bytes of 2 bits (RFC 1951); packed bits, 128 bytes of 2
# (section 9)
RATIOS = {1: 1, LZW: 2731, 8: 1032, 32946: 1032, 32773: 64}
TYPES = ("uint8", "uint16", "float16", "float32", "float64")
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB = 0, 1, 2  # photometric interpretations
SMALLER, MASK = 1, 4  # bits of the tag NewSubfileType: previews and masks

COPIES = 3  # of a page's samples: as stored, decoded, and turned or put into a stack
FLOATS = 48  # [byte] a pixel of a photograph: three channels as float64, and as coefficients


@dataclass(frozen=True)
class Page:
    """A page of a TIFF according to its directory.

    alpha: 0 without, 1 premultiplied, 2 separate. source: tifffile's page.
    """

    source: Any
    shape: tuple[int, int, int]  # planes, rows, cols
    dtype: np.dtype
    photometric: int
    orientation: int
    alpha: int


def read_stack(path, count: int, scale: float | None = None) -> np.ndarray:
    """Read `count` planes, one per page or channel of a page, as float32 (L, rows, cols).

    scale: number that stands for 1; None is the largest number of integers, and 1 of floats. Raises
    BadFile, DoesNotFit.
    """
    with _open_pages(path) as (pages, stored):
        found = sum(page.shape[0] for page in pages)
        if found != count:
            why = f"{found} planes for {count} wavelengths; wanted one wavelength per plane"
            raise BadFile(path, why)
        first = pages[0]
        for page in pages:
            if page.shape[1:] != first.shape[1:] or page.dtype != first.dtype:
                why = f"pages of {_describe(first)} and of {_describe(page)}; wanted equal planes"
                raise BadFile(path, why)
        rows, cols = first.shape[1:]
        largest = max(math.prod(page.shape) for page in pages) * first.dtype.itemsize
        needed = 4 * count * rows * cols + stored + COPIES * largest
        require_memory(f"{path}: {count} planes of {cols} x {rows} pixels", needed)
        values, start = np.empty((count, rows, cols), np.float32), 0
        for page in pages:
            planes = _pixels(path, page)
            with np.errstate(over="ignore"):  # infinite values are refused
                values[start : start + len(planes)] = planes
            start += len(planes)
    if scale is None:
        scale = np.iinfo(first.dtype).max if first.dtype.kind == "u" else 1.0
    with np.errstate(over="ignore"):
        values /= np.float32(scale)
    _check(path, values)
    return values


def read_picture(path) -> np.ndarray:
    """Read the samples of a photograph, uint8, uint16 or float32, shape (rows, cols, channels).

    Channels are as in `read_samples`. It is turned to its orientation. A premultiplied alpha is
    left out, because its background is dark already. Raises BadFile, DoesNotFit.
    """
    with _open_pages(path) as (pages, stored):
        if len(pages) > 1:
            raise BadFile(
                path,
                f"{len(pages)} pages; give their wavelengths [nm], for example --wavelengths "
                "400:700:10",
            )
        page = pages[0]
        wanted = {WHITE_IS_ZERO: 1, BLACK_IS_ZERO: 1, RGB: 3}.get(page.photometric)
        if wanted is None or page.shape[0] != wanted + (page.alpha > 0):
            raise BadFile(
                path,
                f"{page.shape[0]} channels, {page.source.photometric!r}; wanted "
                "grey or RGB, with or without alpha, or wavelengths of its planes",
            )
        rows, cols = page.shape[1:]
        nbytes = math.prod(page.shape) * page.dtype.itemsize
        needed = stored + COPIES * nbytes + FLOATS * rows * cols
        require_memory(f"{path}: picture of {cols} x {rows} pixels", needed)
        samples = np.moveaxis(_pixels(path, page), 0, -1)
    if samples.dtype.kind == "f":
        with np.errstate(over="ignore"):
            samples = samples.astype(np.float32)
        _check(path, samples)
    if page.photometric == WHITE_IS_ZERO:
        white = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1
        samples[..., 0] = white - samples[..., 0]
    samples = samples[..., :-1] if page.alpha == 1 else samples
    return np.ascontiguousarray(turn(samples, page.orientation))


@contextmanager
def _open_pages(path):
    """Yield the pages of a TIFF, without previews and masks, and the file's size [byte]."""
    import tifffile

    with silence("tifffile"), open_file(path) as file:
        with reading(path, "a TIFF"):
            pages = _pages(path, tifffile.TiffFile(file, name=str(path)), file_size(file))
        yield pages, file_size(file)


def _pages(path, tiff, size):
    pages, offsets = [], set()
    for number, page in enumerate(tiff.pages):
        if number == MOST_PAGES:
            raise BadFile(path, f"more than {MOST_PAGES} pages")
        if page.offset in offsets:
            why = f"page {number} repeats an earlier one: the file's pages form a loop"
            raise BadFile(path, why)
        offsets.add(page.offset)
        if not int(page.subfiletype) & (SMALLER | MASK):
            pages.append(_page(path, page, size))
    if not pages:
        raise BadFile(path, "no page with a picture")
    return pages


def _page(path, page, size):
    """Return the description of a page; raise BadFile if it cannot be read or is truncated."""
    if page.dtype is None or page.dtype.name not in TYPES:
        raise BadFile(
            path,
            f"samples of {page.bitspersample} bits of the kind {page.sampleformat}; wanted 8 or 16 bit "
            "whole numbers, or floats",
        )
    if int(page.compression) not in RATIOS or int(page.predictor) not in (1, 2, FLOATING):
        why = f"compressed by {page.compression!r}, {page.predictor!r}; wanted LZW, deflate or none"
        raise BadFile(path, why)
    if int(page.compression) == LZW or int(page.predictor) == FLOATING:
        _require_codecs(path, page)
    shape = (0,)
    if page.axes == "YX":
        shape = (1, *page.shape)
    elif page.axes == "SYX":
        shape = page.shape
    elif page.axes == "YXS":
        shape = (page.shape[2], *page.shape[:2])
    # a damaged tag may hold several numbers
    if not all(isinstance(length, int) and length > 0 for length in shape):
        why = f"a page of shape {page.shape}, axes {page.axes!r}; wanted rows, columns and channels"
        raise BadFile(path, why)
    starts, lengths = page.dataoffsets, page.databytecounts
    ends = [start + length for start, length in zip(starts, lengths, strict=False)]
    if len(ends) < max(1, len(lengths)) or min(lengths) < 1 or max(ends) > size:
        end = max(ends, default=0)
        raise BadFile(
            path, f"truncated: pixels up to byte {end} in a file of {size}, or missing parts"
        )
    nbytes, stored = math.prod(shape) * page.dtype.itemsize, sum(page.databytecounts)
    if nbytes > RATIOS[int(page.compression)] * stored:
        raise BadFile(
            path,
            f"truncated or damaged: {shape[2]} x {shape[1]} pixels are {nbytes} bytes, which cannot "
            f"come from {stored}",
        )
    extra = [int(one) for one in page.extrasamples]
    alpha = extra[0] if len(extra) == 1 and extra[0] in (1, 2) else 0
    turn = int(page.tags.valueof("Orientation", 1))
    return Page(page, shape, page.dtype, int(page.photometric), turn, alpha)


def _require_codecs(path, page):
    from importlib.util import find_spec

    if find_spec("imagecodecs") is None:
        raise BadFile(
            path,
            f"compressed by {page.compression!r}, {page.predictor!r}: wanted pip install "
            "'gpusim[tiff]', or a file that is not compressed",
        )


def _pixels(path, page):
    """Return the samples of a page, planes first."""
    with reading(path, "a TIFF whose pixels can be read"):
        pixels = page.source.asarray(maxworkers=1).reshape(page.source.shape)
    return np.moveaxis(pixels, -1, 0) if page.source.axes == "YXS" else pixels.reshape(page.shape)


def _check(path, values):
    low, high = float(values.min()), float(values.max())
    if not np.isfinite([low, high]).all():
        raise BadFile(path, "NaN or infinite values, or more than float32 holds")
    if low < 0:
        raise BadFile(path, f"negative values (lowest {low:.3g})")


def _describe(page):
    return f"{page.shape[2]} x {page.shape[1]} {page.dtype}"
