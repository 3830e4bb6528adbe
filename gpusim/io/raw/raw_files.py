"""Raw files of cameras: DNG and other raw files, NumPy arrays and TIFF planes."""

from collections.abc import Mapping
from dataclasses import fields, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile, Missing, UnknownName
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.files import open_file, reading
from gpusim.io.raw.raw_arrays import ARRAYS, count_array_frames, read_array
from gpusim.io.raw.raw_frame import RawFrame
from gpusim.io.raw.raw_tags import RawTags, read_raw_tags

DEVELOPED = {
    b"\xff\xd8\xff": "a JPEG",
    b"\x89PNG": "a PNG",
    b"RIFF": "a WebP",
}
HEIF = (b"ftypheic", b"ftypmif1", b"ftypavif", b"ftypheix")
SHOOT_RAW = "a developed picture: noise and levels are no longer the sensor's; shoot raw (DNG or the camera's own)"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"IIU\0", b"IIRO", b"IIRS")
SETTINGS = frozenset(field.name for field in fields(RawFrame)) - {"values", "name", "notes"}


def read_raw(path: str | PathLike, frame: int = 0, **settings: Any) -> RawFrame:
    """Read one raw frame: values as the converter gave them, and settings of the exposure.

    DNG and other raw files give their settings as tags. Arrays are .npy (rows, cols) or (n, rows,
    cols), .tif of one or more grey pages, and .npz with `dn` (or `raw`, or `values`) and, if known,
    `cfa`, `iso`, `exposure_time_s`, `black_level`, `white_level`, `temperature_deg_c`, `f_number`,
    `focal_length_mm`, `photons` and `camera`. Files of `gpusim simulate` are among them.

    Args:
        path: The file.
        frame: Index of the frame of a file with several.
        settings: Fields of `RawFrame` in place of the file's: `cfa` (rows of letters, or the name of
            a mosaic), `iso`, `exposure_time` [s] and so on.

    Returns:
        The frame. Serial numbers, owners and positions are not read.

    Raises:
        BadFile: The file cannot be read, or its values are not a sensor's: a JPEG, or a DNG that is
            demosaicked, compressed with loss, or denoised.
        Missing: rawpy is not installed, and the file needs it.
        UnknownName: A setting or a mosaic is not known.
    """
    unknown = settings.keys() - SETTINGS
    if unknown:
        raise UnknownName("setting of a raw frame", min(unknown), SETTINGS)
    with open_file(path) as file:
        head = file.read(32)
    path = Path(path)
    if path.suffix.lower() in ARRAYS[:2]:
        found = read_array(path, frame)
    else:
        _refuse_developed(path, head)
        tags = read_raw_tags(path) if head[:4] in TIFF else RawTags()
        if tags.is_plain and path.suffix.lower() in ARRAYS:
            found = read_array(path, frame)
        else:
            found = _read_raw_file(path, tags)
    found = replace(found, **_checked_settings(settings))
    return _checked_frame(path, found)


def count_frames(path: str | PathLike) -> int:
    """Return the number of frames of a file: more than 1 for stacks (.npy, .npz, .tif).

    Args:
        path: The file.

    Returns:
        The number.

    Raises:
        BadFile: The file cannot be read.
    """
    with open_file(path):
        pass
    path = Path(path)
    is_array = path.suffix.lower() in ARRAYS
    return count_array_frames(path) if is_array else 1


def _refuse_developed(path, head):
    """Raise BadFile for pictures that are no raw values."""
    kind = next((kind for magic, kind in DEVELOPED.items() if head.startswith(magic)), None)
    if kind is None and head[4:12] in HEIF:
        kind = "a HEIF"
    if kind is not None:
        raise BadFile(path, f"{kind}, {SHOOT_RAW}")


def _read_raw_file(path, tags):
    tags.check(path)
    values = cfa = None
    if tags.has_plain_values:
        values, cfa = tags.values(path), tags.cfa
    if values is not None and cfa is not None:
        return RawFrame(
            values,
            cfa,
            path.name,
            black_level=tags.black_level,
            white_level=tags.white_level,
            noise_profile=tags.noise_profile,
            notes=tags.notes,
            **tags.settings,
        )
    return _read_by_libraw(path, tags)


def _read_by_libraw(path, tags):
    """Read a file by LibRaw, and its settings from its tags, or else from LibRaw."""
    try:
        import rawpy
    except ImportError:
        raise Missing(f"{path}: needs rawpy: pip install 'gpusim[fit]'") from None
    with reading(path, "a raw file that LibRaw reads"), rawpy.imread(str(path)) as raw:
        if raw.raw_type != rawpy.RawType.Flat or raw.raw_image_visible is None:
            raise BadFile(path, f"demosaicked (several values a pixel), {SHOOT_RAW}")
        values = raw.raw_image_visible.copy()
        letters = raw.color_desc.decode("ascii", "replace")
        cfa, places = _mosaic(raw, letters)
        levels = np.array(raw.black_level_per_channel, np.float64)
        black = levels[np.minimum(places, len(levels) - 1)] if levels.any() else None
        white = float(raw.white_level) if raw.white_level else None
        own = _libraw_settings(raw)
    settings = own | {key: value for key, value in tags.settings.items() if value is not None}
    return RawFrame(
        values,
        cfa,
        path.name,
        black_level=tags.black_level if tags.black_level is not None else black,
        white_level=white,
        noise_profile=tags.noise_profile,
        notes=tags.notes,
        **settings,
    )


def _mosaic(raw, letters):
    """Return one period of the mosaic as rows of letters, and as indices of LibRaw's colours."""
    if raw.num_colors == 1 or raw.raw_pattern is None:
        return ("Y",), np.zeros((1, 1), int)
    rows, cols = raw.raw_pattern.shape
    places = raw.raw_colors_visible[:rows, :cols].astype(int)
    return tuple("".join(letters[index] for index in row) for row in places), places


def _libraw_settings(raw):
    """Return settings that LibRaw knows; never owner or position."""
    other = getattr(raw, "other", None)
    names = {"iso": "iso_speed", "exposure_time": "shutter", "f_number": "aperture"}
    found = {key: _positive(getattr(other, name, None)) for key, name in names.items()}
    length = _positive(getattr(other, "focal_len", None))
    return found | {"focal_length": length / 1000 if length else None}


def _positive(value):
    try:
        value = float(value)
    except (TypeError, ValueError):
        return None
    return value if 0 < value < 1e12 else None


def _checked_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with a mosaic as rows of letters. Raises UnknownName."""
    cfa = settings.get("cfa")
    if isinstance(cfa, str):
        if cfa not in MOSAICS:
            raise UnknownName("mosaic", cfa, MOSAICS)
        return {**settings, "cfa": MOSAICS[cfa]}
    return {**settings, "cfa": tuple(cfa)} if cfa is not None else dict(settings)


def _checked_frame(path, frame):
    """Return a frame with values that can be counted on. Raises BadFile."""
    values = frame.values
    if values.ndim != 2 or values.dtype.kind not in "uif" or min(values.shape) < 1:
        why = f"{values.dtype} {values.shape}: wanted raw values (rows, cols)"
        raise BadFile(path, f"{why}; stacked pixels: give each layer as a file")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise BadFile(path, "values that are not finite")
    rows, cols = frame.period
    if values.shape[0] < rows or values.shape[1] < cols:
        raise BadFile(path, f"{values.shape}: smaller than the mosaic's period, {rows} x {cols}")
    return frame
