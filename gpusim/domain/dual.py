"""Dual and quad pixels: photodiodes under one microlens, which divide a pixel's light by its angle.

The light of the left half of the exit pupil is called left, as in the view from there, whichever side of the silicon
it falls on. A ray through the pupil point x (see `gpusim.domain.pupil`) has the slope x / (2 N) at the working f-number
N, against the chief ray.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from gpusim.domain.errors import (
    BadData,
    Conflict,
    Limits,
    OutOfRange,
    check_fields,
    check_known,
    within,
)
from gpusim.domain.optics import Optics
from gpusim.domain.spectrum import Spectrum, tabulate

# the diodes of a split: -1 the first half along rows or columns, 1 the second, 0 both, (rows, cols)
SIDES = {
    "left": (0, -1),
    "right": (0, 1),
    "top": (-1, 0),
    "bottom": (1, 0),
    "top-left": (-1, -1),
    "top-right": (-1, 1),
    "bottom-left": (1, -1),
    "bottom-right": (1, 1),
}
SPLITS = {
    "left-right": ("left", "right"),
    "up-down": ("top", "bottom"),
    "quad": ("top-left", "top-right", "bottom-left", "bottom-right"),
}
SPARSE = ("", "masked", "shared")
LONGEST_CELL = 64  # pixels
LIMITS = {
    "transition": within("0 <= transition <= 1"),
    "reference_f_number": within("0.1 <= reference_f_number <= 1000"),
    "misalignment": within("-1 <= misalignment <= 1 rad", "rad"),
    "cell": Limits(
        f"rows and columns, whole numbers 1 .. {LONGEST_CELL}",
        range(1, LONGEST_CELL + 1),
        is_pair=True,
    ),
}


@dataclass(frozen=True)
class DualPixels:
    """Photodiodes under one microlens, or phase-detection pixels at some places.

    The part of the light at slope t that goes to the second of two diodes is 1/2 + (1/2 - crosstalk) erf((t - t0) /
    (sqrt(2) w)), and the rest to the first. w is `transition` over the reference f-number.

    Args:
        split: "left-right", "up-down", or "quad" for both.
        transition: Width of the border between diodes, as the standard deviation of a Gaussian, over the pupil's
            diameter at `reference_f_number` [1]. Diffraction at the pixel comes on top.
        reference_f_number: F-number at which `transition` is a part of the pupil [1].
        crosstalk: Share of a diode's light that another one collects, 0 .. 0.5, a number or a function of wavelength.
        misalignment: Slope t0 of the border in the frame's corner [rad]. It is proportional to the distance from the
            axis, and points away from it.
        follows_chief_ray: Whether microlenses are displaced so that every pixel divides the light about its chief
            ray. If not, the slope of the chief ray of a thin lens is added to `misalignment`.
        sparse: "" for all pixels, or phase-detection pixels at `places` of each cell: "masked" pixels, half of which
            is covered, or "shared" ones: two neighbours under one microlens, each with one diode.
        cell: Rows and columns of pixels after which the places repeat.
        places: Row and column in the cell, and the half of the pupil that is seen there. The second pixel of a shared
            microlens is the next one along the split.

    Raises:
        BadData: A value has the wrong type, or places do not fit.
        Conflict: Settings exclude each other.
        OutOfRange: A number is outside its range.
        UnknownName: There is no such split.
    """

    split: str = "left-right"
    transition: float = 0.05
    reference_f_number: float = 2.0
    crosstalk: Spectrum | float = 0.0
    misalignment: float = 0.0
    follows_chief_ray: bool = True
    sparse: str = ""
    cell: tuple[int, int] = (1, 1)
    places: tuple[tuple[int, int, str], ...] = ()

    def __post_init__(self):
        check_known("sensor.dual.split", self.split, SPLITS)
        check_known("sensor.dual.sparse", self.sparse, SPARSE)
        check_fields("sensor.dual", self, LIMITS)
        if not isinstance(self.follows_chief_ray, bool):
            raise BadData("sensor.dual.follows_chief_ray: wanted true or false")
        values = self.crosstalk.values if isinstance(self.crosstalk, Spectrum) else self.crosstalk
        if np.ndim(values) > 1:
            raise BadData(
                f"sensor.dual.crosstalk: wanted one function of wavelength, got {len(values)}"
            )
        low, high = np.min(values), np.max(values)
        if not (low >= 0 and high <= 0.5):
            raise OutOfRange(
                "sensor.dual.crosstalk", f"{low:.6g} .. {high:.6g}", "0 <= crosstalk <= 0.5"
            )
        if self.sparse:
            self._check_places()
        elif self.places or self.cell != (1, 1):
            raise Conflict(
                "sensor.dual.places and cell", "all pixels are divided", 'add sparse = "masked"'
            )

    def _check_places(self):
        if self.split == "quad":
            raise Conflict(
                'sensor.dual.split = "quad"',
                "a sparse phase-detection pixel sees one half of the pupil",
                'set split = "left-right" or "up-down"',
            )
        taken = set()
        for place in self.places:
            if not (
                isinstance(place, tuple)
                and len(place) == 3
                and all(
                    type(at) is int and 0 <= at < n for at, n in zip(place, self.cell, strict=False)
                )
                and place[2] in self.diodes
            ):
                raise BadData(
                    f"sensor.dual.places: {place!r}, wanted row, column and half, such as [0, 1, "
                    f'"{self.diodes[0]}"], within the cell of {self.cell[0]} x {self.cell[1]} pixels'
                )
            taken |= {(place[0] % self.cell[0], place[1] % self.cell[1])}
        if not self.places or len(taken) < len(self.places):
            raise BadData(
                f"sensor.dual.places: {len(self.places)} places, {len(taken)} of them different; wanted one or more, "
                "each once"
            )
        if self.sparse == "shared":
            self._check_pairs()

    def _check_pairs(self):
        first, second = self.diodes
        down, across = SIDES[second]
        lefts = {(row, col) for row, col, side in self.places if side == first}
        rights = {(row, col) for row, col, side in self.places if side == second}
        if {(row + abs(down), col + abs(across)) for row, col in lefts} != rights:
            raise BadData(
                f'sensor.dual.places: a shared microlens has a "{first}" pixel and, next to it along the split, a '
                f'"{second}" one in the same cell; wanted pairs'
            )

    @property
    def diodes(self) -> tuple[str, ...]:
        """Names of the diodes under a microlens."""
        return SPLITS[self.split]


@dataclass(frozen=True)
class Diode:
    """One photodiode in front of a lens.

    Attributes:
        dual: The photodiodes.
        side: Which of them, a key of SIDES.
        window: Height and width of the light-sensitive area under one microlens [m].
        corner: Distance of the frame's corner from the axis [m].
    """

    dual: DualPixels
    side: str
    window: tuple[float, float]
    corner: float

    @property
    def signs(self) -> tuple[int, int]:
        """Halves that the diode sees along rows and columns: see SIDES."""
        return SIDES[self.side]

    def contrast(self, wavelengths: Any) -> np.ndarray:
        """Return 1 - 2 crosstalk at wavelengths [nm], shape (L,)."""
        return 1 - 2 * tabulate(self.dual.crosstalk, np.asarray(wavelengths, np.float64))


@dataclass(frozen=True)
class DiodeOptics(Optics):
    """A lens as the photodiodes of one side see it: point spreads are of their light, made 1 in all.

    Attributes:
        diode: The photodiode.
    """

    diode: Diode | None = None

    @classmethod
    def of(cls, optics: Optics, diode: Diode) -> "DiodeOptics":
        """Return a lens as a photodiode sees it."""
        return cls(**{one.name: getattr(optics, one.name) for one in fields(Optics)}, diode=diode)

    @property
    def split_height(self) -> float:
        """Displacement of the border between diodes in the pupil at the frame's corner [radii]."""
        assert self.diode is not None
        dual, slope = self.diode.dual, 0.0
        if not dual.follows_chief_ray:
            slope = self.diode.corner / self.image_distance
        return 2 * self.working_f_number * (dual.misalignment + slope)

    @property
    def split_width(self) -> float:
        """Standard deviation of the border between diodes in the pupil [radii]."""
        assert self.diode is not None
        dual = self.diode.dual
        return 2 * dual.transition * self.working_f_number / dual.reference_f_number

    @property
    def varies(self) -> bool:
        """Whether the blur varies over the field."""
        return super().varies or (self.model != "none" and self.split_height != 0)

    @property
    def description(self) -> str:
        """The pupil and its effects, in words."""
        assert self.diode is not None
        return f"{super().description}, light of the {self.diode.side} photodiodes"

    def on_axis(self) -> "DiodeOptics":
        """Return a lens whose blur everywhere is this one's blur on the axis."""
        assert self.diode is not None
        dual = replace(self.diode.dual, misalignment=0.0, follows_chief_ray=True)
        return DiodeOptics.of(super().on_axis(), replace(self.diode, dual=dual))


def count_diodes(dual: DualPixels | None) -> int:
    """Return the number of photodiodes under a microlens."""
    return 1 if dual is None or dual.sparse else len(dual.diodes)
