"""Raw files in Adobe's DNG format."""

import math
import os
import struct
from fractions import Fraction

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.io.atomic import atomic_path

# EXIF codes, LightSource
LIGHTS = {"A": 17, "B": 18, "C": 19, "D55": 20, "D65": 21, "D75": 22, "D50": 23}
# index is the code in a CFAPattern: red, green, blue, cyan, magenta, yellow, white
FILTERS = "RGBCMYW"
PLANES = (1, 3, 4)  # channels that colour matrices and other programs support
# periods of mosaics that raw converters read; of others they take a part as the whole, and show stripes
READABLE = ((2, 2), (6, 6))
LARGEST = 2**31 - 1  # numerator or denominator
EXIF = 34665  # code of the place of EXIF tags
LINEAR_RAW = 34892  # DNG code of raw values without a colour filter array


def check_dng(cfa, channels):
    """Raise OutOfRange unless a DNG can store these filters.

    cfa: one period of the mosaic, () without. channels: letters of the channels.
    """
    if len(channels) not in PLANES:
        allowed = "1, 3 or 4, because of the colour matrices; .npz holds any"
        raise OutOfRange("channels of a DNG", f"{len(channels)} ({', '.join(channels)})", allowed)
    strange = [letter for letter in channels if letter not in FILTERS] if cfa else []
    if strange:
        allowed = f"{', '.join(FILTERS)}; .npz holds any"
        raise OutOfRange("filters of a DNG", ", ".join(strange), allowed)


def check_readable(cfa):
    """Raise OutOfRange for a mosaic that raw converters misread. cfa: one period, () without."""
    if cfa and (len(cfa), len(cfa[0])) not in READABLE:
        allowed = "2 x 2 pixels, or 6 x 6 as in x-trans: raw converters misread others; .npz and .raw.npy hold any"
        raise OutOfRange("period of a DNG's mosaic", f"{len(cfa)} x {len(cfa[0])}", allowed)


def write_dng(
    path,
    raw,
    cfa,
    black_level,
    white_level,
    matrices=None,
    as_shot_neutral=None,
    *,
    channels="RGB",
    noise=None,
    camera_name="gpusim",
    exposure_time=None,
):
    """Write raw values as a DNG (version 1.4, one uncompressed strip) without changing them.

    raw: uint16 or float32 [DN], shape (rows, cols), or (C, rows, cols) of stacked pixels. cfa: one
    period of the mosaic as rows of letters of R, G, B, C, M, Y and W, for example ("RG", "GB"); ()
    without. black_level, white_level: [DN]; black_level may have one value per position in the
    mosaic's period. channels: letters in the order of the following arguments, which are not used
    for one channel. matrices: {light: (color, forward)} of one or two lights, names in LIGHTS:
    color from XYZ to camera, shape (C, 3); forward from camera values relative to white to XYZ in
    D50, shape (3, C), or None. as_shot_neutral: camera values of white, shape (C,), largest about
    1. noise: (S, O) if x = (raw - black) / (white - black) has the variance S x + O; None is
    unknown. exposure_time: [s], None: not written.

    LibRaw, which many programs use, opens only pictures of 22 x 22 or more, and only mosaics of 2 x
    2 and X-Trans. Raises BadData, OutOfRange and BadFile. Source: Adobe, "Digital Negative (DNG)
    Specification", 1.4.0.0.
    """
    import tifffile

    raw = np.asarray(raw)
    is_shaped = raw.ndim in ((2,) if cfa else (2, 3)) and raw.size > 0
    if not (is_shaped and raw.dtype in (np.uint16, np.float32)):
        raise BadData(
            f"{path}: a DNG needs uint16 or float32 of shape (rows, cols), got {raw.dtype} "
            f"{raw.shape}"
        )
    planes = len(channels) if cfa or raw.ndim == 3 else 1
    check_dng(cfa, channels if planes > 1 else "Y")
    if raw.ndim == 3:
        raw = np.ascontiguousarray(np.moveaxis(raw, 0, -1))
    samples = raw.shape[2] if raw.ndim == 3 else 1
    if samples not in (1, planes):
        raise BadData(f"{path}: {samples} layers of raw values for {planes} channels")
    oldest = (1, 4, 0, 0) if raw.dtype == np.float32 else (1, 1, 0, 0)
    tags = [
        (274, "H", 1, 1, False),  # Orientation: not turned
        (50706, "B", 4, (1, 4, 0, 0), False),  # DNGVersion
        (50707, "B", 4, oldest, False),  # DNGBackwardVersion
        (50708, "s", 0, camera_name, False),  # UniqueCameraModel
        *_levels(cfa, samples, black_level, white_level),
    ]
    if cfa:
        tags += _mosaic(path, cfa, channels)
    if planes > 1:
        tags += _colors(path, planes, matrices or {}, as_shot_neutral)
    if noise is not None:
        if not (len(noise) == 2 and noise[0] > 0 and noise[1] >= 0 and np.isfinite(noise).all()):
            raise OutOfRange("noise of a DNG", noise, "S > 0 and O >= 0")
        # NoiseProfile, one for all planes
        tags.append((51041, "d", 2, tuple(map(float, noise)), False))
    with atomic_path(path) as temporary:
        tifffile.imwrite(
            temporary,
            raw,
            byteorder="<",
            photometric="cfa" if cfa else "minisblack",
            rowsperstrip=len(raw),
            metadata=None,
            software="gpusim",
            planarconfig="contig" if samples > 1 else None,
            extratags=tags,
        )
        if not cfa:
            # tifffile writes it for three samples only
            with tifffile.TiffFile(temporary, mode="r+b") as file:
                file.pages[0].tags["PhotometricInterpretation"].overwrite(LINEAR_RAW)
        if exposure_time:
            _add_exif(temporary, min(exposure_time, LARGEST - 1))


