"""Settings and levels of raw files that are built like TIFF: DNG, NEF, CR2, ARW and others.

Only the tags named here are read: no serial number, owner or position.
"""

import math
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.files import open_file, reading, silence

CFA, LINEAR_RAW = 32803, 34892
PREVIEW = 1  # bit of NewSubfileType
MOST_PICTURES = 32
LETTERS = "RGBCMYW"  # of the codes in a CFAPattern
LOSSY = (34892, 6)  # JPEGs of 8 bits
JXL = 52546
RAW_DNG = "shoot raw without loss: uncompressed or lossless"
MAKE, MODEL, UNIQUE_MODEL, EXIF, DNG_VERSION = 271, 272, 50708, 34665, 50706
SOFTWARE, NOISE_REDUCTION, NOISE_PROFILE = 305, 50935, 51041
NOT_APPLIED = {51008: "OpcodeList1", 51009: "OpcodeList2", 51022: "OpcodeList3"}


@dataclass(frozen=True, eq=False)
class RawTags:
    """Tags of a raw file; empty if it is not built like TIFF.

    Args:
        settings: Fields of `RawFrame` by name.
        page: Numbers of the raw picture's tags by code.
        place: Index of the raw picture in the file, -1 if there is none.
        is_dng: Whether it is a DNG.
        is_plain: Whether it is a TIFF without anything of a camera.
    """

    settings: dict = field(default_factory=dict)
    page: dict = field(default_factory=dict)
    place: int = -1
    is_dng: bool = False
    is_plain: bool = False

    def check(self, path) -> None:
        """Raise BadFile for values that are not the sensor's any more."""
        if not self.is_dng:
            return
        if self.place < 0:
            raise BadFile(path, "a DNG without a raw picture (CFA or LinearRaw)")
        samples = self._one(277, 1)
        if self._one(262, 0) == LINEAR_RAW and samples > 1:
            why = "demosaicked (LinearRaw), neighbours are correlated"
            raise BadFile(path, f"{why}; shoot raw with the sensor's own mosaic")
        lossy_jxl = self._one(259, 1) == JXL and self._one(52553, 0.0) != 0
        if self._one(259, 1) in LOSSY or lossy_jxl:
            raise BadFile(path, f"compressed with loss, its noise is not the sensor's; {RAW_DNG}")
        applied = self._one(NOISE_REDUCTION, 0.0)
        if math.isfinite(applied) and applied > 0:
            why = f"denoised before it was written (NoiseReductionApplied {applied:g})"
            raise BadFile(path, f"{why}; switch noise reduction off and shoot raw again")

    @property
    def has_plain_values(self) -> bool:
        """Whether the values can be read without LibRaw."""
        is_simple = self._one(259, 1) == 1 and self._one(50975, 1) == 1 and self._one(50711, 1) == 1
        return self.is_dng and self.place >= 0 and is_simple and self._one(258, 16) in (8, 16, 32)

    @property
    def cfa(self) -> tuple[str, ...] | None:
        """One period of the mosaic, None if it is none that is known."""
        if self._one(262, 0) == LINEAR_RAW:
            return ("Y",)
        rows, cols = map(int, self.page.get(33421, (2, 2)))
        codes = [int(code) for code in self.page.get(33422, ())]
        if len(codes) != rows * cols or not codes or max(codes) >= len(LETTERS):
            return None
        letters = "".join(LETTERS[code] for code in codes)
        return tuple(letters[start : start + cols] for start in range(0, len(letters), cols))

    @property
    def black_level(self) -> np.ndarray | None:
        """Black level [DN] of each place of its period, the mean over rows and columns."""
        levels = self.page.get(50714)
        if levels is None or self._one(277, 1) != 1:
            return None
        rows, cols = map(int, self.page.get(50713, (1, 1)))
        levels = np.asarray(levels, np.float64)
        deltas = [self.page[code].mean() for code in (50715, 50716) if len(self.page.get(code, ()))]
        return levels.reshape(rows, cols) + sum(deltas) if levels.size == rows * cols else None

    @property
    def white_level(self) -> float | None:
        """Largest value [DN]."""
        return float(self.page[50717].max()) if len(self.page.get(50717, ())) else None

    @property
    def noise_profile(self) -> np.ndarray | None:
        """Pairs S, O of NoiseProfile."""
        pairs = self.page.get(NOISE_PROFILE, np.empty(0))
        return pairs.reshape(-1, 2) if len(pairs) >= 2 and len(pairs) % 2 == 0 else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about tags that change values and are not applied."""
        names = [name for code, name in NOT_APPLIED.items() if code in self.page]
        if any(np.ptp(self.page.get(code, np.zeros(1))) > 0 for code in (50715, 50716)):
            names.append("black levels of rows and columns")
        return (f"not applied: {', '.join(names)}",) if names else ()

    def values(self, path) -> np.ndarray:
        """Read the values of the active area, through the file's table if it has one."""
        import tifffile

        with (
            open_file(path) as file,
            silence("tifffile"),
            reading(path, "a DNG"),
            tifffile.TiffFile(file) as tiff,
        ):
            page = [*_pages(tiff)][self.place]
            values = np.squeeze(page.asarray())
        size = self._one(257, 0), self._one(256, 0)
        top, left, bottom, right = map(int, self.page.get(50829, (0, 0, *size)))
        values = values[top:bottom, left:right]
        table = self.page.get(50712)
        if table is not None:
            values = table.astype(np.uint16)[np.minimum(values, len(table) - 1)]
        return values

    def _one(self, code, default):
        numbers = self.page.get(code, ())
        return float(numbers[0]) if len(numbers) else default


