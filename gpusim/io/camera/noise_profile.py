"""Gain and read noise from the noise profile of a raw photograph (DNG tag 51041)."""

import math
from dataclasses import dataclass, field, replace
from itertools import islice
from os import PathLike

import numpy as np

from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.raw_noise import ROUNDING
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.io.account import Fields
from gpusim.io.files import name_in_errors, open_file, reading, silence

CFA, LINEAR_RAW = 32803, 34892  # TIFF's codes of raw pictures
PREVIEW = 1  # bit of NewSubfileType
FLOATS = 3  # TIFF's code of a sample format
# Tags by number: levels, noise, and what may change raw values or the geometry of a picture
TAGS = {
    254: "NewSubfileType",
    256: "ImageWidth",
    257: "ImageLength",
    258: "BitsPerSample",
    262: "PhotometricInterpretation",
    277: "SamplesPerPixel",
    339: "SampleFormat",
    50710: "CFAPlaneColor",
    50711: "CFALayout",
    50712: "LinearizationTable",
    50713: "BlackLevelRepeatDim",
    50714: "BlackLevel",
    50715: "BlackLevelDeltaH",
    50716: "BlackLevelDeltaV",
    50717: "WhiteLevel",
    50718: "DefaultScale",
    50719: "DefaultCropOrigin",
    50720: "DefaultCropSize",
    50731: "BaselineNoise",
    50829: "ActiveArea",
    50830: "MaskedAreas",
    50935: "NoiseReductionApplied",
    50975: "RowInterleaveFactor",
    51008: "OpcodeList1",
    51009: "OpcodeList2",
    51022: "OpcodeList3",
    51041: "NoiseProfile",
}
FIRST_TOO = ("NoiseProfile", "BaselineNoise", "NoiseReductionApplied", "CFAPlaneColor")
LEVELS = (50714, 50715, 50716, 50717, 51041)  # may be refused if they are not finite
OPCODES = (51008, 51009, 51022)
RATIONAL = (5, 10)  # TIFF's types of fractions
SPREAD = 1.25  # allowed ratio of the planes' factors: a sensor has one gain
MOST_PICTURES = 32  # of a file
WHAT = "a DNG"
DEMOSAICKED = (
    "its noise is of demosaicked data (LinearRaw), not of the sensor: neighbours are correlated, and a "
    "pixel has less noise"
)


@dataclass(frozen=True)
class NoiseProfile:
    """Variance of raw values as scale x + offset, x from 0 at black_level to 1 at white_level.

    For N electrons, a gain of K [DN/e-] and read noise r [e-], x = K N / (W - B) has the variance
    K^2 (N + r^2 + 1 / (12 K^2)) / (W - B)^2; the last term is rounding. So K = scale (W - B), white
    is 1 / scale electrons, and r^2 = (offset - 1 / (12 (W - B)^2)) / scale^2.

    Source: Adobe, "Digital Negative (DNG) Specification", 1.4.0.0, NoiseProfile.

    Attributes:
        scale: S of the profile [1].
        offset: O of the profile [1].
        black_level: black level B [DN].
        white_level: white level W [DN].
        is_float: whether raw values are floats, which are not rounded.
        notes: tags of the file that are not used.

    Raises:
        OutOfRange: if a value is out of range.
    """

    scale: float
    offset: float
    black_level: float
    white_level: float
    is_float: bool = False
    notes: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self):
        if not 0 <= self.black_level < self.white_level <= 65535:
            raise OutOfRange(
                "black level, white level",
                f"{self.black_level:.6g}, {self.white_level:.6g}",
                "0 <= black < white <= 65535 DN",
            )
        if not 1e-9 <= self.scale <= 1:
            allowed = "1e-9 <= S <= 1, white at 1 .. 1e9 e-"
            raise OutOfRange("noise profile's scale S", f"{self.scale:.6g}", allowed)
        if not abs(self.offset) <= 1:
            raise OutOfRange("noise profile's offset O", f"{self.offset:.6g}", "-1 <= O <= 1")

    @property
    def gain(self) -> float:
        """K [DN/e-]."""
        return self.scale * (self.white_level - self.black_level)

    @property
    def read(self) -> float:
        """Read noise without rounding [e-]; 0 if the profile has less noise than rounding."""
        rounding = 0 if self.is_float else ROUNDING / (self.white_level - self.black_level) ** 2
        return math.sqrt(max(self.offset - rounding, 0.0)) / self.scale

    def apply_to(self, sensor: Sensor) -> Sensor:
        """Return the sensor with this gain, these levels, this saturation and this read noise.

        `read` replaces all noise of reading. Fixed patterns, dark current and the rest stay,
        because a profile does not have them.
        """
        noise = replace(sensor.noise, read=self.read, reset=0.0, adc=0.0, row=0.0, column=0.0)
        return replace(
            sensor,
            **self.fields,
            conversion_gain=None,
            adc_range=None,
            analog_gain=1.0,
            analog_offset=0.0,
            noise=noise,
        )

    @property
    def fields(self) -> dict:
        """Fields of `Sensor` that the profile determines."""
        return {
            "gain": self.gain,
            "full_well": 1 / self.scale,
            "black_level": round(self.black_level),
            "bits": FLOAT_BITS
            if self.is_float
            else max(1, math.ceil(math.log2(self.white_level + 1))),
        }


