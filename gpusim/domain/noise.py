"""What makes the electrons of a sensor vary: from frame to frame, and from pixel to pixel of one chip."""

import math
from dataclasses import dataclass
from numbers import Integral

from gpusim.domain.errors import BadData, OutOfRange, UnknownName, check_range, is_known
from gpusim.domain.short_repr import brief

PHOTONS = ("fast", "exact", "none")
ELEMENTARY_CHARGE = 1.602176634e-19  # [C], exact (SI 2019)
BOLTZMANN = 1.380649e-23  # [J K-1], exact
ZERO_CELSIUS = 273.15  # [K]
MOST_DOUBLINGS = 60
MOST = 1e12  # more than any electrons; squares of it are far from float32's limit
SLOWEST_SWITCHING = 1 / 1024  # [1/frame]; a state is traced back through about the inverse of it


@dataclass(frozen=True)
class Noise:
    """Temporal noise and fixed patterns; what is 0 is not computed.

    Anew in every frame:
    photon: how electrons are counted: "fast" (Poisson within 1e-4 in total variation), "exact" (within 1e-6),
        "none" (the mean itself).
    dark_current: at the reference temperature [e- s-1]; its electrons are counted like the others. It doubles with
        every `doubling` [K] by which temperature [deg C] is above reference_temperature [deg C].
    read: of the readout, before the analog gain [e- rms]. reset: of the pixel's reset, kTC [e- rms], shared by all
        reads of an exposure. adc: of the converter, behind the analog gain [DN rms].
    row, column: common to a row or a column of one frame [e- rms].
    telegraph_pixels: part of the pixels with a trap [1] whose signal jumps between two values, a distance apart that
        is exponentially distributed with the mean `telegraph` [e-]; half the time each. telegraph_switching: chance
        that a trap is drawn anew from one frame to the next [1], 1: frames are independent.

    The same in every frame, as named by `seed`:
    prnu, row_prnu, column_prnu: relative standard deviation of the response of pixels, rows, columns [1].
    dsnu, row_dsnu, column_dsnu: standard deviation of the offset [e- rms].
    hot_pixels: part of the pixels [1] with a dark current more, exponentially distributed with the mean
        `hot_current` at the reference temperature [e- s-1]. dead_pixels: part of the pixels without response [1].
    Of pixels that are binned as charge, or stacked, see `Sensor`. Raises BadData, OutOfRange, UnknownName.
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

    __repr__ = brief

    def __post_init__(self):
        def check(key, allowed, good, unit=""):
            check_range("noise", self, key, allowed, good, unit)

        if not is_known(self.photon, PHOTONS):
            raise UnknownName("noise.photon", str(self.photon), PHOTONS)
        for key in ("dark_current", "hot_current"):
            check(key, f"0 <= {key} <= 1e12", lambda value: 0 <= value <= MOST, "e-/s")
        for key in (
            "read",
            "reset",
            "adc",
            "row",
            "column",
            "dsnu",
            "row_dsnu",
            "column_dsnu",
            "telegraph",
        ):
            check(
                key,
                f"0 <= {key} <= 1e12",
                lambda value: 0 <= value <= MOST,
                "DN" if key == "adc" else "e-",
            )
        for key in ("prnu", "row_prnu", "column_prnu"):
            check(key, f"0 <= {key} < 1", lambda value: 0 <= value < 1)
        for key in ("hot_pixels", "dead_pixels", "telegraph_pixels"):
            check(key, f"0 <= {key} <= 1, a part of all pixels", lambda value: 0 <= value <= 1)
        for key in ("temperature", "reference_temperature"):
            check(
                key,
                f"-273.15 < {key} <= 1000",
                lambda value: -ZERO_CELSIUS < value <= 1000,
                "deg C",
            )
        check(
            "doubling",
            "0.1 <= doubling <= 1000, and so that the dark current doubles or halves at most 60 times",
            lambda value: (
                0.1 <= value <= 1000
                and abs(self.temperature - self.reference_temperature) <= MOST_DOUBLINGS * value
            ),
            "K",
        )
        check(
            "telegraph_switching",
            "1/1024 <= telegraph_switching <= 1",
            lambda value: SLOWEST_SWITCHING <= value <= 1,
            "per frame",
        )
        check(
            "seed",
            "a whole number, 0 <= seed < 2**64",
            lambda value: isinstance(value, Integral) and 0 <= value < 2**64,
        )
        for part, size in (("hot_pixels", "hot_current"), ("telegraph_pixels", "telegraph")):
            if getattr(self, part) and not getattr(self, size):
                raise BadData(
                    f"noise.{part} = {getattr(self, part):.6g} without noise.{size}: wanted both"
                )

    @property
    def warmth(self) -> float:
        """How many times its value at the reference temperature the dark current is [1]."""
        return 2.0 ** ((self.temperature - self.reference_temperature) / self.doubling)


def reset_noise(conversion_gain: float, temperature: float = 25.0) -> float:
    """Standard deviation of the charge that a reset leaves on a pixel [e-], sqrt(k T C) / q.

    conversion_gain: [V/e-], by which the capacitance is q / conversion_gain. temperature: [deg C].
    Raises OutOfRange. Source: Johnson-Nyquist noise of a capacitor; Janesick, "Photon Transfer" (2007), section 11.2.
    """
    if not 1e-12 <= conversion_gain <= 1:
        raise OutOfRange(
            "conversion gain", f"{conversion_gain:.6g} V/e-", "1e-12 <= conversion_gain <= 1"
        )
    return math.sqrt(
        BOLTZMANN * (temperature + ZERO_CELSIUS) / (ELEMENTARY_CHARGE * conversion_gain)
    )
