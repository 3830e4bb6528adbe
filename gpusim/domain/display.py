"""The display that a picture is made for, and the light of stored codes under a tone curve."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from gpusim.domain.errors import (
    BadData,
    Interval,
    Limits,
    OutOfRange,
    check_fields,
    is_known,
    within,
)
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum
from gpusim.domain.tone import NO_TONE, TONES

EXPONENT = {"curve": Limits('"srgb" or the exponent of a power law, 1 .. 4', Interval(1, 4))}
LUMINANCE = {"luminance": within("0 < luminance <= 1e6", "cd m-2")}


@dataclass(frozen=True)
class Display:
    """An additive display with three primaries; by default sRGB (IEC 61966-2-1).

    Args:
        name: Name in messages and files.
        primaries: CIE 1931 (x, y) of red, green and blue.
        white: (x, y) of full red + green + blue.
        curve: Transfer curve from code to light, "srgb" or the exponent of a power law ("gamma", 1
            .. 4).
        luminance: Luminance of white [cd m-2].
        spectra: Radiance of the three primaries at full drive [W m-2 sr-1 nm-1], 3 rows, or None if
            they are not known.

    Raises:
        BadData: Primaries, white or spectra have the wrong shape, or do not span a colour space.
        OutOfRange: A number is outside its range.
    """

    name: str = "srgb"
    primaries: tuple = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
    white: tuple = (0.3127, 0.3290)
    curve: str | float = "srgb"
    luminance: float = 80.0
    spectra: Spectrum | None = None

    __repr__ = short_repr

    def __post_init__(self):
        try:
            shapes = (
                np.asarray(self.primaries, np.float64).shape,
                np.asarray(self.white, np.float64).shape,
            )
        except (TypeError, ValueError):
            shapes = None
        if shapes != ((3, 2), (2,)):
            raise BadData("display: wanted (x, y) of three primaries and of the white, numbers")
        for key, (x, y) in (
            *(("primaries", pair) for pair in self.primaries),
            ("white", self.white),
        ):
            if not (0 <= x <= 1 and 0 < y <= 1 and x + y <= 1):
                raise OutOfRange(f"display.{key}", f"({x}, {y})", "x >= 0, y > 0, x + y <= 1")
        if abs(np.linalg.det(xyz_of(self.primaries))) < 1e-6:
            raise BadData(f"display.primaries = {self.primaries}: they lie on one line")
        if (np.linalg.solve(xyz_of(self.primaries), xyz_of([self.white])[:, 0]) <= 0).any():
            raise BadData(
                f"display.white = {self.white}: no mixture of the primaries {self.primaries}"
            )
        if not is_known(self.curve, ("srgb",)):
            check_fields("display", self, EXPONENT)
        check_fields("display", self, LUMINANCE)
        if self.spectra is not None and not isinstance(self.spectra, Spectrum):
            raise BadData(f"display.spectra = {self.spectra!r}: wanted a Spectrum of three rows")
        if self.spectra is not None and self.spectra.values.shape[:-1] != (3,):
            raise BadData(
                f"display.spectra: shape {self.spectra.values.shape}, wanted 3 rows: red, green, blue"
            )

    def encodes_like(self, other: "Display") -> bool:
        """Compare primaries, white and curve with another display.

        Args:
            other: The other display.

        Returns:
            True if codes mean the same colours on both; their luminances may differ.
        """
        return (self.primaries, self.white, self.curve) == (
            other.primaries,
            other.white,
            other.curve,
        )

    @property
    def xyz_from_rgb(self) -> np.ndarray:
        """Matrix from linear RGB to CIE XYZ, (3, 3), with Y = 1 for white.

        Each column is the XYZ of a primary, scaled until the three add up to white (SMPTE RP 177).
        """
        primaries = xyz_of(self.primaries)
        return primaries * np.linalg.solve(primaries, xyz_of([self.white])[:, 0])

    def decode(self, values: ArrayLike) -> np.ndarray:
        """Return linear light, white = 1, from codes.

        Args:
            values: Codes as fractions of the largest, 0 .. 1. The curve is odd: negative values
                give negative light.

        Returns:
            Linear light, shape of `values`.
        """
        size = np.abs(values)
        if self.curve == "srgb":
            light = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
        else:
            light = size ** float(self.curve)
        return np.copysign(light, values)

    def table(self, kind: DTypeLike | None) -> np.ndarray:
        """Return the linear light of every code.

        Args:
            kind: Type of the codes, uint8 or uint16.

        Returns:
            Linear light, float32, shape (256,) or (65536,).
        """
        return _table(self.curve, 65535 if np.dtype(kind).type is np.uint16 else 255)

    def encode(self, light: ArrayLike) -> np.ndarray:
        """Return codes from linear light: the inverse of `decode`.

        Args:
            light: Linear light, white = 1.

        Returns:
            Codes as fractions of the largest, shape of `light`.
        """
        size = np.abs(light)
        if self.curve == "srgb":
            values = np.where(
                size <= 0.04045 / 12.92, 12.92 * size, 1.055 * size ** (1 / 2.4) - 0.055
            )
        else:
            values = size ** (1 / float(self.curve))
        return np.copysign(values, light)

    def xyz(self, codes: ArrayLike) -> np.ndarray:
        """Return the colours that the screen shows for 8-bit codes.

        Args:
            codes: Codes 0 .. 255, shape (..., 3).

        Returns:
            CIE XYZ [cd m-2], shape (..., 3).
        """
        return (
            self.luminance * self.decode(np.asarray(codes, np.float64) / 255) @ self.xyz_from_rgb.T
        )

    @property
    def rgb_from_xyz(self) -> np.ndarray:
        """Matrix from CIE XYZ to linear RGB, (3, 3)."""
        return np.linalg.inv(self.xyz_from_rgb)


@functools.lru_cache(maxsize=16)
def _table(curve, most):
    table = Display(curve=curve).decode(np.arange(most + 1) / most).astype(np.float32)
    table.flags.writeable = False  # all share it
    return table


def xyz_of(chromaticities) -> np.ndarray:
    """Return XYZ with Y = 1 of each (x, y), as columns."""
    x, y = np.array(chromaticities, np.float64).T
    return np.stack([x / y, np.ones_like(x), (1 - x - y) / y])


P3_PRIMARIES = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))  # SMPTE EG 432-1

DISPLAYS = {"srgb": Display(), "display-p3": Display("display-p3", P3_PRIMARIES)}


STEPS = 60  # bisection steps: enough for float64


def decoding(display: Display, tone: tuple | str = ()):
    """Return the function from codes to the linear light before the tone curve.

    Args:
        display: The display.
        tone: Tone curve, see `gpusim.domain.processor.Processor`.

    Returns:
        Function of codes as fractions of the largest.

    Raises:
        BadData: The cubic between the nodes of the tone curve overflows.
    """
    if not tone or tone == NO_TONE:
        return display.decode
    if isinstance(tone, str):
        return lambda codes: TONES[tone].undo(display.decode(np.asarray(codes, np.float64)))
    # monotone: Fritsch & Carlson 1980, SIAM J. Numer. Anal. 17, 238
    from scipy.interpolate import PchipInterpolator

    scene = DISPLAYS["srgb"]
    x, y = np.array(tone).T
    with np.errstate(all="ignore"):
        shown = PchipInterpolator(x, y) if np.isfinite(np.diff(y) / np.diff(x)).all() else None
        if shown is None or not (np.isfinite(shown.c).all() and np.isfinite(scene.decode(x[-1]))):
            raise BadData(
                f"processor.tone: the cubic between its nodes, x = {x[0]:.6g} .. {x[-1]:.6g} as near as "
                f"{np.diff(x).min():.6g}, overflows; wanted nodes farther apart, and x <= 1000"
            )

    def light(codes):
        wanted = scene.encode(display.decode(np.asarray(codes, np.float64)))
        place = np.clip(
            np.searchsorted(y, wanted) - 1, 0, len(x) - 2
        )  # of the cubic with the value
        low, high, start = x[place], x[place + 1], x[place]
        third, second, first, constant = shown.c[:, place]
        for _ in range(STEPS):
            middle = (low + high) / 2
            along = middle - start
            above = ((third * along + second) * along + first) * along + constant >= wanted
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return scene.decode(high)

    return light
