"""Scenes of the frames of a video."""

import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import islice, repeat
from pathlib import Path
from typing import Protocol

from gpusim.captures.parallax import move_camera
from gpusim.domain.animation import Actor, Animation
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene
from gpusim.io.scene.readers import IN_FOLDERS, scene_files

NUMBERED = re.compile(r"(.*?)(\d+)", re.DOTALL)


class Scenes(Protocol):
    """Scenes of the frames of a video, all of one size.

    Attributes:
        count: Number of frames.
        is_still: Whether all frames show the same scene.
        names: Names of the scenes.
        rate: Frames per second of a video, None for other scenes.
    """

    count: int
    is_still: bool
    names: list[str]
    rate: Fraction | None

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """Yield the scenes of the frames first .. end - 1.

        Raises:
            BadData: If a scene has another size.
            GpusimError: As `open_scene` does.
        """


class Still:
    """One scene in every frame."""

    is_still = True
    rate: Fraction | None = None

    def __init__(self, scene: Scene, count: int):
        self.scene, self.count, self.names = scene, count, [scene.name]

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        return repeat(self.scene, end - first)


class Files:
    """A scene file for every frame. opened: function from a path to its scene."""

    is_still = False
    rate: Fraction | None = None

    def __init__(self, paths: Sequence[Path], opened: Callable[[Path], Scene]):
        self._paths, self._opened, self.count = list(paths), opened, len(paths)
        self.names = [str(path) for path in paths]
        self._shape = opened(self._paths[0]).shape

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        for path in islice(self._paths, first, end):
            yield check_size(self._opened(path), self._shape, path, self._paths[0])


class First:
    """The first `count` frames of other scenes. Raises OutOfRange if there are fewer."""

    is_still = False

    def __init__(self, scenes: Scenes, count: int):
        if count > scenes.count:
            allowed = f"up to {scenes.count}, the frames of {scenes.names[0]}"
            raise OutOfRange("--frames", count, allowed)
        self.count, self.names, self.between = count, scenes.names, scenes.between
        self.rate = scenes.rate


class Moving:
    """Scenes in front of a moving camera.

    Args:
        scenes: The scenes before they move, later `still`.
        motion: Movement of the camera.
        rate: Frames per second.
        flicker: Flicker of all light.
        actors: Pictures that move in front of the scenes.
        camera: The camera, for its focal length, if it travels.

    Attributes:
        is_one_scene: Whether all frames are views of one scene.

    Raises:
        BadData, OutOfRange: If the view leaves the scene.
    """

    is_still = False

    def __init__(
        self,
        scenes: Scenes,
        motion: Motion,
        rate: Fraction,
        flicker: Flicker | None = None,
        actors: tuple[Actor, ...] = (),
        camera: Camera | None = None,
    ):
        self.still, self.motion, self.period = scenes, motion, float(1 / rate)
        self.flicker, self.actors, self._camera = flicker, actors, camera
        self.count, self.names = scenes.count, scenes.names
        self.rate = scenes.rate
        self.is_one_scene = scenes.is_still and not actors and camera is None
        for number in (0, self.count - 1):
            motion.at(number * self.period)  # raises before the work

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        for number, scene in enumerate(self.still.between(first, end), first):
            time = number * self.period
            shown = Animation(scene, self.actors).at(time) if self.actors else scene
            if self._camera is not None:
                shown = move_camera(shown, self._camera, self.motion.place(time))
            yield shown.viewed(self.motion.through(shown.view).at(time))


def check_size(scene: Scene, shape, name, first) -> Scene:
    """Return a scene unchanged. Raises BadData if its frame has another size than the first one."""
    if scene.shape != shape:
        raise BadData(
            f"{name}: a frame of {scene.shape[1]}x{scene.shape[0]} pixels, after "
            f"{shape[1]}x{shape[0]} of {first}; a video has one size"
        )
    return scene


def numbered_files(folder: Path) -> list[Path]:
    """Return the scene files of a folder by number.

    Raises BadFile if there are none, or two series.
    """
    try:
        found = scene_files(folder)
    except OSError as error:
        raise BadFile(folder, f"cannot be read: {error.strerror or error}") from error
    if not found:
        why = f"no scene files in it; wanted numbered ones ({', '.join(IN_FOLDERS)})"
        raise BadFile(folder, why)
    numbers: dict[Path, tuple] = {}
    for path in found:
        parts, (kind, _) = NUMBERED.fullmatch(path.stem), next(iter(numbers.values()), (None, 0))
        if parts is None:
            raise BadFile(
                path,
                "its name does not end in a number, so its place in the video is unknown; move it "
                "away, or give the files one by one",
            )
        numbers[path] = (parts[1], path.suffix), int(parts[2])
        if kind not in (None, numbers[path][0]):
            raise BadFile(
                folder,
                f"files of two videos: {found[0].name} and {path.name}; give one of them, for example "
                f"{folder / '*'.join(kind)}",
            )
    return sorted(found, key=lambda path: numbers[path][1])


def check_numbers(paths: Sequence[Path]):
    """Raise BadFile if the numbers of files that differ only by a number have a gap or go down."""
    parts = [part for path in paths if (part := NUMBERED.fullmatch(path.stem))]
    kinds = {(path.parent, path.suffix) for path in paths} | {part[1] for part in parts}
    if len(parts) < len(paths) or len(kinds) > 2:
        return
    numbers = [int(part[2]) for part in parts]
    for path, before, number in zip(paths[1:], numbers, numbers[1:], strict=False):
        if number <= before:
            raise BadFile(
                path,
                f"number {number} comes after {before}: the files are not in the order of their "
                "numbers; --any-order keeps their order",
            )
        if number > before + 1:
            missing = f"{before + 1}" + (f" .. {number - 1}" if number > before + 2 else "")
            raise BadFile(path, f"number {missing} is missing before it; --any-order allows gaps")