def _add_exif(path, exposure_time):
    """Append EXIF tags with the exposure time [s], and a first directory that names their place.

    tifffile does not write EXIF tags. The file is little-endian, and below 4 GiB.
    """
    with open(path, "r+b") as file:
        first = struct.unpack("<2sHI", file.read(8))[2]
        file.seek(first)
        (count,) = struct.unpack("<H", file.read(2))
        entries = [file.read(12) for _ in range(count)]
        start = file.seek(0, os.SEEK_END)
        start = file.seek(start + start % 2)
        exif = struct.pack(
            "<HHHIIHHI4sI",
            *(2, 33434, 5, 1, start + 30),  # ExposureTime, a fraction
            *(36864, 7, 4, b"0232", 0),  # ExifVersion
        )
        entries.append(struct.pack("<HHII", EXIF, 4, 1, start))
        entries.sort(key=lambda entry: struct.unpack_from("<H", entry))
        file.write(exif + struct.pack("<II", *_fractions([exposure_time])))
        place = file.tell()
        file.write(struct.pack("<H", len(entries)) + b"".join(entries) + struct.pack("<I", 0))
        file.seek(4)
        file.write(struct.pack("<I", place))


def _levels(cfa, samples, black_level, white_level):
    """Return tags of the black and white levels; black is rational if it is not whole."""
    black = np.asarray(black_level, np.float64)
    period = (len(cfa), len(cfa[0])) if cfa else (1, 1)
    if black.shape not in ((), period):
        raise BadData(
            f"black_level of a DNG: shape {black.shape}, wanted one number or {period}, the mosaic's "
            "period"
        )
    if not (0 <= black.min() and black.max() < white_level <= 2**32 - 1):
        levels = f"{black.min():g} .. {black.max():g}, {white_level}"
        allowed = "0 <= black < white <= 4294967295 DN"
        raise OutOfRange("black_level, white_level", levels, allowed)
    rows, cols = black.shape or (1, 1)
    values = np.repeat(black.ravel(), samples)
    kind, numbers = "2I", _fractions(values)
    if (values == np.rint(values)).all():
        kind, numbers = "I", tuple(map(int, values))
    return [
        (50713, "H", 2, (rows, cols), False),  # BlackLevelRepeatDim
        (50714, kind, len(values), numbers, False),  # BlackLevel
        (50717, "I", samples, (int(white_level),) * samples, False),  # WhiteLevel
    ]


def _mosaic(path, cfa, channels):
    """Return tags of the colour filter array."""
    if len({len(row) for row in cfa}) != 1 or set("".join(cfa)) != set(channels):
        letters = ", ".join(channels)
        raise BadData(f"{path}: cfa {cfa}: wanted rows of equal length with the letters {letters}")
    pattern, planes = (bytes(map(FILTERS.index, letters)) for letters in ("".join(cfa), channels))
    return [
        (33421, "H", 2, (len(cfa), len(cfa[0])), False),  # CFARepeatPatternDim
        (33422, "B", len(pattern), pattern, False),  # CFAPattern
        (50710, "B", len(planes), planes, False),  # CFAPlaneColor
        (50711, "H", 1, 1, False),  # CFALayout: rows and columns
    ]


def _colors(path, planes, matrices, as_shot_neutral):
    """Return tags of white balance and colours for raw converters."""
    if not 1 <= len(matrices) <= 2 or not set(matrices) <= set(LIGHTS):
        allowed = f"one or two of {', '.join(LIGHTS)}"
        raise OutOfRange("matrices of a DNG", ", ".join(matrices) or "none", allowed)
    neutral = _finite(path, "as_shot_neutral", as_shot_neutral, (planes,))
    if not (neutral > 0).all():
        raise OutOfRange("as_shot_neutral", neutral.tolist(), "> 0")
    tags = [(50728, "2I", planes, _fractions(neutral), False)]  # AsShotNeutral
    for place, (light, (color, forward)) in enumerate(matrices.items()):
        color = _finite(path, f"color matrix of {light}", color, (planes, 3))
        values = _fractions(color.ravel())
        tags += [
            (50721 + place, "2i", 3 * planes, values, False),  # ColorMatrix1, ColorMatrix2
            (50778 + place, "H", 1, LIGHTS[light], False),  # CalibrationIlluminant1, 2
        ]
        if forward is not None:
            forward = _finite(path, f"forward matrix of {light}", forward, (3, planes))
            # ForwardMatrix1, 2
            tags.append((50964 + place, "2i", 3 * planes, _fractions(forward.ravel()), False))
    return tags


def _finite(path, key, values, shape):
    values = np.asarray(values, np.float64) if values is not None else np.empty(0)
    if values.shape != shape or not np.isfinite(values).all():
        raise BadData(f"{path}: {key}: wanted finite numbers of shape {shape}")
    return values


def _fractions(values):
    """Return numerators and denominators for TIFF: whole numbers of 31 bits, accurate to 1e-9."""
    fractions = [
        Fraction(float(value)).limit_denominator(LARGEST // math.ceil(abs(value) + 1))
        for value in values
    ]
    return tuple(part for one in fractions for part in (one.numerator, one.denominator))
