"""Raw files: Adobe's DNG."""

from fractions import Fraction

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.io.atomic import atomic_path

# EXIF codes of the lights for which a colour matrix may hold, and that of any other
LIGHTS, OTHER_LIGHT = {"A": 17, "B": 18, "C": 19, "D55": 20, "D65": 21, "D75": 22, "D50": 23}, 255
LINEAR_RAW = 34892  # DNG code of raw values without a colour filter array


def write_dng(path, raw, cfa_pattern, black_level, white_level, color_matrix=None, as_shot_neutral=None,
              camera_name="gpusim", light="D65"):
    """Write sensor values as a DNG (version 1.4, one uncompressed strip), exactly as they are.

    raw: uint16 [DN], shape (rows, cols). cfa_pattern: colours of the 2 x 2 tile row by row, of R, G and B, such as
    "RGGB"; "" for a monochrome sensor. black_level, white_level: [DN].
    color_matrix: XYZ in `light` to camera, shape (3, 3); as_shot_neutral: camera values of white, shape (3,), largest
    about 1. Both are needed with a CFA and not used without. light: name of the illuminant whose white the matrix takes
    to `as_shot_neutral`, the processor's target; CalibrationIlluminant1 is "other" where EXIF has no code for it.
    LibRaw, and so many programs, opens no picture smaller than 22 x 22.
    Raises BadData, OutOfRange and BadFile. Source: Adobe, "Digital Negative (DNG) Specification", 1.4.0.0.
    """
    import tifffile

    raw = np.asarray(raw)
    if raw.dtype != np.uint16 or raw.ndim != 2 or raw.size == 0:
        raise BadData(f"{path}: a DNG needs uint16 of shape (rows, cols), got {raw.dtype} {raw.shape}")
    if not 0 <= black_level < white_level <= 65535:
        raise OutOfRange("black_level, white_level", f"{black_level}, {white_level}", "0 <= black < white <= 65535 DN")
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), False),  # DNGVersion
        (50707, "B", 4, (1, 1, 0, 0), False),  # DNGBackwardVersion
        (50708, "s", 0, camera_name, False),  # UniqueCameraModel
        (50714, "I", 1, int(black_level), False),  # BlackLevel
        (50717, "I", 1, int(white_level), False),  # WhiteLevel
    ]
    if cfa_pattern:
        if len(cfa_pattern) != 4 or not set(cfa_pattern) <= set("RGB"):
            raise OutOfRange("cfa_pattern of a DNG", repr(cfa_pattern), 'four letters of R, G and B, such as "RGGB"')
        color_matrix = _finite(path, "color_matrix", color_matrix, (3, 3))
        as_shot_neutral = _finite(path, "as_shot_neutral", as_shot_neutral, (3,))
        if not (as_shot_neutral > 0).all():
            raise OutOfRange("as_shot_neutral", as_shot_neutral.tolist(), "> 0")
        tags += [
            (33421, "H", 2, (2, 2), False),  # CFARepeatPatternDim
            (33422, "B", 4, tuple("RGB".index(letter) for letter in cfa_pattern), False),  # CFAPattern
            (50721, "2i", 9, _fractions(color_matrix.ravel()), False),  # ColorMatrix1
            (50778, "H", 1, LIGHTS.get(light.upper(), OTHER_LIGHT), False),  # CalibrationIlluminant1
            (50728, "2I", 3, _fractions(as_shot_neutral), False),  # AsShotNeutral
        ]
    with atomic_path(path) as temporary:
        tifffile.imwrite(temporary, raw, photometric="cfa" if cfa_pattern else "minisblack", rowsperstrip=len(raw),
                         metadata=None, software="gpusim", extratags=tags)
        if not cfa_pattern:
            with tifffile.TiffFile(temporary, mode="r+b") as file:  # tifffile itself writes it for three samples only
                file.pages[0].tags["PhotometricInterpretation"].overwrite(LINEAR_RAW)


def _finite(path, key, values, shape):
    values = np.asarray(values, np.float64) if values is not None else np.empty(0)
    if values.shape != shape or not np.isfinite(values).all():
        raise BadData(f"{path}: {key} must be finite numbers of shape {shape}")
    return values


def _fractions(values):
    """Numerators and denominators in turn, as TIFF stores rational numbers; to 1e-9 or better."""
    fractions = [Fraction(float(value)).limit_denominator(100_000) for value in values]
    return tuple(number for fraction in fractions for number in (fraction.numerator, fraction.denominator))
