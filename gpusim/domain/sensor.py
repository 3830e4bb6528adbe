"""The image sensor: filters, photodetector, pixel, noise and conversion to digital numbers."""

import math
from dataclasses import dataclass, field

import numpy as np

from gpusim.domain.dual import DualPixels
from gpusim.domain.errors import (
    BadData,
    Conflict,
    Interval,
    Limits,
    OutOfRange,
    check_fields,
    check_known,
    format_value,
    within,
)
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.filters import Filters
from gpusim.domain.lenslets import Lenslets, check_lenslets
from gpusim.domain.mosaics import bayer_phase
from gpusim.domain.noise import Noise
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum, check_quantity, is_increasing

FLOAT_BITS = 32  # value of `bits` for raw values without a converter
IMPLAUSIBLE = 30.0  # times the converter's range, or a part of it: a full well that is a wrong gain
LONGEST_PERIOD = 8  # rows and columns of the mosaic that the kernels' tables hold

# Limits of fields. The square of 1e12 electrons, seconds or gains is far from float32's limit.
LIMITS = {
    "pixel_pitch": within("0 < pixel_pitch <= 0.001 m", "m"),
    "fill_factor": within("0 < fill_factor <= 1"),
    "photodetector": Limits(
        "height and width over the pitch, 0 < each <= 1",
        Interval(0, 1, has_lowest=False),
        is_pair=True,
    ),
    "centre": Limits("rows and columns, within -0.5 .. 0.5", Interval(-0.5, 0.5), is_pair=True),
    "offset": Limits(
        "rows and columns [pixel], within -1e4 .. 1e4", Interval(-1e4, 1e4), is_pair=True
    ),
    "exposure_time": within("0 < exposure_time <= 1e12, or automatic", "s"),
    "row_time": within("0 <= row_time <= 1e12", "s"),
    "full_well": within("0 < full_well <= 1e12", "e-"),
    "bits": Limits(
        "a whole number, 1 <= bits <= 16, or 32 for float32 without a converter",
        (*range(1, 17), FLOAT_BITS),
    ),
    "gain": within("0 < gain <= 1e12, or automatic", "DN/e-"),
    "conversion_gain": within("0 < conversion_gain <= 1e12, or automatic", "V/e-"),
    "adc_range": within("0 < adc_range <= 1e12, or automatic", "V"),
    "analog_gain": within("0 < analog_gain <= 1e4"),
    "analog_offset": within("-1e12 <= analog_offset <= 1e12", "e-"),
    "binning": Limits(
        f"rows and columns, whole numbers 1 .. {LONGEST_PERIOD}",
        range(1, LONGEST_PERIOD + 1),
        is_pair=True,
    ),
}


@dataclass(frozen=True, eq=False)
class Microlens:
    """Response of a pixel to oblique light.

    Args:
        angles: Chief-ray angles [rad], increasing from 0, shape (n,).
        response: Response relative to a pixel on the axis [1], 1 at angle 0, shape (n,).
        shift: Displacement of the microlenses toward the axis: 0 is none; with 1 every pixel
            receives its chief ray as a pixel on the axis does.

    Raises:
        BadData: Angles and responses do not fit.
        OutOfRange: The shift is outside its range.
    """

    angles: np.ndarray
    response: np.ndarray
    shift: float = 0.0

    __repr__ = short_repr

    def __post_init__(self):
        angles = np.asarray(self.angles, np.float64)
        response = np.asarray(self.response, np.float64)
        has_pairs = is_increasing(angles) and angles.shape == response.shape and len(angles) > 1
        if not has_pairs or angles[0] != 0:
            raise BadData(
                "sensor.microlens: wanted two or more angles rising from 0 and as many responses"
            )
        if not (np.isfinite(response).all() and response.min() >= 0 and response[0] > 0):
            raise BadData(
                "sensor.microlens: a response is negative or not finite, or that on the axis is 0"
            )
        if not 0 <= self.shift <= 2:
            raise OutOfRange("sensor.microlens.shift", self.shift, "0 <= shift <= 2")
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "response", response / response[0])


