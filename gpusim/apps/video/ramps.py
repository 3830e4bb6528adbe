"""Settings that change evenly over a video: exposure, ISO speed, lens and light."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gpusim.apps.video.named import read_named, read_positive

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.domain.camera import Camera
    from gpusim.domain.scene import Scene

CAMERA = ("exposure", "iso", "f-number", "focus")
NAMES = (*CAMERA, "light")


@dataclass(frozen=True)
class Ramps:
    """Values at the first and at the last frame, and between them evenly in the logarithm.

    Attributes:
        ranges: Name of NAMES and (first, last): exposure time [s], ISO speed, f-number, distance of
            the plane in focus [m], and a factor of all light.
    """

    ranges: tuple[tuple[str, tuple[float, float]], ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Ramps":
        """Return the ramps of `exposure=1/500..1/30,focus=0.3..5`. Raises ArgumentTypeError."""

        def read(name, text):
            if name not in NAMES:
                raise ValueError
            first, last = (read_positive(name, end) for end in text.split(".."))
            return first, last

        wanted = f"NAME=FIRST..LAST, numbers above 0, each NAME once: {', '.join(NAMES)}"
        return cls(tuple(read_named(text, read, wanted).items()))

    def at(self, part: float) -> dict[str, float]:
        """Return the values at a part of the video, 0 .. 1."""
        return {
            name: float(
                min(max(first * (last / first) ** part, min(first, last)), max(first, last))
            )
            for name, (first, last) in self.ranges
        }  # a power rounds, and must not leave the range

    def camera(self, camera: "Camera", part: float) -> "Camera":
        """Return the camera at a part of the video. Raises as `operate_camera` does."""
        values = self.at(part)
        if not any(name in CAMERA for name in values):
            return camera
        from gpusim.color.speed import operate_camera

        return operate_camera(
            camera,
            exposure=values.get("exposure"),
            iso=values.get("iso"),
            f_number=values.get("f-number"),
            focus=values.get("focus"),
        )

    def scene(self, scene: "Scene", part: float) -> "Scene":
        """Return the scene in the light at a part of the video."""
        factor = self.at(part).get("light")
        return scene if factor is None else scene.brighten(factor)