def read_noise_profile(path: str | PathLike) -> NoiseProfile:
    """Read the noise profile of a DNG and its black and white levels.

    Planes of a profile are averaged; it is refused if their factors differ by more than a quarter.
    The black level is the mean over the active area of BlackLevel, BlackLevelDeltaH and
    BlackLevelDeltaV.

    Args:
        path: DNG file.

    Returns:
        The profile; its `notes` name tags that are not used, and warn of demosaicked data.

    Raises:
        BadFile: if the file cannot be read or has no usable profile.

    Source:
        Adobe, "Digital Negative (DNG) Specification", 1.4.0.0.
    """
    tags, count = _tags(path)
    with name_in_errors(path):
        fields, notes = Fields(tags, "tags that are not used"), []
        if "NoiseProfile" not in fields:
            raise BadData(
                "has no NoiseProfile (tag 51041); Android's camera and Adobe's DNG Converter write one"
            )
        if count == 0:
            raise BadData("has no raw picture (CFA or LinearRaw); wanted a raw photograph")
        if count > 1:
            notes.append(f"the first of {count} raw pictures is used")
        if fields.take("PhotometricInterpretation")[0] == LINEAR_RAW:
            notes.append(DEMOSAICKED)
        is_float = FLOATS in fields.take("SampleFormat", ())
        planes = max(len(fields.take("CFAPlaneColor", ())) or 3, _one(fields, "SamplesPerPixel", 1))
        scale, offset = _profile(fields, planes, notes)
        bits = int(np.max(fields.take("BitsPerSample", 16)))
        white = fields.take("WhiteLevel", [1.0 if is_float else 2 ** min(bits, 16) - 1])
        if np.ptp(white) > 0:
            notes.append(
                f"WhiteLevel is {np.min(white):g} .. {np.max(white):g} by plane: their mean"
            )
        black = _black_level(fields, notes)
        if "LinearizationTable" in fields:
            notes.append(
                "values are stored through a LinearizationTable: levels are of linear ones"
            )
        fields.take("LinearizationTable")
        if _one(fields, "NoiseReductionApplied", 0) > 0:
            notes.append("noise was reduced before the file was written (NoiseReductionApplied)")
        _ignore_defaults(fields, tags)
        return NoiseProfile(
            scale, offset, black, float(np.mean(white)), is_float, (*notes, *fields.notes())
        )


def _profile(fields, planes, notes):
    """Return the mean scale and offset of a profile. planes: of the picture's colours."""
    profile = np.array(fields.take("NoiseProfile"), np.float64).ravel()
    if len(profile) < 2 or len(profile) % 2 or not np.isfinite(profile).all():
        why = f"NoiseProfile has {len(profile)} numbers: wanted 2 for each plane, or 2, finite"
        raise BadData(why)
    scale, offset = profile.reshape(-1, 2).T
    if scale.max() > SPREAD * scale.min():
        raise BadData(
            f"NoiseProfile has a factor of {scale.min():.3g} .. {scale.max():.3g} by plane: wanted "
            f"one gain, factors within {SPREAD:g}"
        )
    if len(scale) not in (1, planes):
        notes.append(f"NoiseProfile has {len(scale)} pairs for {planes} planes")
    if len(scale) > 1 and np.ptp(scale) > 1e-6 * scale.max():
        low, high = scale.min(), scale.max()
        notes.append(
            f"NoiseProfile's factors are {low:.4g} .. {high:.4g} by plane: their mean is used"
        )
    return float(scale.mean()), float(offset.mean())