@dataclass(frozen=True)
class Sensor:
    """An image sensor with square pixels and one repeating colour mosaic.

    Args:
        pixel_pitch: Pixel pitch [m].
        qe: Quantum efficiency [e-/photon] of photons inside the pixel's aperture, shape (C, L), C =
            len(channels): the product of colour filter, photodetector and infrared cut. It must
            cover the light of the scene. The quantum efficiency of a data sheet counts all photons
            on the pixel: Use it with fill_factor = 1.
        full_well: Full-well capacity of a pixel [e-].
        bits: Resolution of the converter, 1 to 16; digital numbers go from 0 to 2**bits - 1. 32: no
            converter, raw values are float32, neither rounded nor clipped after the well.
        channels: One letter per curve, for example ("R", "G", "B") or ("Y",).
        cfa: Period of the colour filter array as rows of these letters, for example ("RG", "GB"),
            or ("Y",) for monochrome; at most 8 x 8.
        stacked: Every pixel has all channels, one above the other, instead of the mosaic. They are
            read one after the other through the same columns: Column noise is common to all
            channels, row noise is separate.
        fill_factor: Aperture area over pixel area [1]. The aperture is a square unless
            `photodetector` is given.
        photodetector: Height and width of the aperture over the pitch [1]; their product is then
            the fill factor.
        centre: Position of the aperture relative to the pixel's centre, over the pitch, (rows,
            cols) [1].
        offset: Displacement of the whole pixel grid from the centre of the picture, (rows, cols)
            [pixel]. Several captures sample a finer grid; give each its own noise.seed, and its own
            seed or frame number for temporal noise.
        microlens: Loss of oblique light toward the corner, or None.
        lenslets: Array of lenslets of a light-field camera, each over many pixels, or None.
        vignetting: Map of relative responses over the frame, shape (ny, nx), nodes evenly spaced
            from edge to edge, interpolated bilinearly; or None.
        exposure_time: Exposure time [s]; None: `auto_exposure` sets it.
        auto_exposure: Rule for exposure time and gain.
        row_time: Delay of each row relative to the row above [s]; 0: global shutter.
        binning: Rows and columns of neighbours of one colour that are read as one pixel.
        binning_mode: "digital": digital numbers are averaged. "charge": electrons are added on one
            node with as many full wells; response, dark current, hot and dead pixels belong to
            each pixel, while reset, offset, traps and all read noise occur once per node. Overflow
            of single wells is not simulated.
        gain: System gain at analog gain 1 [DN/e-]; None: a full well just reaches the white level,
            or the gain follows from conversion_gain and adc_range.
        conversion_gain: Conversion gain of the pixel [V/e-], with adc_range.
        adc_range: Voltage of all 2**bits - 1 steps (without a converter, of 65535) [V].
        analog_gain: Factor on the gain [1].
        analog_offset: Electrons added before the converter [e-].
        black_level: Digital number of a dark pixel [DN].
        noise: Noise of the sensor.
        dual: Photodiodes under one microlens, or sparse phase-detection pixels, or None.
        filters: Curves of the parts that `qe` is the product of, by letter, if a camera file gave
            them: `Camera.with_(cfa=...)` takes channels from them.

    Raises:
        BadData: Settings have the wrong type or shape, or exclude each other.
        Conflict: Sparse phase-detection pixels are stacked or binned.
        OutOfRange: A number is outside its range.
        UnknownName: The binning mode is not known.
    """

    pixel_pitch: float
    qe: Spectrum
    full_well: float
    bits: int
    channels: tuple[str, ...] = ("R", "G", "B")
    cfa: tuple[str, ...] = ("RG", "GB")
    stacked: bool = False
    fill_factor: float = 1.0
    photodetector: tuple[float, float] | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)
    microlens: Microlens | None = None
    lenslets: Lenslets | None = None
    vignetting: tuple[tuple[float, ...], ...] | None = None
    exposure_time: float | None = None
    auto_exposure: AutoExposure = field(default_factory=AutoExposure)
    row_time: float = 0.0
    binning: tuple[int, int] = (1, 1)
    binning_mode: str = "charge"
    gain: float | None = None
    conversion_gain: float | None = None
    adc_range: float | None = None
    analog_gain: float = 1.0
    analog_offset: float = 0.0
    black_level: int = 0
    noise: Noise = field(default_factory=Noise)
    dual: DualPixels | None = None
    filters: Filters | None = field(
        default=None, repr=False, compare=False, metadata={"digest": False}
    )

    __repr__ = short_repr

    def __post_init__(self):
        for key, kind in (("qe", Spectrum), ("noise", Noise), ("auto_exposure", AutoExposure)):
            if not isinstance(getattr(self, key), kind):
                raise BadData(
                    f"sensor.{key} = {format_value(getattr(self, key))}: wanted a gpusim.{kind.__name__}"
                )
        check_quantity("sensor.qe", self.qe)
        for key in ("channels", "cfa", "binning"):
            if isinstance(getattr(self, key), (str, list, tuple, np.ndarray)):
                object.__setattr__(self, key, tuple(getattr(self, key)))
        for key, wanted in (("channels", '("R", "G", "B")'), ("cfa", '("RG", "GB")')):
            value = getattr(self, key)
            if not isinstance(value, tuple) or not all(isinstance(text, str) for text in value):
                raise BadData(
                    f"sensor.{key} = {format_value(value)}: wanted a tuple of texts, such as {wanted}"
                )
        check_fields("sensor", self, LIMITS)
        check_lenslets(self.lenslets, self.pixel_pitch)
        for key in ("dual", "microlens", "vignetting"):
            if self.lenslets is not None and getattr(self, key) is not None:
                raise BadData(
                    f"sensor.lenslets and sensor.{key}: what pixels behind lenslets see is not divided or dimmed any "
                    f"further, and {key} would be ignored; leave one of them out"
                )
        self._check_pixel()
        self._check_readout()
        self._check_mosaic()
        self._check_dual()

    def _check_dual(self):
        if self.dual is not None and not isinstance(self.dual, DualPixels):
            raise BadData(f"sensor.dual: {type(self.dual).__name__}, wanted a gpusim.DualPixels")
        if self.dual is None or not self.dual.sparse:
            return
        if self.stacked or self.binning != (1, 1):
            raise Conflict(
                "sensor.dual.sparse",
                "phase-detection pixels are neither stacked nor binned",
                "divide all pixels, or leave out stacked and binning",
            )

    def _check_pixel(self):
        if self.photodetector is not None:
            height, width = self.photodetector
            # copies made by dataclasses.replace have both
            if self.fill_factor not in (1.0, height * width):
                raise BadData(
                    "sensor.photodetector and sensor.fill_factor: wanted one of them; the former's product "
                    "is the latter"
                )
            object.__setattr__(self, "fill_factor", height * width)
        height, width = self.aperture
        for side, middle in ((height, self.centre[0]), (width, self.centre[1])):
            if side / 2 + abs(middle) * self.pixel_pitch > self.pixel_pitch / 2 * (1 + 1e-9):
                raise OutOfRange(
                    "sensor.centre", self.centre, "a position with the photodetector in its pixel"
                )
        if self.vignetting is not None:
            try:
                map_ = np.asarray(self.vignetting, np.float64)
            except (TypeError, ValueError):
                raise BadData("sensor.vignetting: wanted equally long rows of numbers") from None
            if (
                map_.ndim != 2
                or min(map_.shape) < 2
                or not (map_.min() >= 0 and 0 < map_.max() <= 1)
            ):
                raise BadData(
                    "sensor.vignetting: wanted two or more rows and columns of responses within 0 .. 1, not "
                    "all 0"
                )
            # a tuple can be compared and cannot change
            object.__setattr__(self, "vignetting", tuple(map(tuple, map_.tolist())))

    def _check_readout(self):
        top = 2**16 if self.bits == FLOAT_BITS else self.white_level
        words = f"a whole number, 0 <= black_level < {top} (the white level)"
        check_fields("sensor", self, {"black_level": Limits(words, range(top), "DN")})
        if (self.conversion_gain is None) != (self.adc_range is None) or None not in (
            self.gain,
            self.adc_range,
        ):
            raise BadData(
                "sensor.gain, conversion_gain and adc_range: wanted only gain, or the other two, or none"
            )
        check_known("sensor.binning_mode", self.binning_mode, ("charge", "digital"))
        if self.binning != (1, 1) and self.binning_mode == "digital" and self.bits == FLOAT_BITS:
            raise BadData(
                'sensor.binning_mode = "digital" without a converter: wanted "charge", or bits 1 .. 16'
            )
        well = self.full_well * self.gain_dn_per_electron
        if well < self.black_level:
            raise OutOfRange(
                "sensor.full_well",
                f"{self.full_well:.6g} e- = {well:.6g} DN above black",
                f"at least the black level, {self.black_level} DN: a larger gain or well",
            )
        if not (self.saturation > 0 and self.black_level < self.white_level):
            raise OutOfRange(
                "sensor.analog_offset",
                f"{self.analog_offset:.6g} e-",
                "an offset that keeps a dark pixel below the white level",
            )

    def _check_mosaic(self):
        if not self.channels or any(len(letter) != 1 for letter in self.channels):
            raise BadData(f"sensor.channels = {self.channels}: one letter per curve")
        if len(set(self.channels)) != len(self.channels):
            raise BadData(f"sensor.channels = {self.channels}: a letter occurs twice")
        if self.qe.values.shape[:-1] != (len(self.channels),):
            raise BadData(
                f"sensor.qe: shape {self.qe.values.shape}, wanted ({len(self.channels)}, wavelengths), "
                f"one curve for each of {', '.join(self.channels)}"
            )
        low, high = self.qe.values.min(), self.qe.values.max()
        if not (low >= 0 and high <= 1):
            raise OutOfRange("sensor.qe", f"{low:.6g} .. {high:.6g} e-/photon", "0 <= qe <= 1")
        widths = {len(row) for row in self.cfa}
        if (
            len(widths) != 1
            or not 1 <= max(widths) <= LONGEST_PERIOD
            or len(self.cfa) > LONGEST_PERIOD
        ):
            raise BadData(
                f"sensor.cfa = {self.cfa}: wanted 1 to {LONGEST_PERIOD} rows of equally many letters, "
                f"at most {LONGEST_PERIOD}"
            )
        letters = set("".join(self.cfa))
        if letters != set(self.channels):
            raise BadData(
                f"sensor.cfa = {self.cfa}: its letters must be the channels' letters, "
                f"{', '.join(self.channels)}"
            )

    @property
    def white_level(self) -> int:
        """Highest digital number [DN]; without a converter, the value of a full well."""
        if self.bits == FLOAT_BITS:
            return math.ceil(
                self.black_level + self.gain_dn_per_electron * (self.full_well + self.analog_offset)
            )
        return 2 ** int(self.bits) - 1

    @property
    def gain_dn_per_electron(self) -> float:
        """System gain at the sensor's analog gain [DN/e-]."""
        if self.gain is not None:
            gain = self.gain
        elif self.conversion_gain is not None and self.adc_range is not None:
            gain = (
                self.conversion_gain
                * (2**16 - 1 if self.bits == FLOAT_BITS else self.white_level)
                / self.adc_range
            )
        else:
            gain = (
                1.0
                if self.bits == FLOAT_BITS
                else (self.white_level - self.black_level) / self.full_well
            )
        return gain * self.analog_gain

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on curves that were not measured as they are used, and on an implausible gain."""
        notes = self.filters.notes(self.channels) if self.filters is not None else ()
        full, gain = self.white_level - self.black_level, self.gain_dn_per_electron
        reach = self.full_well * gain / full
        if self.bits == FLOAT_BITS or 1 / IMPLAUSIBLE <= reach <= IMPLAUSIBLE:
            return notes
        unit = "gain_dn_per_e" if self.conversion_gain is None else "conversion_gain_uv_per_e"
        return (
            *notes,
            f"gain {gain:.4g} DN/e- ({unit}): a full well of {self.full_well:g} e- is {reach:.3g} times the "
            f"converter's {full} DN"
            + (
                f"; if {self.gain:.6g} is e-/DN, write gain_e_per_dn = {self.gain:.6g} in place of "
                f"gain_dn_per_e, or the other way round"
                if self.gain is not None
                else ""
            ),
        )

    @property
    def dark_level(self) -> float:
        """Mean digital number without light and dark current [DN]: black level and offset."""
        return self.black_level + self.gain_dn_per_electron * self.analog_offset

    @property
    def saturation(self) -> float:
        """Electrons at which the digital number stops rising [e-]: full well or converter limit."""
        if self.bits == FLOAT_BITS:
            return self.full_well
        at_white = (
            self.white_level - self.black_level
        ) / self.gain_dn_per_electron - self.analog_offset
        # The automatic gain is the quotient of the two: rounding must not decide between them.
        return self.full_well if at_white >= self.full_well * (1 - 1e-12) else at_white

    @property
    def read_sigma(self) -> float:
        """Standard deviation of one read [e-]: reset, readout and converter together."""
        noise = self.noise
        return math.hypot(noise.read, noise.reset, noise.adc / self.gain_dn_per_electron)

    @property
    def cfa_indices(self) -> np.ndarray:
        """One period of the mosaic as indices into `channels`, int32, shape (rows, cols).

        For stacked pixels, each channel once.
        """
        if self.stacked:
            return np.arange(len(self.channels), dtype=np.int32)[None]
        return np.array(
            [[self.channels.index(letter) for letter in row] for row in self.cfa], np.int32
        )

    @property
    def is_monochrome(self) -> bool:
        """True if there is only one channel."""
        return len(self.channels) == 1

    @property
    def bayer_phase(self) -> tuple[int, int] | None:
        """Row and column of the red pixel in a Bayer period (0 or 1 each); None if not Bayer."""
        return bayer_phase(self.cfa)

    @property
    def aperture(self) -> tuple[float, float]:
        """Height and width of the light-sensitive rectangle [m]."""
        height, width = self.photodetector or (math.sqrt(self.fill_factor),) * 2
        return self.pixel_pitch * height, self.pixel_pitch * width

    @property
    def displacement(self) -> tuple[float, float]:
        """Displacement of the aperture centres from a centred grid, (rows, cols) [pixel]."""
        return self.offset[0] + self.centre[0], self.offset[1] + self.centre[1]
