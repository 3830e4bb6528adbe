"""TIFF: photographs, and stacks of planes with wavelengths from the user.

Source: TIFF Revision 6.0 (Adobe, 1992); tifffile reads its directories and pixels.
"""

import math
import re
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile, format_value
from gpusim.domain.memory import require_memory
from gpusim.io.account import Fields, note_of, note_resolution
from gpusim.io.files import file_size, open_file, reading, silence
from gpusim.io.orientation import turn
from gpusim.io.scene.coding import colour_space
from gpusim.io.scene.stacks import SAY_SCALE, cut_noise

SUFFIXES = (".tif", ".tiff")
MOST_PAGES = 4096
LZW, JPEG, ZSTD = 5, 7, 50000
FLOATING = 3  # predictor
# Largest expansion of a stored byte: uncompressed; LZW, codes of 12 bits for up to 4096 bytes
# (section 13); deflate with two codes, 258 bytes of 2 bits (RFC 1951); packed bits, 128 bytes of 2
# (section 9); JPEG, a bit for a block of 8 x 8, and one sample of four pixels for three; Zstandard,
# 128 KiB of 4 bytes (RFC 8878, 3.1.1.2)
RATIOS = {1: 1, LZW: 2731, 8: 1032, 32946: 1032, 32773: 64, JPEG: 6144, ZSTD: 32768}
UNSIGNED, SIGNED = ("uint8", "uint16", "uint32"), ("int8", "int16", "int32")
TYPES = (*UNSIGNED, *SIGNED, "float16", "float32", "float64")
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB, PALETTE, YCBCR, MOSAIC = (
    0,
    1,
    2,
    3,
    6,
    32803,
)  # photometric interpretations
# tags of the file's structure, those that are used, and those that say nothing about the light
IDLE_TAGS = (
    "NewSubfileType SubfileType ImageWidth ImageLength BitsPerSample Compression "
    "PhotometricInterpretation Threshholding FillOrder DocumentName ImageDescription Make Model "
    "StripOffsets Orientation SamplesPerPixel RowsPerStrip StripByteCounts MinSampleValue "
    "MaxSampleValue XResolution YResolution PlanarConfiguration PageName XPosition YPosition "
    "FreeOffsets FreeByteCounts ResolutionUnit PageNumber Software DateTime Artist HostComputer "
    "Predictor HalftoneHints TileWidth TileLength TileOffsets TileByteCounts SubIFDs ExtraSamples "
    "SampleFormat JPEGTables YCbCrCoefficients YCbCrSubSampling YCbCrPositioning ReferenceBlackWhite "
    "InterColorProfile XMP IPTCNewsPhoto ImageResources ImageSourceData PhotoshopINFO Copyright "
    "ExifTag GPSTag InteroperabilityTag ImageID IJMetadata IJMetadataByteCounts GDAL_METADATA "
    "GDAL_NODATA WhitePoint PrimaryChromaticities Model*Tag Geo*Tag ImageJ* JPEG* Rating* Lerc* "
    "UniqueCameraModel XP* Padding"
).split()
ITEM = re.compile(r"<Item\b([^<>]*)>([^<>]*)</Item>")  # of GDAL's metadata
LONGEST_METADATA = 2**20
SMALLER, MASK = 1, 4  # bits of the tag NewSubfileType: previews and masks

COPIES = 3  # of a page's samples: as stored, decoded, and turned or put into a stack
FLOATS = 48  # [byte] a pixel of a photograph: three channels as float64, and as coefficients


@dataclass(frozen=True)
class Page:
    """A page of a TIFF according to its directory.

    alpha: 0 without, 1 premultiplied, 2 separate. source: tifffile's page. gains, offsets: of each
    plane, by GDAL, or None: light is gain x number + offset. ignored: number for no data, or None.
    notes: on what is not used.
    """

    source: Any
    shape: tuple[int, int, int]  # planes, rows, cols
    dtype: np.dtype
    photometric: int
    orientation: int
    alpha: int
    gains: np.ndarray | None = None
    offsets: np.ndarray | None = None
    ignored: float | None = None
    notes: tuple[str, ...] = ()


