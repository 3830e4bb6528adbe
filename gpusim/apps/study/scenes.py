"""Scenes of a study: each is opened once."""

import inspect
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.data.charts import CHARTS, colorchecker_patches
from gpusim.domain.display import Display
from gpusim.domain.errors import BadData, GpusimError, UnknownName, format_value
from gpusim.domain.scene import Scene
from gpusim.io.scene.scenes import open_scene
from gpusim.measure.checker import Checker, checker_of
from gpusim.measure.ideal import ideal
from gpusim.pipeline.cache import same

NEUTRAL = 21  # patch of the ColorChecker from which SNR is measured: neutral 5
BLOCK = 8  # [pixel] a side of the squares whose mean colours are compared
CODES = 2**16  # values of linear light in the table of display codes
RIM = 4  # 1 / RIM of its side is left out at each border
PATCHES = {  # rows and columns of even light in charts, as shares of the frame: top, left, bottom, right
    "flat": (0.25, 0.25, 0.75, 0.75),
    "slanted-edge": (0.25, 0.7, 0.75, 0.95),
}


class StudyScene:
    """A scene, and all that measures need of it.

    Args:
        name: Its name in the study.
        scene: The scene.
        patch: Rows and columns (top, left, bottom, right) [pixel] that measures use; None: chosen by them.
        source: Its file, None for a chart.
    """

    def __init__(
        self,
        name: str,
        scene: Scene,
        patch: tuple[int, int, int, int] | None = None,
        source: Path | None = None,
    ):
        self.name, self.scene, self.patch, self.source = name, scene, patch, source
        self._ideals: list[tuple[Display, IdealPicture]] = []

    def __repr__(self):
        return f"StudyScene({self.name!r}, {self.scene!r})"

    @classmethod
    def parse(cls, name: str, given: Any, folder: Path) -> "StudyScene":
        """Return a scene of a study file: a chart or a file, or a table of scene and options of `open_scene`.

        Raises as `open_scene` does.
        """
        table = dict(given) if isinstance(given, Mapping) else {"scene": given}
        source, patch = table.pop("scene", None), table.pop("patch", None)
        if isinstance(source, Scene):
            if table:
                raise BadData(
                    f"scene {name}: options {', '.join(table)} of a Scene; leave them out"
                )
            scene = source
        else:
            scene = _open(name, source, table, folder)
        if patch is not None:
            patch = _checked_patch(name, patch, scene.shape)
        is_file = isinstance(source, str) and source not in CHARTS
        return cls(name, scene, patch, folder / source if is_file else None)

    @cached_property
    def checker(self) -> Checker | None:
        """The patches of a ColorChecker, or None."""
        return checker_of(self.scene)

    def even_patch(self) -> tuple[int, int, int, int]:
        """Return rows and columns from which SNR is measured: even light, or the whole frame if none is known."""
        rows, cols = self.scene.shape
        if self.patch is not None:
            return self.patch
        if self.scene.name in PATCHES:
            top, left, bottom, right = PATCHES[self.scene.name]
            return int(top * rows), int(left * cols), int(bottom * rows), int(right * cols)
        if self.checker is not None:
            down, across = colorchecker_patches((cols, rows))[NEUTRAL]
            rim = (down.stop - down.start) // RIM
            return down.start + rim, across.start + rim, down.stop - rim, across.stop - rim
        return 0, 0, rows, cols

    def ideal_on(self, display: Display, shape: Sequence[int]) -> "IdealPicture":
        """Return the scene on a display, see `gpusim.measure.ideal`, without lens and noise.

        Args:
            display: The display.
            shape: Rows and columns.

        Returns:
            The picture; those of the last two displays are kept.
        """
        for known, found in self._ideals:
            if found.xyz.shape[:2] == tuple(shape) and (known is display or same(known, display)):
                return found
        found = IdealPicture(ideal(self.scene, display, shape), display)
        self._ideals = [(display, found), *self._ideals[:1]]
        return found


