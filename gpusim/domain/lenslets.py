"""The lenslet array before a sensor: the camera becomes a light-field camera."""

from dataclasses import dataclass

from gpusim.domain.errors import (
    BadData,
    Interval,
    Limits,
    OutOfRange,
    check_fields,
    check_known,
    format_value,
    within,
)

LAYOUTS = ("square", "hexagonal")
LEAST_PITCH = 2  # pixels behind a lenslet, along each axis

LIMITS = {
    "pitch": within("0 < pitch <= 0.01 m", "m"),
    "focal_length": within("0 < focal_length <= 0.1 m", "m"),
    "gap": within("0 < gap <= 0.1 m, or the focal length", "m"),
    "rotation": within("-3.15 <= rotation <= 3.15 rad", "rad"),
    "offset": Limits(
        "rows and columns [m], within -0.01 .. 0.01", Interval(-0.01, 0.01), is_pair=True
    ),
    "fill": within("0 < fill <= 1"),
}


@dataclass(frozen=True)
class Lenslets:
    """An array of thin lenslets in the image plane of the main lens, in front of the pixels.

    Each lenslet images the main lens's exit pupil onto the pixels behind it. A lenslet's clear aperture is a square in
    a square layout, a regular hexagon in a hexagonal one, with sides along the cells of the array.

    Attributes:
        pitch: Distance between the centres of neighbours [m].
        focal_length: Focal length of a lenslet [m].
        gap: Distance from the lenslets to the pixels [m]; None: the focal length, which makes pixels sharp images of
            parts of the pupil (an unfocused, or standard, plenoptic camera). With another gap they are images of parts
            of the picture (a focused plenoptic camera).
        layout: "square", or "hexagonal": neighbours in a row a pitch apart, rows sqrt(3) / 2 pitches apart.
        rotation: Direction of the rows of lenslets, from columns of pixels towards rows [rad].
        offset: Centre of the lenslet nearest to the middle of the pixel grid, relative to it, (rows, cols) [m].
        fill: Width of the clear aperture over the pitch [1]. Light outside it is lost.

    Raises:
        OutOfRange: A number is outside its range.
        UnknownName: The layout is not known.
    """

    pitch: float
    focal_length: float
    gap: float | None = None
    layout: str = "square"
    rotation: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    fill: float = 1.0

    def __post_init__(self):
        check_fields("sensor.lenslets", self, LIMITS)
        check_known("sensor.lenslets.layout", self.layout, LAYOUTS)
        object.__setattr__(self, "offset", tuple(map(float, self.offset)))

    @property
    def distance(self) -> float:
        """Distance from the lenslets to the pixels [m]: the gap, or the focal length."""
        return self.focal_length if self.gap is None else self.gap

    @property
    def f_number(self) -> float:
        """Distance to the pixels over the pitch [1]: the f-number that fills the pixels without overlap."""
        return self.distance / self.pitch


def check_lenslets(lenslets, pixel_pitch):
    """Raise BadData or OutOfRange for lenslets that cannot be before pixels of this pitch [m]."""
    if lenslets is None:
        return
    if not isinstance(lenslets, Lenslets):
        raise BadData(f"sensor.lenslets = {format_value(lenslets)}: wanted a gpusim.Lenslets")
    if lenslets.pitch < LEAST_PITCH * pixel_pitch * (1 - 1e-9):
        raise OutOfRange(
            "sensor.lenslets.pitch",
            f"{lenslets.pitch:.6g} m",
            f"at least {LEAST_PITCH} pixels, {LEAST_PITCH * pixel_pitch:.6g} m",
        )
