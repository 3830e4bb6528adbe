"""Which scene each frame of a video shows."""

import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import islice, repeat
from pathlib import Path
from typing import Protocol

from gpusim.domain.animation import Actor, Animation
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene
from gpusim.io.scene.readers import IN_FOLDERS, scene_files

NUMBERED = re.compile(r"(.*?)(\d+)", re.DOTALL)


class Scenes(Protocol):
    """Scenes of one size. count: of the frames. is_still: whether all of them show one. names: of what is shown."""

    count: int
    is_still: bool
    names: list[str]

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """The scenes of the frames first .. end - 1. Raises what `open_scene` does, and BadData for another size."""


class Still:
    """One scene in every frame."""

    is_still = True

    def __init__(self, scene: Scene, count: int):
        self.scene, self.count, self.names = scene, count, [scene.name]

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        return repeat(self.scene, end - first)


class Files:
    """A scene file for every frame. opened: the scene of a path, as `open_scene` gives it."""

    is_still = False

    def __init__(self, paths: Sequence[Path], opened: Callable[[Path], Scene]):
        self._paths, self._opened, self.count = list(paths), opened, len(paths)
        self.names = [str(path) for path in paths]
        self._shape = opened(self._paths[0]).shape

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        for path in islice(self._paths, first, end):
            yield checked_size(self._opened(path), self._shape, path, self._paths[0])


class First:
    """The first frames of others. Raises OutOfRange where there are not so many."""

    is_still = False

    def __init__(self, scenes: Scenes, count: int):
        if count > scenes.count:
            raise OutOfRange(
                "--frames", count, f"up to {scenes.count}, which {scenes.names[0]} has"
            )
        self.count, self.names, self.between = count, scenes.names, scenes.between


class Moving:
    """Other scenes, `still`, before a camera that moves. rate: frames per second. Raises OutOfRange, BadData.

    flicker: of their light. actors: what moves in them.
    """

    is_still = False

    def __init__(
        self,
        scenes: Scenes,
        motion: Motion,
        rate: Fraction,
        flicker: Flicker | None = None,
        actors: tuple[Actor, ...] = (),
    ):
        self.still, self.motion, self.period, self.flicker = (
            scenes,
            motion,
            float(1 / rate),
            flicker,
        )
        self.actors = actors
        self.count, self.names = scenes.count, scenes.names
        for number in (0, self.count - 1):
            motion.at(number * self.period)  # said before the work

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `Scenes`."""
        for number, scene in enumerate(self.still.between(first, end), first):
            time = number * self.period
            yield (Animation(scene, self.actors).at(time) if self.actors else scene).viewed(
                self.motion.at(time)
            )


def checked_size(scene: Scene, shape, name, first) -> Scene:
    """Return a scene as it is. Raises BadData where it makes a frame of another size than the first."""
    if scene.shape != shape:
        raise BadData(
            f"{name}: a frame of {scene.shape[1]}x{scene.shape[0]} pixels, after {shape[1]}x{shape[0]} of "
            f"{first}; a video has one size"
        )
    return scene


def numbered_files(folder: Path) -> list[Path]:
    """Scene files of a folder in the order of their numbers. Raises BadFile where they are of two videos, or none."""
    try:
        found = scene_files(folder)
    except OSError as error:
        raise BadFile(folder, f"cannot be read: {error.strerror or error}") from error
    if not found:
        raise BadFile(
            folder, f"no scene files in it; wanted numbered ones ({', '.join(IN_FOLDERS)})"
        )
    numbers: dict[Path, tuple] = {}
    for path in found:
        parts, (kind, _) = NUMBERED.fullmatch(path.stem), next(iter(numbers.values()), (None, 0))
        if parts is None:
            raise BadFile(
                path,
                "its name ends in no number, so its place in the video is not known; move it away, or "
                "give the files one by one",
            )
        numbers[path] = (parts[1], path.suffix), int(parts[2])
        if kind not in (None, numbers[path][0]):
            raise BadFile(
                folder,
                f"files of two videos: {found[0].name} and {path.name}; give one of them, such as "
                f"{folder / '*'.join(kind)}",
            )
    return sorted(found, key=lambda path: numbers[path][1])


def check_numbers(paths: Sequence[Path]):
    """Raise BadFile where the files' numbers, if all that differs are numbers, leave one out or go down."""
    parts = [part for path in paths if (part := NUMBERED.fullmatch(path.stem))]
    kinds = {(path.parent, path.suffix) for path in paths} | {part[1] for part in parts}
    if len(parts) < len(paths) or len(kinds) > 2:
        return
    numbers = [int(part[2]) for part in parts]
    for path, before, number in zip(paths[1:], numbers, numbers[1:], strict=False):
        if number <= before:
            raise BadFile(
                path,
                f"number {number} comes after {before}: the order of the files is not that of their "
                "numbers; --any-order takes them as they are given",
            )
        if number > before + 1:
            missing = f"{before + 1}" + (f" .. {number - 1}" if number > before + 2 else "")
            raise BadFile(
                path, f"number {missing} is missing before it; --any-order goes on without"
            )