def read_stack(path, count: int, scale: float | None = None) -> tuple[np.ndarray, list[str]]:
    """Read `count` planes, one per page or channel of a page, as float32 (L, rows, cols), and notes.

    scale: number that stands for 1. None is 1 for floats, the largest number of uint8 and uint16,
    and the scale of GDAL's metadata; other whole numbers need it. GDAL's offset is added, and
    samples without data are 0. Small negative numbers, which are noise, become 0. Raises BadFile,
    DoesNotFit.
    """
    with _open_pages(path) as (pages, stored, notes):
        found = sum(page.shape[0] for page in pages)
        if found != count:
            why = f"{found} planes for {count} wavelengths; wanted one wavelength per plane"
            raise BadFile(path, why)
        first = pages[0]
        for page in pages:
            if page.shape[1:] != first.shape[1:] or page.dtype != first.dtype:
                why = f"pages of {_describe(first)} and of {_describe(page)}; wanted equal planes"
                raise BadFile(path, why)
            if page.photometric in (PALETTE, MOSAIC) or page.orientation != first.orientation:
                why = f"{page.source.photometric!r}, orientation {page.orientation}"
                raise BadFile(path, f"{why}; wanted planes of light, all turned alike")
        has_gains = all(page.gains is not None for page in pages)
        if scale is None and not has_gains:
            if first.dtype.kind == "i" or (first.dtype.itemsize > 2 and first.dtype.kind == "u"):
                raise BadFile(path, f"{first.dtype} without a scale in the file; {SAY_SCALE}")
            scale = float(np.iinfo(first.dtype).max) if first.dtype.kind == "u" else 1.0
        rows, cols = first.shape[1:]
        largest = max(math.prod(page.shape) for page in pages) * first.dtype.itemsize
        copies = 1 if first.orientation == 1 else 2
        needed = copies * 4 * count * rows * cols + stored + COPIES * largest
        require_memory(f"{path}: {count} planes of {cols} x {rows} pixels", needed)
        values, start, without = np.empty((count, rows, cols), np.float32), 0, 0
        for page in pages:
            for number, plane in enumerate(_pixels(path, page)):
                if page.photometric == WHITE_IS_ZERO and page.dtype.kind == "u":
                    plane = np.iinfo(page.dtype).max - plane
                with np.errstate(over="ignore", invalid="ignore"):  # infinite values are refused
                    without += _convert(plane, values[start], page, number, scale)
                start += 1
    notes += note_of("tags not used", dict.fromkeys(note for page in pages for note in page.notes))
    if without:
        notes.append(f"no data in {100 * without / values.size:.2g} % of the numbers: dark")
    if first.orientation != 1:
        turned = turn(np.moveaxis(values, 0, -1), first.orientation)
        values = np.ascontiguousarray(np.moveaxis(turned, -1, 0))
    return values, notes + cut_noise(path, values)


def _convert(plane, values, page, number, scale) -> int:
    """Put the light of a plane into `values`; return the number of samples without data.

    scale: number that stands for 1, in place of the page's gains, or None.
    """
    gain = 1.0 if page.gains is None else page.gains[number]
    offset = 0.0 if page.offsets is None else page.offsets[number]
    values[:] = plane
    if scale is not None:  # the offset is in the unit of the gains
        values += np.float32(offset / gain if gain else 0)
        values /= np.float32(scale)
    else:
        values *= np.float32(gain)
        values += np.float32(offset)
    if page.ignored is None:
        return 0
    absent = np.isnan(plane) if page.ignored != page.ignored else plane == page.ignored
    values[absent] = 0
    return int(absent.sum())


