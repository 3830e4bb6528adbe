"""The generalised sensor: filters, photodetector, pixel, noise and conversion to digital numbers."""

import math
from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import Spectrum

HUGE = 1e12  # more than any electrons, seconds or gain; squares of it are far from float32's limit
LONGEST_PERIOD = 8  # rows and columns of the mosaic that the kernels' tables hold


@dataclass(frozen=True, eq=False)
class Microlens:
    """How a pixel answers light that comes slantwise.

    angles: of the chief ray [rad], rising from 0, shape (n,). response: over that of a pixel on the axis [1], 1 at
    angle 0, shape (n,). shift: how far the microlenses are moved toward the axis, 0 not at all, 1 so that every pixel
    takes its chief ray as one on the axis does. Raises BadData, OutOfRange.
    """

    angles: np.ndarray
    response: np.ndarray
    shift: float = 0.0

    def __post_init__(self):
        angles, response = np.asarray(self.angles, np.float64), np.asarray(self.response, np.float64)
        if angles.ndim != 1 or angles.shape != response.shape or len(angles) < 2 or angles[0] != 0 \
                or not (np.diff(angles) > 0).all():
            raise BadData("sensor.microlens: wanted two or more angles rising from 0 and as many responses")
        if not (np.isfinite(response).all() and response.min() >= 0 and response[0] > 0):
            raise BadData("sensor.microlens: a response is negative or not finite, or that on the axis is 0")
        if not 0 <= self.shift <= 2:
            raise OutOfRange("sensor.microlens.shift", self.shift, "0 <= shift <= 2")
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "response", response / response[0])


