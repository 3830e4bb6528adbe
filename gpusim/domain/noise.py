"""Noise of a sensor: variation from frame to frame, and from pixel to pixel of one chip."""

import math
from dataclasses import dataclass
from numbers import Integral

from gpusim.domain.errors import (
    BadData,
    Interval,
    Limits,
    OutOfRange,
    check_fields,
    check_known,
    within,
)
from gpusim.domain.short_repr import short_repr

PHOTONS = ("fast", "exact", "none")
ELEMENTARY_CHARGE = 1.602176634e-19  # [C], exact (SI 2019)
BOLTZMANN = 1.380649e-23  # [J K-1], exact
ZERO_CELSIUS = 273.15  # [K]
MOST_DOUBLINGS = 60
SLOWEST_SWITCHING = 1 / 1024  # [1/frame]; a state is traced back through about 1024 frames
# 1e12: more electrons than any pixel holds; its square is far from float32's limit
AMOUNTS = {
    "dark_current": "e-/s",
    "hot_current": "e-/s",
    "read": "e-",
    "reset": "e-",
    "adc": "DN",
    "row": "e-",
    "column": "e-",
    "dsnu": "e-",
    "row_dsnu": "e-",
    "column_dsnu": "e-",
    "telegraph": "e-",
}
LIMITS = {
    **{key: within(f"0 <= {key} <= 1e12", unit) for key, unit in AMOUNTS.items()},
    "prnu": within("0 <= prnu < 1"),
    "row_prnu": within("0 <= row_prnu < 1"),
    "column_prnu": within("0 <= column_prnu < 1"),
    "hot_pixels": within("0 <= hot_pixels <= 1, a part of all pixels"),
    "dead_pixels": within("0 <= dead_pixels <= 1, a part of all pixels"),
    "telegraph_pixels": within("0 <= telegraph_pixels <= 1, a part of all pixels"),
    "temperature": within("-273.15 < temperature <= 1000", "deg C"),
    "reference_temperature": within("-273.15 < reference_temperature <= 1000", "deg C"),
    "doubling": within(
        "0.1 <= doubling <= 1000, with at most 60 doublings or halvings of the dark current", "K"
    ),
    "telegraph_switching": Limits(
        "1/1024 <= telegraph_switching <= 1", Interval(SLOWEST_SWITCHING, 1), "per frame"
    ),
    "seed": Limits(
        "a whole number, 0 <= seed < 2**64", Interval(0, 2**64, has_highest=False), kind=Integral
    ),
}


@dataclass(frozen=True)
class Noise:
    """Temporal noise and fixed patterns. Terms that are 0 are not computed.

    Temporal noise differs in every frame; the patterns are the same in every frame and depend on
    `seed`. For pixels that are binned as charge, or stacked, see `Sensor`.

    Args:
        photon: Statistics of electrons: "fast" (Poisson within 1e-4 in total variation), "exact"
            (within 1e-6), or "none" (the mean itself).
        dark_current: Dark current at the reference temperature [e- s-1]; its electrons have the
            statistics of `photon`. It doubles with every `doubling` [K] above the reference
            temperature.
        temperature: Temperature of the sensor [deg C].
        reference_temperature: Temperature that dark_current and hot_current refer to [deg C].
        doubling: Temperature difference that doubles the dark current [K].
        read: Read noise before the analog gain [e- rms].
        reset: kTC noise of the pixel reset [e- rms], the same for all reads of an exposure.
        adc: Noise of the converter, after the analog gain [DN rms].
        row, column: Temporal noise common to a row or a column [e- rms].
        prnu, row_prnu, column_prnu: Photo-response non-uniformity of pixels, rows and columns:
            relative standard deviation [1].
        dsnu, row_dsnu, column_dsnu: Offset non-uniformity (DSNU) of pixels, rows and columns:
            standard deviation [e- rms].
        hot_pixels: Fraction of pixels with additional dark current [1].
        hot_current: Mean of that dark current at the reference temperature [e- s-1]; it is
            exponentially distributed.
        dead_pixels: Fraction of pixels without response [1].
        telegraph_pixels: Fraction of pixels with a trap [1]. Their signal jumps between two values,
            half the time each.
        telegraph: Mean distance between the two values [e-]; it is exponentially distributed.
        telegraph_switching: Probability that the state of a trap is drawn again from one frame to
            the next [1]; 1: frames are independent.
        seed: Seed of the fixed patterns.

    Raises:
        BadData: hot_pixels or telegraph_pixels without their size.
        OutOfRange: A number is outside its range.
        UnknownName: `photon` is not known.
    """

    photon: str = "fast"
    dark_current: float = 0.0
    temperature: float = 25.0
    reference_temperature: float = 25.0
    doubling: float = 8.0
    read: float = 0.0
    reset: float = 0.0
    adc: float = 0.0
    row: float = 0.0
    column: float = 0.0
    prnu: float = 0.0
    row_prnu: float = 0.0
    column_prnu: float = 0.0
    dsnu: float = 0.0
    row_dsnu: float = 0.0
    column_dsnu: float = 0.0
    hot_pixels: float = 0.0
    hot_current: float = 0.0
    dead_pixels: float = 0.0
    telegraph_pixels: float = 0.0
    telegraph: float = 0.0
    telegraph_switching: float = 1.0
    seed: int = 0

    __repr__ = short_repr

    def __post_init__(self):
        check_known("noise.photon", self.photon, PHOTONS)
        check_fields("noise", self, LIMITS)
        try:
            warmer = abs(self.temperature - self.reference_temperature)
            is_allowed = warmer <= MOST_DOUBLINGS * self.doubling
        except TypeError:  # numbers of kinds that do not mix, such as Decimal and float
            is_allowed = False
        if not is_allowed:
            shown = f"{float(self.doubling):.6g} K"
            raise OutOfRange("noise.doubling", shown, LIMITS["doubling"].words)
        for part, size in (("hot_pixels", "hot_current"), ("telegraph_pixels", "telegraph")):
            if getattr(self, part) and not getattr(self, size):
                raise BadData(
                    f"noise.{part} = {getattr(self, part):.6g} without noise.{size}: wanted both"
                )

    @property
    def warmth(self) -> float:
        """Dark current relative to its value at the reference temperature [1]."""
        return 2.0 ** ((self.temperature - self.reference_temperature) / self.doubling)

    @property
    def operating_dark_current(self) -> float:
        """Dark current at the temperature of the sensor [e- s-1]."""
        return self.dark_current * self.warmth


def reset_noise(conversion_gain: float, temperature: float = 25.0) -> float:
    """Return the standard deviation of the charge that a reset leaves on a pixel, sqrt(k T C) / q.

    Args:
        conversion_gain: Conversion gain [V/e-]; the capacitance is q / conversion_gain.
        temperature: Temperature [deg C].

    Returns:
        Standard deviation [e-].

    Raises:
        OutOfRange: The conversion gain is outside its range.

    Source:
        Johnson-Nyquist noise of a capacitor; Janesick, "Photon Transfer" (2007), section 11.2.
    """
    if not 1e-12 <= conversion_gain <= 1:
        raise OutOfRange(
            "conversion gain", f"{conversion_gain:.6g} V/e-", "1e-12 <= conversion_gain <= 1"
        )
    return math.sqrt(
        BOLTZMANN * (temperature + ZERO_CELSIUS) / (ELEMENTARY_CHARGE * conversion_gain)
    )
