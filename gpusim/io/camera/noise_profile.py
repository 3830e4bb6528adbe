"""Gain and read noise from the noise profile of a raw photograph (DNG tag 51041)."""

import math
from dataclasses import dataclass, field, replace
from os import PathLike

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import ROUNDING
from gpusim.domain.sensor import Sensor
from gpusim.io.files import name_in_errors, open_file, reading, silence

CFA, LINEAR_RAW = 32803, 34892  # TIFF's codes of raw pictures
PHOTOMETRIC, BITS, SUBFILE = 262, 258, 254
BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE = 50714, 50717, 51041
READ = SUBFILE, PHOTOMETRIC, BITS, BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE
RATIONAL = (5, 10)  # TIFF's types of fractions
SPREAD = 1.25  # allowed ratio of the planes' factors: a sensor has one gain
WHAT = "a DNG"


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
        notes: tags of the file that are not used.

    Raises:
        OutOfRange: if a value is out of range.
    """

    scale: float
    offset: float
    black_level: float
    white_level: float
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
        rounding = ROUNDING / (self.white_level - self.black_level) ** 2
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
            "bits": max(1, math.ceil(math.log2(self.white_level + 1))),
        }


def read_noise_profile(path: str | PathLike) -> NoiseProfile:
    """Read the noise profile of a DNG and its black and white levels.

    Planes of a profile are averaged; it is refused if their factors differ by more than a quarter.

    Args:
        path: DNG file.

    Returns:
        The profile.

    Raises:
        BadFile: if the file cannot be read or has no usable profile.
    """
    tags = _tags(path)
    with name_in_errors(path):
        if NOISE_PROFILE not in tags:
            raise BadData(
                "has no NoiseProfile (tag 51041); Android's camera and Adobe's DNG Converter write one"
            )
        profile = np.array(tags[NOISE_PROFILE], np.float64).ravel()
        if len(profile) < 2 or len(profile) % 2 or not np.isfinite(profile).all():
            why = f"NoiseProfile has {len(profile)} numbers: wanted 2 for each plane, or 2, finite"
            raise BadData(why)
        scale, offset = profile.reshape(-1, 2).T
        if scale.max() > SPREAD * scale.min():
            raise BadData(
                f"NoiseProfile has a factor of {scale.min():.3g} .. {scale.max():.3g} by plane: wanted "
                f"one gain, factors within {SPREAD:g}"
            )
        bits = int(np.max(tags.get(BITS, 16)))
        white = tags.get(WHITE_LEVEL, (2 ** min(bits, 16) - 1,))
        return NoiseProfile(
            float(scale.mean()),
            float(offset.mean()),
            float(np.mean(tags.get(BLACK_LEVEL, 0))),
            float(np.mean(white)),
        )


def _tags(path):
    """Return the raw picture's tags, and the first picture's NoiseProfile if the raw has none."""
    import tifffile

    with (
        open_file(path) as file,
        silence("tifffile"),
        reading(path, WHAT),
        tifffile.TiffFile(file) as tiff,
    ):
        first = tiff.pages[0]
        found = []
        for page in [first, *(first.pages or ())]:
            tags = {code: _values(page, code) for code in READ if code in page.tags}
            found.append({code: values for code, values in tags.items() if len(values)})
    own = {code: values for code, values in found[0].items() if code == NOISE_PROFILE}
    for tags in found:
        is_preview = tags.get(SUBFILE, [0])[0] & 1
        if tags.get(PHOTOMETRIC, [0])[0] in (CFA, LINEAR_RAW) and not is_preview:
            return own | tags
    return own


def _values(page, code):
    """Return the numbers of a tag, fractions as one number each."""
    tag = page.tags[code]
    values = np.array(tag.value, np.float64).ravel()
    if tag.dtype in RATIONAL:
        values = values[::2] / np.where(values[1::2] == 0, np.nan, values[1::2])
    return values if code in (BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE) else values.astype(int)