@dataclass(frozen=True)
class Sensor:
    """An image sensor with square pixels and one repeating colour mosaic.

    pixel_pitch: [m].
    qe: shape (C, L), C = len(channels): electrons per photon [e-/photon] that falls inside the pixel's aperture, as the
        product of colour filter, photodetector and infrared cut; 0 outside its table. A data sheet's quantum efficiency
        counts all photons on the pixel: it goes with fill_factor = 1.
    full_well: electrons at which a pixel saturates [e-].
    bits: of the converter; digital numbers go from 0 to 2**bits - 1.
    channels: one letter per curve, such as ("R", "G", "B") or ("Y",).
    cfa: the mosaic's period as rows of these letters, such as ("RG", "GB") or, monochrome, ("Y",); at most 8 x 8.
    fill_factor: aperture area over pixel area [1]; the aperture is a centred square.
    microlens: what pixels lose toward the corner, None: nothing.
    exposure_time: [s], or None: chosen by automatic exposure.
    black_level: digital number of a dark pixel [DN].
    gain: [DN/e-], or None: such that a full well just reaches the white level.
    read_noise: [e- rms]; dark_current: [e- s-1]; prnu: relative gain variation [rms]; dsnu: offset variation [e- rms].
    photon_noise: whether electrons are counted one by one (Poisson).
    fixed_pattern_seed: names the one chip whose prnu and dsnu patterns are used.
    Raises BadData, OutOfRange.
    """

    pixel_pitch: float
    qe: Spectrum
    full_well: float
    bits: int
    channels: tuple[str, ...] = ("R", "G", "B")
    cfa: tuple[str, ...] = ("RG", "GB")
    fill_factor: float = 1.0
    microlens: Microlens | None = None
    exposure_time: float | None = None
    black_level: int = 0
    gain: float | None = None
    read_noise: float = 0.0
    dark_current: float = 0.0
    prnu: float = 0.0
    dsnu: float = 0.0
    photon_noise: bool = True
    fixed_pattern_seed: int = 0

    def __post_init__(self):
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "cfa", tuple(self.cfa))
        self._check_numbers()
        self._check_mosaic()

    def _check_numbers(self):
        def check(key, allowed, good, unit=""):
            value = getattr(self, key)
            if value is not None and not good(value):
                shown = f"{value:.6g}" if isinstance(value, float) else value
                raise OutOfRange(f"sensor.{key}", f"{shown} {unit}".rstrip(), allowed)

        def positive(value):
            return 0 < value <= HUGE

        def non_negative(value):
            return 0 <= value <= HUGE

        check("pixel_pitch", "0 < pixel_pitch <= 0.001 m", lambda value: 0 < value <= 1e-3, "m")
        check("fill_factor", "0 < fill_factor <= 1", lambda value: 0 < value <= 1)
        check("exposure_time", "0 < exposure_time <= 1e12, or automatic", positive, "s")
        check("full_well", "0 < full_well <= 1e12", positive, "e-")
        check("bits", "a whole number, 1 <= bits <= 16", lambda value: value in range(1, 17))
        check("black_level", f"a whole number, 0 <= black_level < {self.white_level} (the white level)",
              lambda value: value in range(self.white_level), "DN")
        check("gain", "0 < gain <= 1e12, or automatic", positive, "DN/e-")
        check("read_noise", "0 <= read_noise <= 1e12", non_negative, "e-")
        check("dark_current", "0 <= dark_current <= 1e12", non_negative, "e-/s")
        check("prnu", "0 <= prnu < 1", lambda value: 0 <= value < 1)
        check("dsnu", "0 <= dsnu <= 1e12", non_negative, "e-")
        check("fixed_pattern_seed", "a whole number, 0 <= fixed_pattern_seed < 2**64",
              lambda value: value in range(2**64))

    def _check_mosaic(self):
        if not self.channels or any(len(letter) != 1 for letter in self.channels):
            raise BadData(f"sensor.channels = {self.channels}: one letter per curve")
        if len(set(self.channels)) != len(self.channels):
            raise BadData(f"sensor.channels = {self.channels}: a letter occurs twice")
        if self.qe.values.shape[:-1] != (len(self.channels),):
            raise BadData(f"sensor.qe: shape {self.qe.values.shape}, wanted ({len(self.channels)}, wavelengths), "
                          f"one curve for each of {', '.join(self.channels)}")
        low, high = self.qe.values.min(), self.qe.values.max()
        if not (low >= 0 and high <= 1):
            raise OutOfRange("sensor.qe", f"{low:.6g} .. {high:.6g} e-/photon", "0 <= qe <= 1")
        widths = {len(row) for row in self.cfa}
        if len(widths) != 1 or not 1 <= max(widths) <= LONGEST_PERIOD or len(self.cfa) > LONGEST_PERIOD:
            raise BadData(f"sensor.cfa = {self.cfa}: wanted 1 to {LONGEST_PERIOD} rows of equally many letters, "
                          f"at most {LONGEST_PERIOD}")
        letters = set("".join(self.cfa))
        if letters != set(self.channels):
            raise BadData(f"sensor.cfa = {self.cfa}: its letters must be those of the curves, "
                          f"{', '.join(self.channels)}")

    @property
    def white_level(self) -> int:
        """Highest digital number [DN]."""
        return 2 ** int(self.bits) - 1

    @property
    def gain_dn_per_electron(self) -> float:
        """Conversion gain [DN/e-]: `gain`, or the one that maps the full well to the white level."""
        return self.gain if self.gain is not None else (self.white_level - self.black_level) / self.full_well

    @property
    def saturation(self) -> float:
        """Electrons at which the digital number stops rising [e-]: the full well or the converter, whichever first."""
        if self.gain is None:
            return self.full_well
        return min(self.full_well, (self.white_level - self.black_level) / self.gain)

    @property
    def cfa_indices(self) -> np.ndarray:
        """One period of the mosaic as indices into `channels`, int32 (rows, cols)."""
        return np.array([[self.channels.index(letter) for letter in row] for row in self.cfa], np.int32)

    @property
    def is_monochrome(self) -> bool:
        """Whether there is only one channel."""
        return len(self.channels) == 1

    @property
    def bayer_phase(self) -> tuple[int, int] | None:
        """Row and column of the red pixel in a Bayer period (0 or 1 each); None for any other mosaic."""
        if len(self.cfa) != 2 or sorted("".join(self.cfa)) != ["B", "G", "G", "R"]:
            return None
        row, col = divmod("".join(self.cfa).index("R"), 2)
        return (row, col) if self.cfa[1 - row][1 - col] == "B" else None

    @property
    def aperture(self) -> float:
        """Side of the light-sensitive square [m]."""
        return self.pixel_pitch * math.sqrt(self.fill_factor)
