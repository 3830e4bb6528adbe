"""Where a camera looks: which place of a scene its frame shows."""

from dataclasses import dataclass
from math import cos, isfinite, pi, sin
from typing import Any

from gpusim.domain.errors import BadData, OutOfRange

FARTHEST = 1e5  # [pixel]
MOST_ZOOM = 100.0


@dataclass(frozen=True)
class View:
    """The place p of the frame, from its middle [pixel], shows that of the scene at shift + R(rotation) p / zoom.

    shift: rows and columns [pixel]: what is in the middle of the frame. rotation: of the camera about its axis, in the
    frame's plane from the columns to the rows [rad]. zoom: magnification, from 1 on: a smaller one would show the scene
    finer than its samples are told to be.
    Raises BadData, OutOfRange.
    """

    shift: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    zoom: float = 1.0

    def __post_init__(self):
        try:
            down, right = (float(part) for part in self.shift)
            rotation, zoom = float(self.rotation), float(self.zoom)
        except (TypeError, ValueError):
            raise BadData(
                f"view = {self!r}: wanted a shift of two numbers, a rotation and a zoom"
            ) from None
        if not all(map(isfinite, (down, right, rotation))) or max(abs(down), abs(right)) > FARTHEST:
            raise OutOfRange("view", self, f"finite numbers, the shift up to {FARTHEST:g} pixels")
        if not 1 <= zoom <= MOST_ZOOM:
            raise OutOfRange(
                "view.zoom", zoom, f"1 .. {MOST_ZOOM:g}; a wider view is that of a larger scene"
            )
        object.__setattr__(self, "shift", (down, right))
        object.__setattr__(self, "rotation", rotation % (2 * pi))
        object.__setattr__(self, "zoom", zoom)

    @property
    def is_plain(self) -> bool:
        """Whether the frame shows the middle of the scene, as it is."""
        return self.zoom == 1 and not (self.rotation or any(self.shift))

    def is_whole(self, ratio: float = 1.0) -> bool:
        """Whether it shows samples where they are: displaced by whole ones. ratio: samples per pixel."""
        return (
            not self.rotation
            and self.zoom == 1
            and all((ratio * move).is_integer() for move in self.shift)
        )

    def place(self, y, x, ratio: float = 1.0) -> tuple[Any, Any]:
        """Rows and columns of the scene that places of the frame show, both from the middle [sample].

        ratio: samples per pixel.
        """
        c, s = cos(self.rotation) / self.zoom, sin(self.rotation) / self.zoom
        return c * y + s * x + ratio * self.shift[0], c * x - s * y + ratio * self.shift[1]