def read_raw_tags(path) -> RawTags:
    """Read the tags of a file that is built like TIFF. Raises BadFile."""
    import tifffile

    with (
        open_file(path) as file,
        silence("tifffile"),
        reading(path, "a raw file"),
        tifffile.TiffFile(file) as tiff,
    ):
        found = [*_pages(tiff)]
        pages = [{tag.code: _numbers(tag) for tag in page.tags} for page in found]
        exif: Any = next((page.tags[EXIF].value for page in found if EXIF in page.tags), {})
        first = found[0].tags
        names = {code: _text(first, code) for code in (MAKE, MODEL, UNIQUE_MODEL, SOFTWARE)}
        is_dng = DNG_VERSION in first
    place = next((index for index, page in enumerate(pages) if _is_raw(page)), -1)
    raw = pages[place] if place >= 0 else {}
    shared = {code: pages[0][code] for code in (NOISE_REDUCTION, NOISE_PROFILE) if code in pages[0]}
    settings = _settings(exif if isinstance(exif, dict) else {}, pages[0])
    settings["camera"] = _camera(names)
    is_plain = not is_dng and place < 0 and not names[MAKE]
    return RawTags(settings, shared | raw, place, is_dng, is_plain)


def _pages(tiff):
    for page in islice(tiff.pages, MOST_PICTURES):
        yield page
        yield from islice(page.pages or (), MOST_PICTURES)


def _is_raw(page):
    kind = page.get(262, np.zeros(1))
    is_preview = len(page.get(254, ())) and int(page[254][0]) & PREVIEW
    return len(kind) and kind[0] in (CFA, LINEAR_RAW) and not is_preview


def _numbers(tag):
    """Return the numbers of a tag, fractions as one number each; none of a text or a block."""
    value = tag.value
    if (
        tag.code == EXIF
        or isinstance(value, str | dict)
        or (isinstance(value, bytes) and len(value) > 64)
    ):
        return np.empty(0)
    try:
        numbers = np.array(list(value) if isinstance(value, bytes) else value, np.float64).ravel()
    except (TypeError, ValueError):
        return np.empty(0)
    if int(tag.dtype) in (5, 10):
        numbers = numbers[::2] / np.where(numbers[1::2] == 0, np.nan, numbers[1::2])
    return numbers


def _text(tags, code):
    value = tags[code].value if code in tags else ""
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return value.strip("\0 ")


def _camera(names):
    make, model = names[MAKE], names[MODEL]
    if not model:
        return names[UNIQUE_MODEL] or make or None
    has_make = model.lower().startswith(make.lower().split(" ")[0]) if make else True
    return model if has_make else f"{make} {model}"


def _settings(exif, first):
    """Return settings of the exposure from EXIF tags, or from the first picture."""

    def one(*names, codes=()):
        for name in names:
            number = _ratio(exif.get(name))
            if number is not None and number > 0:
                return number
        values = (first[code][0] for code in codes if len(first.get(code, ())))
        return next((float(value) for value in values if value > 0), None)

    iso = one("PhotographicSensitivity", "ISOSpeedRatings", codes=(34855,))
    if iso is None or iso >= 65535:  # the largest that the tag holds
        iso = one("ISOSpeed", "RecommendedExposureIndex", "StandardOutputSensitivity") or iso
    length = one("FocalLength", codes=(37386,))
    return {
        "iso": iso,
        "exposure_time": one("ExposureTime", codes=(33434,)),
        "f_number": one("FNumber", codes=(33437,)),
        "focal_length": length / 1000 if length else None,
        "temperature": _ratio(exif.get("AmbientTemperature", exif.get(37888))),
    }


def _ratio(value):
    """Return a number of EXIF, a fraction as one; None if there is none."""
    try:
        if isinstance(value, list | tuple):
            value = value[0] / value[1] if len(value) == 2 else value[0]
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if math.isfinite(number) else None
