"""Flat objects that move in front of a scene, each along its own path.

The scene at any time consists of samples on the grid of the scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, cos, floor, sin

import numpy as np
import scipy.ndimage

from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class Actor:
    """A flat object in the light of the scene, in front of the scene's content.

    Args:
        content: Its samples, on a grid as fine as the scene's, shape (rows, cols): a Cube with the
            wavelengths of the scene, or a Basis with the basis of the scene.
        alpha: Coverage of each sample, 0 .. 1, shape (rows, cols).
        place: Position of its centre relative to the scene's centre at time 0, rows and columns
            [pixel].
        path: Its movement from there. The rotation of the motion turns it, the zoom enlarges it.

    Raises:
        BadData: The content cannot be interpolated, or shapes or types do not match.
        OutOfRange: Alpha is outside 0 .. 1.
    """

    content: Content
    alpha: np.ndarray
    place: tuple[float, float] = (0.0, 0.0)
    path: Motion = field(default_factory=Motion)

    __repr__ = short_repr

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
        """Return its corners relative to the scene's centre.

        Args:
            time: Time [s].
            ratio: Scene samples per pixel.

        Returns:
            Rows and columns [sample], shape (2, 2, 2).
        """
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
        """Draw the object onto planes of scene samples, in place.

        Light times alpha is interpolated with cubic splines. It is zero outside the object's own
        samples.

        Args:
            planes: Samples of the scene, shape (P, rows, cols).
            time: Time [s].
            ratio: Scene samples per pixel.
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

        def resample(values):
            found = scipy.ndimage.map_coordinates(values, places, order=3, mode="grid-constant")
            # splines ring next to steps
            return np.clip(found, min(values.min(), 0), max(values.max(), 0))

        behind = 1 - resample(self.alpha)
        for plane, own in zip(planes, self.content.planes, strict=True):
            plane[tuple(box)] = behind * plane[tuple(box)] + resample(self.alpha * own)


@dataclass(frozen=True, eq=False)
class Animation:
    """A scene in which objects move.

    The scene has no depth and no layers. The error account takes the samples at a time as true.

    Args:
        scene: The background.
        actors: The objects, nearest first.

    Raises:
        BadData: The scene has depth or layers, or an actor does not match its content.
    """

    scene: Scene
    actors: tuple[Actor, ...]

    __repr__ = short_repr

    def __post_init__(self):
        scene = checked_scene(self.scene)
        object.__setattr__(self, "actors", tuple(self.actors))
        if scene.depth is not None or scene.layers:
            raise BadData(f"{scene.name}: an animation needs a scene without depth and layers")
        for number, actor in enumerate(self.actors):
            if not isinstance(actor, Actor):
                raise BadData(f"actor {number}: {type(actor).__name__}, wanted an Actor")
            if not actor.content.is_like(scene.content.surfaces):
                raise BadData(
                    f"{scene.name}: actor {number} is a {actor.content.form}, the scene a "
                    f"{scene.content.surfaces.form}; wanted one form, and the same wavelengths and basis"
                )

    def at(self, time: float) -> Scene:
        """Return the scene at one time. Its samples are not checked again.

        Args:
            time: Time [s].

        Returns:
            A scene with the actors drawn into its samples.
        """
        content, ratio = self.scene.content.surfaces, self.scene.samples_per_pixel
        planes = np.array(content.planes, np.promote_types(content.planes.dtype, np.float32))
        for actor in self.actors[::-1]:
            actor.onto(planes, time, ratio)
        return self.scene.stored(**{content.samples[-1]: planes})

    def farthest(self, times: Sequence[float]) -> float:
        """Return the longest distance that a corner of an actor moves between consecutive times.

        Args:
            times: Times [s].

        Returns:
            Distance [sample].
        """
        ratio = self.scene.samples_per_pixel
        found = 0.0
        for actor in self.actors:
            at = np.array([actor.corners(time, ratio) for time in times])
            found = max(found, float(np.hypot(*np.diff(at, axis=0).swapaxes(0, 1)).max(initial=0)))
        return found