class IdealPicture:
    """The picture of a scene by an ideal camera.

    Args:
        xyz: XYZ (rows, cols, 3), white Y = 1.
        display: The display.
    """

    def __init__(self, xyz: np.ndarray, display: Display):
        self.xyz, self._display = xyz, display

    @cached_property
    def codes(self) -> np.ndarray:
        """Display codes 0 .. 1, clipped to the display's range, float32 (3, rows, cols)."""
        linear = np.tensordot(np.linalg.inv(self._display.xyz_from_rgb), self.xyz, (1, 2))
        return encode(self._display, np.clip(linear, 0, 1))

    @cached_property
    def blocks(self) -> np.ndarray:
        """Mean XYZ of squares, see `block_means`."""
        return block_means(np.moveaxis(self.xyz, -1, 0))


def encode(display: Display, linear: np.ndarray) -> np.ndarray:
    """Return display codes 0 .. 1 of linear light 0 .. 1, float32, with an error below 1e-4."""
    steps = np.float32(CODES - 1)
    return _code_table(display.curve)[(linear * steps + np.float32(0.5)).astype(np.uint16)]


@lru_cache(maxsize=4)
def _code_table(curve) -> np.ndarray:
    """Return the codes of CODES evenly spaced values of linear light."""
    return Display(curve=curve).encode(np.linspace(0, 1, CODES)).astype(np.float32)


def block_means(planes: np.ndarray) -> np.ndarray:
    """Return the means of squares of BLOCK pixels of a picture (3, rows, cols): float64 (rows, cols, 3).

    Rows and columns that fill no square are left out.
    """
    _, rows, cols = planes.shape
    side = min(BLOCK, rows, cols)
    down, across = rows // side, cols // side
    cut = planes[:, : down * side, : across * side].reshape(3, down, side, across * side)
    lines = cut.sum(axis=2, dtype=np.float64).reshape(3, down, across, side)
    return np.moveaxis(lines.sum(axis=3), 0, -1) / side**2


def _open(name, source, options, folder):
    """Return a scene. Raises BadData, UnknownName, and as `open_scene` does, with the scene's name in the study."""
    if not isinstance(source, str):
        raise BadData(f"scene {name} = {format_value(source)}: wanted a chart or a file's name")
    known = [key for key in inspect.signature(open_scene).parameters if key != "name_or_path"]
    for key in options:
        if key not in known:
            raise UnknownName(f"option of scene {name}", key, (*known, "patch"))
    size = options.get("size")
    if size is not None and not (
        isinstance(size, list | tuple) and [*map(type, size)] == [int, int]
    ):
        raise BadData(f"scene {name}: size = {format_value(size)}, wanted [columns, rows]")
    if "fov" in options:
        options["fov"] = _radians(name, options["fov"])
    place = source if source in CHARTS else folder / source
    if source not in CHARTS and not place.exists():
        raise UnknownName(f"chart or file of scene {name}", source, CHARTS)
    try:
        return open_scene(place, **options)
    except (TypeError, ValueError) as error:  # an option of another type
        raise BadData(f"scene {name}: {error}") from None
    except GpusimError as error:
        raise type(error)(*_named(error, name)) if type(error) is BadData else error from error


def _named(error, name):
    return (f"scene {name}: {error.details}",)


def _radians(name, given):
    """Return the radians of a field of view in degrees."""
    if not isinstance(given, int | float) or not 0 < given < 180:
        raise BadData(f"scene {name}: fov = {format_value(given)}, wanted degrees, 0 < fov < 180")
    return math.radians(given)


def _checked_patch(name, given, shape) -> tuple[int, int, int, int]:
    """Return rows and columns of a patch. Raises BadData."""
    rows, cols = shape
    is_patch = (
        isinstance(given, list | tuple)
        and len(given) == 4
        and all(isinstance(one, int) and not isinstance(one, bool) for one in given)
        and 0 <= given[0] < given[2] <= rows
        and 0 <= given[1] < given[3] <= cols
    )
    if not is_patch:
        raise BadData(
            f"scene {name}: patch = {format_value(given)}, wanted [top, left, bottom, right] in "
            f"whole pixels inside the frame of {rows} rows and {cols} columns"
        )
    return tuple(given)
