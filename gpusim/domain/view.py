"""The part of a scene that a frame shows."""

from dataclasses import dataclass
from math import cos, isfinite, pi, sin
from typing import Any

from gpusim.domain.errors import BadData, OutOfRange

FARTHEST = 1e5  # [pixel]
MOST_ZOOM = 100.0


@dataclass(frozen=True)
class View:
    """Mapping from the frame to the scene: frame position p shows shift + R(rotation) p / zoom.

    Both positions are relative to the centre [pixel].

    Args:
        shift: Rows and columns of the scene point at the centre of the frame [pixel].
        rotation: Rotation of the camera about its axis, in the plane of the frame, from the columns
            to the rows [rad].
        zoom: Magnification, 1 or more. A smaller one would make samples finer than the scene's
            `samples_per_pixel` says.

    Raises:
        BadData: A value is no number.
        OutOfRange: A number is outside its range.
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
                "view.zoom", zoom, f"1 .. {MOST_ZOOM:g}; a wider view needs a larger scene"
            )
        object.__setattr__(self, "shift", (down, right))
        object.__setattr__(self, "rotation", rotation % (2 * pi))
        object.__setattr__(self, "zoom", zoom)

    @property
    def is_plain(self) -> bool:
        """True if the frame shows the centre of the scene, unrotated and at magnification 1."""
        return self.zoom == 1 and not (self.rotation or any(self.shift))

    def is_whole(self, ratio: float = 1.0) -> bool:
        """Return True if pixels fall on samples: the shift is a whole number of samples.

        Args:
            ratio: Scene samples per pixel.

        Returns:
            True if no interpolation is needed.
        """
        return (
            not self.rotation
            and self.zoom == 1
            and all((ratio * move).is_integer() for move in self.shift)
        )

    def place(self, y: Any, x: Any, ratio: float = 1.0) -> tuple[Any, Any]:
        """Return the scene positions that frame positions show, both relative to the centre.

        Args:
            y: Rows of the frame [sample], a number or an array.
            x: Columns of the frame [sample].
            ratio: Scene samples per pixel.

        Returns:
            Rows and columns of the scene [sample].
        """
        c, s = cos(self.rotation) / self.zoom, sin(self.rotation) / self.zoom
        return c * y + s * x + ratio * self.shift[0], c * x - s * y + ratio * self.shift[1]