def read_picture(path, part: int | str | None = None) -> tuple[np.ndarray, dict, list[str]]:
    """Read a photograph: samples, uint8, uint16 or float32, (rows, cols, channels), tags and notes.

    Channels are as in `photo.Photograph`; tags are for `coding_of`. It is turned to its orientation. A
    premultiplied alpha is left out, because its background is dark already. part: number of the
    page, from 0. Raises BadFile, DoesNotFit.
    """
    with _open_pages(path) as (pages, stored, notes):
        page = _choose(path, pages, part)
        wanted = {WHITE_IS_ZERO: 1, BLACK_IS_ZERO: 1, RGB: 3, YCBCR: 3}.get(page.photometric)
        if page.photometric == YCBCR and int(page.source.compression) != JPEG:
            wanted = None
        if wanted is None or page.shape[0] != wanted + (page.alpha > 0):
            raise BadFile(
                path,
                f"{page.shape[0]} channels, {page.source.photometric!r}; wanted "
                "grey or RGB, with or without alpha, or wavelengths of its planes",
            )
        if page.dtype.kind == "i":
            raise BadFile(
                path,
                f"{page.dtype}: numbers with a sign are no photograph; give the wavelengths of its "
                "planes and the scale, for example --wavelengths 450,550,650 --scale 10000",
            )
        if len(pages) > 1:
            notes.append(f"{len(pages)} pages: only page {pages.index(page)} is used")
        rows, cols = page.shape[1:]
        nbytes = math.prod(page.shape) * page.dtype.itemsize
        needed = stored + COPIES * nbytes + FLOATS * rows * cols
        require_memory(f"{path}: picture of {cols} x {rows} pixels", needed)
        samples = np.moveaxis(_pixels(path, page), 0, -1)
        with reading(path, "a TIFF"):
            tags = _colour_tags(page.source)
    if samples.dtype.kind == "f":
        with np.errstate(over="ignore"):
            samples = samples.astype(np.float32)
        _check(path, samples)
    if page.photometric == WHITE_IS_ZERO:
        white = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1
        samples[..., 0] = white - samples[..., 0]
    if samples.dtype == np.uint32:
        samples = (samples >> 16).astype(np.uint16)
        notes.append("32 bits a sample: the upper 16 are used")
    samples = samples[..., :-1] if page.alpha == 1 else samples
    unused = [*page.notes, *(["GDAL_METADATA"] if page.gains is not None else [])]
    unused += ["GDAL_NODATA"] if page.ignored is not None else []
    notes += [*note_of("tags not used", unused), *_resolution(page.source)]
    return np.ascontiguousarray(turn(samples, page.orientation)), tags, notes


def _resolution(page) -> list[str]:
    """Return a note on pixels that are not square by the resolutions of a page."""
    both = [page.tags.valueof(name) for name in ("XResolution", "YResolution")]
    if all(isinstance(one, tuple) and len(one) == 2 and one[1] for one in both):
        return note_resolution(*(one[0] / one[1] for one in both))
    return []


def _choose(path, pages, part):
    """Return the page of a number, or the only page."""
    if part is not None:
        if str(part) not in map(str, range(len(pages))):
            why = f"part = {format_value(part)}: wanted a page of 0 .. {len(pages) - 1}"
            raise BadFile(path, why)
        return pages[int(part)]
    if len(pages) > 1:
        raise BadFile(
            path,
            f"{len(pages)} pages; give their wavelengths [nm], for example --wavelengths "
            "400:700:10, or choose a page by part= or --part N, from 0",
        )
    return pages[0]


def _colour_tags(page) -> dict:
    """Return the tags of a page for `coding_of`."""
    tags: dict[str, Any] = {}
    if page.iccprofile:
        tags["icc"] = bytes(page.iccprofile)
    white, primaries = (page.tags.valueof(name) for name in ("WhitePoint", "PrimaryChromaticities"))
    if white is not None and primaries is not None:
        pairs = np.array([*primaries, *white], np.float64).reshape(-1, 2)  # fractions
        if pairs.shape == (8, 2) and (pairs[:, 1] != 0).all():
            tags["cHRM"] = (pairs[:, 0] / pairs[:, 1]).reshape(4, 2)
    exif, between = (page.tags.valueof(name) for name in ("ExifTag", "InteroperabilityTag"))
    exif = exif if isinstance(exif, dict) else {}
    between = between if isinstance(between, dict) else exif.get("InteroperabilityTag")
    index = between.get("InteroperabilityIndex") if isinstance(between, dict) else None
    return tags | colour_space(exif.get("ColorSpace"), index)


