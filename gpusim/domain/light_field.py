"""A light field: a scene as pinholes in an entrance pupil see it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import shorten_repr

MOST_NAMED = 4  # missing views that a message names


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of a scene from a grid of places in an entrance pupil.

    The square of 2 `radius` by 2 `radius` around the axis is divided into T x S cells. View (j, i) is
    the scene as a pinhole at the centre of cell (j, i) sees it, with j along the rows and i along the
    columns of the picture. Views are aligned: a thing at `object_distance` is at one place in all of
    them. A thing at the distance D is displaced by -d / (2 N_w) (x, y) [m at the sensor], with the
    place (x, y) of the pinhole in radii of the pupil and the displacement d of the sensor that has
    the defocus of D, see `Optics.displacement`.

    Args:
        views: T rows of S scenes, of one shape, wavelengths and light.
        radius: Half the side of the grid in the entrance pupil [m].
        object_distance: Distance of things that coincide in all views [m].
        name: Name in messages.

    Raises:
        BadData: A view is missing, or views differ in shape, wavelengths, light, form or border.
        OutOfRange: A number is out of its range.
    """

    views: tuple[tuple[Scene, ...], ...]
    radius: float
    object_distance: float = np.inf
    name: str = "light field"

    def __post_init__(self):
        object.__setattr__(self, "views", checked_rows(self.views, self.name))
        for key in ("radius", "object_distance"):
            value = getattr(self, key)
            if not isinstance(value, int | float | np.number) or isinstance(value, bool):
                raise BadData(f"{self.name}: {key} {type(value).__name__}, wanted a number [m]")
        if not (isfinite(self.radius) and self.radius > 0):
            raise OutOfRange("light_field.radius", f"{self.radius:.6g} m", "radius > 0, finite")
        if not self.object_distance > 0:
            raise OutOfRange(
                "light_field.object_distance", f"{self.object_distance:.6g} m", "more than 0"
            )
        first = self.views[0][0]
        for j, row in enumerate(self.views):
            for i, view in enumerate(row):
                self._check_view(f"view ({j}, {i})", view, first)

    def _check_view(self, label, view, first):
        """Raise BadData if a view differs from the first one in more than its samples."""
        wrong = {
            "shape": (view.content.shape, first.content.shape),
            "form": (view.content.form, first.content.form),
            "samples_per_pixel": (view.samples_per_pixel, first.samples_per_pixel),
            "border": (
                f"{view.border}, {view.margin} samples",
                f"{first.border}, {first.margin} samples",
            ),
            "unit": (_describe_unit(view), _describe_unit(first)),
        }
        for key, (own, its) in wrong.items():
            if own != its:
                raise BadData(
                    f"{self.name}: {key} of {label} is {own}, of view (0, 0) {its}; wanted one for all"
                )
        if not np.array_equal(view.wavelengths, first.wavelengths):
            raise BadData(f"{self.name}: {label} has other wavelengths than view (0, 0)")
        lights = view.illuminant, first.illuminant
        if lights[0] is not lights[1] and not all(
            np.array_equal(getattr(lights[0], key), getattr(lights[1], key))
            for key in ("wavelengths", "values")
        ):
            raise BadData(f"{self.name}: {label} has another light than view (0, 0)")

    def __repr__(self):
        rows, cols = self.shape
        return shorten_repr(
            f"LightField({self.name!r}, {rows} x {cols} views, radius {self.radius:.4g} m, aligned at "
            f"{self.object_distance:.4g} m, {self.views[0][0]!r})"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of views."""
        return len(self.views), len(self.views[0])

    @property
    def places(self) -> np.ndarray:
        """Places (y, x) of the pinholes in the entrance pupil [m], shape (T, S, 2)."""
        return self.radius * cell_centres(self.shape)

    @property
    def nbytes(self) -> int:
        """Memory of the samples of all views, their layers and depth [byte]."""
        return sum(_count_bytes(view) for row in self.views for view in row)

    def view(self, j: int, i: int) -> Scene:
        """Return the scene as one pinhole sees it.

        Args:
            j: Row of the view, from 0.
            i: Column of the view, from 0.

        Returns:
            The scene.

        Raises:
            OutOfRange: There is no such view.
        """
        rows, cols = self.shape
        if not (j in range(rows) and i in range(cols)):
            allowed = f"rows 0 .. {rows - 1} and columns 0 .. {cols - 1}"
            raise OutOfRange("view of a light field", f"({j}, {i})", allowed)
        return self.views[int(j)][int(i)]


def cell_centres(shape: tuple[int, int]) -> np.ndarray:
    """Return the centres (y, x) of cells of the square [-1, 1] x [-1, 1].

    Args:
        shape: Rows and columns of cells.

    Returns:
        Places, shape (*shape, 2).
    """
    sides = [-1 + (2 * np.arange(count) + 1) / count for count in shape]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)


def checked_rows(views: Sequence, name: str) -> tuple[tuple[Scene, ...], ...]:
    """Return views as tuples. Raise BadData if they are no full grid of scenes; it names those missing."""
    try:
        rows = tuple(tuple(row) for row in views)
    except TypeError:
        raise BadData(f"{name}: views {type(views).__name__}, wanted rows of Scenes") from None
    width = max(map(len, rows), default=0)
    if not width:
        raise BadData(f"{name}: no views, wanted rows of Scenes")
    missing = [
        (j, i)
        for j, row in enumerate(rows)
        for i in range(width)
        if i >= len(row) or row[i] is None
    ]
    if missing:
        raise BadData(f"{name}: {name_missing(missing, (len(rows), width))}")
    for j, row in enumerate(rows):
        for i, view in enumerate(row):
            if not isinstance(view, Scene):
                raise BadData(
                    f"{name}: view ({j}, {i}) is {type(view).__name__}, wanted a Scene, for example from open_scene"
                )
    return rows


def name_missing(missing: Sequence[tuple[int, int]], shape: tuple[int, int]) -> str:
    """Return the words that name missing views of a grid."""
    named = ", ".join(f"({j}, {i})" for j, i in missing[:MOST_NAMED])
    more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
    return f"of {shape[0]} x {shape[1]} views {named}{more} missing"


def _describe_unit(scene):
    """Return the unit of a scene's content, in words."""
    return "reflectance" if scene.light_is_known else "radiance"


def _count_bytes(scene):
    """Return the memory of a scene's arrays [byte]."""
    maps = 0 if scene.depth is None else scene.depth.nbytes
    layers = sum(
        layer.content.nbytes + np.asarray(layer.alpha).nbytes + np.asarray(layer.depth).nbytes
        for layer in scene.layers
    )
    return scene.content.nbytes + maps + layers