def _black_level(fields, notes):
    """Return the mean black level of the active area [DN]."""
    size = _one(fields, "ImageLength", 0), _one(fields, "ImageWidth", 0)
    area = fields.take("ActiveArea", [0, 0, *size])
    if len(area) != 4 or not (0 <= area[0] < area[2] and 0 <= area[1] < area[3]):
        raise BadData(f"ActiveArea: {list(area)}: wanted top, left, bottom, right")
    shape = area[2] - area[0], area[3] - area[1]
    if (*area,) != (0, 0, *size):
        notes.append(f"the active area is {shape[1]:g} x {shape[0]:g} of {size[1]:g} x {size[0]:g}")
    level = np.asarray(fields.take("BlackLevel", [0.0]), np.float64)
    repeats = fields.take("BlackLevelRepeatDim", [1, 1])
    samples = _one(fields, "SamplesPerPixel", 1)
    if "BlackLevelRepeatDim" in fields and len(level) != np.prod(repeats) * samples:
        raise BadData(
            f"BlackLevel has {len(level)} numbers: wanted {np.prod(repeats) * samples:g}, of "
            "BlackLevelRepeatDim and SamplesPerPixel"
        )
    parts = [level]
    for name, wanted, where in (
        ("BlackLevelDeltaV", shape[0], "rows"),
        ("BlackLevelDeltaH", shape[1], "columns"),
    ):
        delta = np.asarray(fields.take(name, [0.0]), np.float64)
        if name in fields and len(delta) != wanted:
            why = f"{len(delta)} numbers, wanted {wanted:g}, the {where} of the active area"
            raise BadData(f"{name}: {why}")
        parts.append(delta)
    spread = sum(np.ptp(part) for part in parts)
    mean = float(sum(part.mean() for part in parts))
    if spread > 0:
        notes.append(
            f"the black level varies by {spread:.4g} DN over the picture: its mean is used"
        )
    if math.isfinite(mean) and mean != round(mean):
        notes.append(f"the black level {mean:.6g} is rounded to whole DN")
    return mean


def _one(fields, name, default):
    """Return the first number of a tag."""
    return fields.take(name, [default])[0]


def _ignore_defaults(fields, tags):
    """Leave tags out of the account that have no effect at their values."""
    fields.ignore("NewSubfileType")
    for name in ("CFALayout", "RowInterleaveFactor", "BaselineNoise", "DefaultScale"):
        if name in fields and all(value == 1 for value in tags[name]):
            fields.ignore(name)


def _tags(path):
    """Return the raw picture's tags by name, and the number of raw pictures.

    Some tags may be the first picture's.
    """
    import tifffile

    with (
        open_file(path) as file,
        silence("tifffile"),
        reading(path, WHAT),
        tifffile.TiffFile(file) as tiff,
    ):
        found = []
        for page in list(islice(tiff.pages, MOST_PICTURES)):
            for part in [page, *list(page.pages or ())[:MOST_PICTURES]]:
                tags = {
                    name: _values(part, code) for code, name in TAGS.items() if code in part.tags
                }
                found.append({name: values for name, values in tags.items() if len(values)})
    if not found:
        raise BadFile(path, f"not {WHAT}, or truncated (no pictures)")
    own = {name: found[0][name] for name in FIRST_TOO if name in found[0]}
    raw = [
        tags
        for tags in found
        if tags.get("PhotometricInterpretation", [0])[0] in (CFA, LINEAR_RAW)
        and not int(tags.get("NewSubfileType", [0])[0]) & PREVIEW
    ]
    return (own | raw[0] if raw else own), len(raw)


def _values(page, code):
    """Return the numbers of a tag, fractions as one number each."""
    tag = page.tags[code]
    if isinstance(tag.value, bytes) and code in OPCODES:
        return np.ones(1)
    value = list(tag.value) if isinstance(tag.value, bytes) else tag.value
    values = np.array(value, np.float64).ravel()
    if tag.dtype in RATIONAL:
        values = values[::2] / np.where(values[1::2] == 0, np.nan, values[1::2])
    return values if code in LEVELS else np.nan_to_num(values)
