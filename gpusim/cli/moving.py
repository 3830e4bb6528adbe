"""Options of commands with several scenes or a moving camera, and the scenes of their frames."""

from dataclasses import dataclass
from fractions import Fraction
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.apps.video.actors import Cast
from gpusim.cli.options import (
    SCENES_HELP,
    Request,
    flag,
    number,
    option,
    reads,
    scene_option,
    whole,
)
from gpusim.domain.errors import BadFile

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.apps.video.scenes import Scenes
    from gpusim.domain.flicker import Flicker

MOST_FRAMES = 10**7
FASTEST, DEFAULT_RATE = 10**5, Fraction(30)  # [frame/s]


_rate = number(
    "frames per second, such as 24, 29.97 or 30000/1001",
    lambda rate: 0 < rate <= FASTEST,
    lambda text: Fraction(text).limit_denominator(1001),
)


@reads("two numbers, DOWN,RIGHT, such as 0,20")
def _pair(text):
    """Return the two numbers of DOWN,RIGHT."""
    down, right = (float(part) for part in text.split(","))
    return down, right


@reads("three numbers, DOWN,RIGHT,AHEAD, such as 0,0.1,0")
def _triple(text):
    """Return the three numbers of DOWN,RIGHT,AHEAD."""
    down, right, ahead = (float(part) for part in text.split(","))
    return down, right, ahead


def _movement(default, metavar, words):
    """Return the field of an option with one number."""
    return option(default=default, type=number("a number"), metavar=metavar, help=words)


@dataclass(frozen=True, kw_only=True)
class MovingRequest(Request):
    """One scene or several, the movement of the camera, and actors in front of the scene."""

    scene: list[str] = scene_option(SCENES_HELP, nargs="+")
    frames: int | None = option(
        type=whole(1, MOST_FRAMES),
        in_key=False,
        metavar="N",
        help="number of frames of one scene, or of the first frames of a video (default: 1; all of "
        "a video)",
    )
    fps: Fraction | None = option(
        type=_rate,
        metavar="RATE",
        help="frames per second, such as 24, 29.97 or 30000/1001; limits the exposure time "
        "(default: a video's own, else 30)",
    )
    pan: tuple[float, float] = option(
        default=(0.0, 0.0),
        type=_pair,
        metavar="DOWN,RIGHT",
        help="speed of the camera over the scene [pixel/s]",
    )
    roll: float = _movement(0.0, "DEG_S", "rotation about the optical axis [degree/s]")
    zoom: float = _movement(
        1.0,
        "Z",
        "magnification of the first frame, at least 1: 1.1 leaves a margin for a moving camera "
        "(default: 1)",
    )
    zooming: float = _movement(1.0, "FACTOR", "growth of the magnification per second (default: 1)")
    shake: float = _movement(0.0, "PIXELS", "root mean square displacement of a hand-held camera")
    travel: tuple[float, float, float] = option(
        default=(0.0, 0.0, 0.0),
        type=_triple,
        metavar="DOWN,RIGHT,AHEAD",
        help="speed of the camera's place [m/s]: near things move more; the scene needs depth",
    )
    actor: list[Cast] | tuple = option(
        default=(),
        type=Cast.parse,
        action="append",
        metavar="PNG,...",
        help="a picture with alpha that moves in front of a photograph; may be repeated, the "
        "nearest first: car.png,at=40:-200 (row and column of its centre, from the scene's "
        "centre),pan=0:120 (pixel/s),roll=DEG_S,zoom=Z,zooming=FACTOR, and "
        "distance=METRES in a scene with depth",
    )
    transfer: str | None = option(
        metavar="NAME",
        help="transfer function of a video's codes, in place of its tag: bt709, srgb, pq, hlg, "
        "linear, gamma2.2, gamma2.8",
    )
    any_order: bool = flag("keep the order of scene files whatever their numbers", in_key=False)

    def open_scenes(self, seed: int = 0, flicker: "Flicker | None" = None) -> "Scenes":
        """Return the scenes of all frames.

        Args:
            seed: Seed of the hand's movement.
            flicker: Flicker of all light.

        Raises:
            BadFile, BadData, Conflict: And as `open_scene` does.
        """
        from gpusim.apps.video.scenes import Moving
        from gpusim.domain.motion import Motion

        scenes: Any = self._open_scenes()
        roll, travel = radians(self.roll), self.travel
        motion = Motion(self.pan, roll, self.zoom, self.zooming, self.shake, seed, travel)
        actors = tuple(cast.actor() for cast in self.actor)
        if motion != Motion(seed=seed) or flicker or actors:
            camera = self.open_camera() if any(travel) else None
            rate = self.frame_rate(scenes)
            scenes = Moving(scenes, motion, rate, flicker, actors, camera)
            next(scenes.between(0, 1))  # refuses actors that do not fit
        return scenes

    def frame_rate(self, scenes: "Scenes") -> Fraction:
        """Return the frames per second: --fps, else a video's own, else 30."""
        return self.fps or scenes.rate or DEFAULT_RATE

    def check_movement(self, scenes: "Scenes") -> None:
        """Raise Conflict for a movement that no frame of these scenes shows."""
        if scenes.count == 1:
            for name in ("pan", "roll", "zooming", "travel"):
                self.refuse(name, "a single frame shows no movement", "make more --frames")

    def _open_scenes(self):
        """Return the scenes before the camera moves."""
        from gpusim.apps.video.scenes import Files, First, Still, check_numbers, numbered_files
        from gpusim.apps.video.video_frames import SUFFIXES, Film

        names = self.scene
        films = [name for name in names if Path(name).suffix.lower() in SUFFIXES]
        if films and len(names) > 1:
            raise BadFile(films[0], "a video among several scenes; give only the video")
        if films:
            for name in (
                "size",
                "band",
                "wavelengths",
                "kind",
                "scale",
                "key",
                "fov",
                "depth",
                "projection",
                "part",
                "layer",
                "view",
            ):
                self.refuse(name, "a video has its own size and colours, and no depth")
        else:
            self.refuse("transfer", f"only a video has codes ({', '.join(SUFFIXES)})")
        is_folder = len(names) == 1 and Path(names[0]).is_dir()
        if len(names) == 1 and not is_folder:
            self.refuse("any_order", "one scene has only one order")
        if films:
            options = ("light", "luminance", "border", "samples_per_pixel")
            values = {name: getattr(self, name) for name in options}
            given = {name: value for name, value in values.items() if value is not None}
            film = Film(Path(names[0]), self.transfer, **given)
            return film if self.frames is None else First(film, self.frames)
        if len(names) == 1 and not is_folder:
            return Still(self.open_scene(names[0]), self.frames or 1)
        paths = numbered_files(Path(names[0])) if is_folder else [Path(name) for name in names]
        self.refuse(
            "frames", f"{len(paths)} scenes make as many frames", "leave it out, or give one scene"
        )
        if not self.any_order:
            check_numbers(paths)
        return Files(paths, lambda path: self.open_scene(str(path)))
