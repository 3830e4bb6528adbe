"""Pictures that move in front of the scene of a video, as given on a command line."""

from dataclasses import dataclass
from math import isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.apps.video.named import read_named

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.domain.animation import Actor

KEYS = {"at": 2, "pan": 2, "roll": 1, "zoom": 1, "zooming": 1, "distance": 1}  # name -> numbers


@dataclass(frozen=True)
class Cast:
    """A picture with alpha and its movement: place at the first frame, and fields of a Motion."""

    path: Path
    numbers: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Cast":
        """Return the cast of `car.png,at=40:-200,pan=0:120,roll=5`. Raises ArgumentTypeError."""

        def read(name, text):
            numbers = tuple(float(one) for one in text.split(":"))
            if len(numbers) != KEYS[name] or not all(map(isfinite, numbers)):
                raise ValueError
            return numbers

        path, _, rest = text.partition(",")
        wanted = "at=ROW:COL, pan=DOWN:RIGHT, roll=DEG_S, zoom=Z, zooming=FACTOR or distance=METRES, each once"
        return cls(Path(path), tuple(read_named(rest, read, wanted).items()) if rest else ())

    def actor(self) -> "Actor":
        """Return the picture and its movement. Raises BadFile, OutOfRange."""
        from gpusim.domain.animation import Actor
        from gpusim.domain.motion import Motion
        from gpusim.io.scene.photo import read_cutout

        own = dict(self.numbers)
        content, alpha = read_cutout(self.path)
        down, right = own.get("pan", (0.0, 0.0))
        path = Motion(
            (down, right),
            radians(own.get("roll", (0.0,))[0]),
            own.get("zoom", (1.0,))[0],
            own.get("zooming", (1.0,))[0],
        )
        row, col = own.get("at", (0.0, 0.0))
        (distance,) = own.get("distance", (None,))
        return Actor(content, alpha, (row, col), path, distance)
