"""Gain and read noise from the noise profile of a raw photograph (DNG's tag 51041)."""

import logging
import math
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import ROUNDING
from gpusim.domain.sensor import Sensor
from gpusim.io.files import named, open_file, reading

CFA, LINEAR_RAW = 32803, 34892  # TIFF's codes of raw pictures
PHOTOMETRIC, BITS, SUBFILE = 262, 258, 254
BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE = 50714, 50717, 51041
RATIONAL = (5, 10)  # TIFF's types of fractions
SPREAD = 1.25  # of the planes' factors: a sensor has one gain
WHAT = "a DNG"


@dataclass(frozen=True)
class NoiseProfile:
    """Variance of raw values, scale x + offset, x the mean from 0 at black_level to 1 at white_level [DN].

    Of N electrons, a gain of K [DN/e-] and read noise of r [e-], x = K N / (W - B) has the variance
    K^2 (N + r^2 + 1 / (12 K^2)) / (W - B)^2, the last for rounding. So K = scale (W - B), white is at 1 / scale
    electrons, and r^2 = (offset - 1 / (12 (W - B)^2)) / scale^2.
    Source: Adobe, "Digital Negative (DNG) Specification", 1.4.0.0, NoiseProfile. Raises OutOfRange.
    """

    scale: float
    offset: float
    black_level: float
    white_level: float

    def __post_init__(self):
        if not 0 <= self.black_level < self.white_level <= 65535:
            raise OutOfRange(
                "black level, white level",
                f"{self.black_level:.6g}, {self.white_level:.6g}",
                "0 <= black < white <= 65535 DN",
            )
        if not 1e-9 <= self.scale <= 1:
            raise OutOfRange(
                "noise profile's scale S",
                f"{self.scale:.6g}",
                "1e-9 <= S <= 1, white at 1 .. 1e9 e-",
            )
        if not abs(self.offset) <= 1:
            raise OutOfRange("noise profile's offset O", f"{self.offset:.6g}", "-1 <= O <= 1")

    @property
    def gain(self) -> float:
        """K [DN/e-]."""
        return self.scale * (self.white_level - self.black_level)

    @property
    def read(self) -> float:
        """Read noise without rounding [e-], 0 where the profile has less than rounding makes."""
        rounding = ROUNDING / (self.white_level - self.black_level) ** 2
        return math.sqrt(max(self.offset - rounding, 0.0)) / self.scale

    def applied(self, sensor: Sensor) -> Sensor:
        """The sensor with this gain, these levels, saturation at the white level, and all noise of reading as `read`.

        Fixed patterns, dark current and the rest stay: a profile does not know them.
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
        """What of `Sensor` it tells."""
        return {
            "gain": self.gain,
            "full_well": 1 / self.scale,
            "black_level": round(self.black_level),
            "bits": max(1, math.ceil(math.log2(self.white_level + 1))),
        }


def read_noise_profile(path) -> NoiseProfile:
    """Read the noise profile of a DNG and the levels that it refers to. Raises BadFile.

    Planes of a profile are averaged; those whose factors differ by more than a quarter are refused.
    """
    tags = _tags(path)
    with named(path):
        if NOISE_PROFILE not in tags:
            raise BadData(
                "has no NoiseProfile (tag 51041); Android's camera and Adobe's DNG Converter write one"
            )
        profile = np.array(tags[NOISE_PROFILE], np.float64).ravel()
        if len(profile) < 2 or len(profile) % 2 or not np.isfinite(profile).all():
            raise BadData(
                f"NoiseProfile has {len(profile)} numbers: wanted 2 for each plane, or 2, finite"
            )
        scale, offset = profile.reshape(-1, 2).T
        if scale.max() > SPREAD * scale.min():
            raise BadData(
                f"NoiseProfile has a factor of {scale.min():.3g} .. {scale.max():.3g} by plane: wanted one "
                f"gain, factors within {SPREAD:g}"
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
    """The numbers of the raw picture's tags, and of the first picture's where the raw one has none."""
    import tifffile

    with (
        open_file(path) as file,
        _silent("tifffile"),
        reading(path, WHAT),
        tifffile.TiffFile(file) as tiff,
    ):
        first = tiff.pages[0]
        pages = [first, *(first.pages or ())]
        found = [
            {
                code: values
                for code in (SUBFILE, PHOTOMETRIC, BITS, BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE)
                if code in page.tags and len(values := _values(page, code))
            }
            for page in pages
        ]
    raw = next(
        (
            tags
            for tags in found
            if tags.get(PHOTOMETRIC, [0])[0] in (CFA, LINEAR_RAW)
            and not tags.get(SUBFILE, [0])[0] & 1
        ),
        None,
    )
    return (
        {NOISE_PROFILE: found[0][NOISE_PROFILE], **(raw or {})}
        if NOISE_PROFILE in found[0]
        else raw or {}
    )


def _values(page, code):
    """Numbers of a tag, fractions as one number each."""
    tag = page.tags[code]
    values = np.array(tag.value, np.float64).ravel()
    if tag.dtype in RATIONAL:
        values = values[::2] / np.where(values[1::2] == 0, np.nan, values[1::2])
    return values if code in (BLACK_LEVEL, WHITE_LEVEL, NOISE_PROFILE) else values.astype(int)


@contextmanager
def _silent(name):
    """While a library would print what is wrong with a file, which is said as one error."""
    logger = logging.getLogger(name)
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before