@contextmanager
def _open_pages(path):
    """Yield the pages of a TIFF, the file's size [byte], and notes on previews and masks."""
    import tifffile

    with silence("tifffile"), open_file(path) as file:
        with reading(path, "a TIFF"):
            tiff = tifffile.TiffFile(file, name=str(path))
            pages, others = _pages(path, tiff, file_size(file))
        yield pages, file_size(file), others


def _pages(path, tiff, size):
    pages, offsets, small, inside = [], set(), 0, 0
    for number, page in enumerate(tiff.pages):
        if number == MOST_PAGES:
            raise BadFile(path, f"more than {MOST_PAGES} pages")
        if page.offset in offsets:
            why = f"page {number} repeats an earlier one: the file's pages form a loop"
            raise BadFile(path, why)
        offsets.add(page.offset)
        if int(page.subfiletype) & (SMALLER | MASK):
            small += 1
        else:
            pages.append(_page(path, page, size))
            inside += len(page.subifds or ())
    if not pages:
        raise BadFile(path, "no page with a picture")
    notes = [f"previews and masks, {small} of them, are not used"] if small else []
    notes += [f"pictures inside pages, {inside} of them, are not used"] if inside else []
    return pages, notes


def _page(path, page, size):
    """Return the description of a page; raise BadFile if it cannot be read or is truncated."""
    if page.dtype is None or page.dtype.name not in TYPES:
        raise BadFile(
            path,
            f"samples of {page.bitspersample} bits of the kind {page.sampleformat}; wanted 8, 16 or 32 "
            "bit whole numbers, or floats",
        )
    if int(page.compression) not in RATIOS or int(page.predictor) not in (1, 2, FLOATING):
        why = (
            f"compressed by {page.compression!r}, {page.predictor!r}; wanted LZW, deflate, JPEG, "
            "Zstandard or none"
        )
        raise BadFile(path, why)
    if int(page.compression) in (LZW, JPEG, ZSTD) or int(page.predictor) == FLOATING:
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
    tags = Fields((tag.name or str(tag.code) for tag in page.tags), "tags not used")
    tags.ignore(*IDLE_TAGS)
    return Page(
        page,
        shape,
        page.dtype,
        int(page.photometric),
        turn,
        alpha,
        *_gdal_scale(page, shape[0]),
        _gdal_ignored(page),
        tuple(tags.unused),
    )


def _gdal_scale(page, count):
    """Return gains and offsets of the planes by GDAL's metadata, or two times None."""
    text = str(page.tags.valueof("GDAL_METADATA", ""))[:LONGEST_METADATA]
    gains, offsets, found = np.ones(count), np.zeros(count), False
    for attributes, value in ITEM.findall(text):
        named = dict(re.findall(r'(\w+)="([^"]*)"', attributes))
        into = {"scale": gains, "offset": offsets}.get(named.get("role", "").lower())
        plane = named.get("sample", "")
        if into is None or not plane.isdecimal() or int(plane) >= count:
            continue
        into[int(plane)] = float(value)
        found = True
    if not (np.isfinite(gains).all() and np.isfinite(offsets).all() and gains.all()):
        raise ValueError("GDAL_METADATA: a scale or an offset that is no number")
    return (gains, offsets) if found else (None, None)


def _gdal_ignored(page):
    """Return the number for no data by GDAL's tag, possibly NaN, or None."""
    text = str(page.tags.valueof("GDAL_NODATA", "")).strip("\0 ")
    return float(text) if text else None


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
