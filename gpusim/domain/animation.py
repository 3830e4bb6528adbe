"""Things that move before a scene, each along its own path: the scene at every time is made of samples on its grid."""

from dataclasses import dataclass, field
from math import ceil, cos, floor, sin

import numpy as np
import scipy.ndimage

from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import brief


@dataclass(frozen=True, eq=False)
class Actor:
    """A flat thing in the scene's light, in front of what is behind it.

    content: of its samples, on a grid as fine as the scene's, shape (rows, cols); a Cube of the scene's wavelengths, or
    a Basis of its basis. alpha: part of each sample that it covers, 0 .. 1, shape (rows, cols). place: of its middle
    from the scene's, rows and columns, at time 0 [pixel]. path: how it moves from there: it turns by the motion's
    rotation and grows by its zoom.
    Raises BadData, OutOfRange.
    """

    content: Content
    alpha: np.ndarray
    place: tuple[float, float] = (0.0, 0.0)
    path: Motion = field(default_factory=Motion)

    __repr__ = brief

    def __post_init__(self):
        if not isinstance(self.content, Basis | Cube):
            raise BadData(
                f"actor of {type(self.content).__name__}: wanted a Basis or a Cube: they interpolate"
            )
        self.content.check("actor")
        alpha = np.asarray(self.alpha, np.float32)
        if alpha.shape != self.content.shape:
            raise BadData(
                f"actor: alpha {alpha.shape} does not match its content {self.content.shape}"
            )
        if not (alpha.min(initial=0) >= 0 and alpha.max(initial=0) <= 1):  # NaN is refused as well
            raise OutOfRange("actor: alpha", f"{alpha.min():.4g} .. {alpha.max():.4g}", "0 .. 1")
        place = np.asarray(self.place, np.float64)
        if place.shape != (2,) or not np.isfinite(place).all():
            raise BadData(f"actor: place = {self.place!r}, wanted two finite numbers")
        if not isinstance(self.path, Motion):
            raise BadData(f"actor: path {type(self.path).__name__}, wanted a Motion")
        object.__setattr__(self, "alpha", alpha)

    def corners(self, time: float, ratio: float) -> np.ndarray:
        """Rows and columns of its corners from the scene's middle, shape (2, 2, 2) [sample]. ratio: samples a pixel."""
        view = self.path.at(time)
        down, right = np.meshgrid(*((-n / 2, n / 2) for n in self.alpha.shape), indexing="ij")
        c, s = view.zoom * cos(view.rotation), view.zoom * sin(view.rotation)
        return np.stack(
            [
                c * down + s * right + ratio * (self.place[0] + view.shift[0]),
                c * right - s * down + ratio * (self.place[1] + view.shift[1]),
            ]
        )

    def onto(self, planes: np.ndarray, time: float, ratio: float) -> None:
        """Put it onto planes (P, rows, cols), at a time [s].

        It is interpolated by cubic splines of what it covers, light times alpha; beyond its own samples is nothing.
        """
        corners, shape = self.corners(time, ratio), planes.shape[1:]
        middle = [(n - 1) / 2 for n in shape]
        box = [
            slice(max(floor(at.min() + half) - 1, 0), max(min(ceil(at.max() + half) + 2, n), 0))
            for at, half, n in zip(corners, middle, shape, strict=True)
        ]
        if any(part.start >= part.stop for part in box):
            return
        view = self.path.at(time)
        y, x = (
            np.arange(part.start, part.stop) - half - ratio * (start + moved)
            for part, half, start, moved in zip(box, middle, self.place, view.shift, strict=True)
        )
        c, s = cos(view.rotation) / view.zoom, sin(view.rotation) / view.zoom
        places = np.stack([c * y[:, None] - s * x, s * y[:, None] + c * x])
        places += np.array([(n - 1) / 2 for n in self.alpha.shape])[:, None, None]

        def there(values):
            found = scipy.ndimage.map_coordinates(values, places, order=3, mode="grid-constant")
            return np.clip(
                found, min(values.min(), 0), max(values.max(), 0)
            )  # splines ring beside steps

        behind = 1 - there(self.alpha)
        for plane, own in zip(planes, self.content.planes, strict=True):
            plane[tuple(box)] = behind * plane[tuple(box)] + there(self.alpha * own)


@dataclass(frozen=True, eq=False)
class Animation:
    """A scene in which things move. actors: the nearest first.

    The scene has no depth and no layers; its samples at a time are what the error account takes for true.
    Raises BadData.
    """

    scene: Scene
    actors: tuple[Actor, ...]

    __repr__ = brief

    def __post_init__(self):
        scene = checked_scene(self.scene)
        object.__setattr__(self, "actors", tuple(self.actors))
        if scene.depth is not None or scene.layers:
            raise BadData(f"{scene.name}: an animation of a scene with depth; wanted one without")
        for number, actor in enumerate(self.actors):
            if not isinstance(actor, Actor):
                raise BadData(f"actor {number}: {type(actor).__name__}, wanted an Actor")
            if not actor.content.is_like(scene.content.surfaces):
                raise BadData(
                    f"{scene.name}: actor {number} is a {actor.content.form}, the scene a "
                    f"{scene.content.surfaces.form}; wanted one form, and the same wavelengths and basis"
                )

    def at(self, time: float) -> Scene:
        """The scene at a time [s]; its samples are not looked at again."""
        content, ratio = self.scene.content.surfaces, self.scene.samples_per_pixel
        planes = np.array(content.planes, np.promote_types(content.planes.dtype, np.float32))
        for actor in self.actors[::-1]:
            actor.onto(planes, time, ratio)
        return self.scene.stored(**{content.samples[-1]: planes})

    def farthest(self, times) -> float:
        """How far a part of an actor moves between two of these times, at most [sample]."""
        ratio = self.scene.samples_per_pixel
        found = 0.0
        for actor in self.actors:
            at = np.array([actor.corners(time, ratio) for time in times])
            found = max(found, float(np.hypot(*np.diff(at, axis=0).swapaxes(0, 1)).max(initial=0)))
        return found
