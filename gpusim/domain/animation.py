"""Flat objects that move in front of a scene, each along its own path.

The scene at any time consists of samples on the grid of the scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, cos, floor, inf, sin

import numpy as np
import scipy

from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Layer, Scene, checked_scene
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
        distance: Its distance [m], in a scene with depth: it hides what is farther, is hidden by
            what is nearer, and is blurred for this distance.

    Raises:
        BadData: The content cannot be interpolated, or shapes or types do not match.
        OutOfRange: Alpha is outside 0 .. 1, or the distance is not above 0.
    """

    content: Content
    alpha: np.ndarray
    place: tuple[float, float] = (0.0, 0.0)
    path: Motion = field(default_factory=Motion)
    distance: float | None = None

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
        if any(self.path.travel):
            raise BadData("actor: a path has no travel; give place, pan and zooming")
        if self.distance is not None and not 0 < self.distance < inf:
            raise OutOfRange("actor: distance", self.distance, "above 0 m")
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
        shape = planes.shape[1:]
        box = self._box(shape, time, ratio)
        if box is None:
            return
        places = self._places(box, shape, time, ratio)

        def resample(values):
            return _resample(values, places, "grid-constant")

        behind = 1 - resample(self.alpha)
        for plane, own in zip(planes, self.content.planes, strict=True):
            plane[box] = behind * plane[box] + resample(self.alpha * own)

    def layer(self, shape: tuple[int, int], time: float, ratio: float) -> Layer:
        """Return the object as a layer of a scene with depth.

        Args:
            shape: Rows and columns of the scene's samples.
            time: Time [s].
            ratio: Scene samples per pixel.

        Returns:
            The layer. Its light goes on outside its own samples, where its coverage is 0.
        """
        alpha = np.zeros(shape, np.float32)
        planes = np.zeros((len(self.content.planes), *shape), np.float32)
        box = self._box(shape, time, ratio)
        if box is not None:
            places = self._places(box, shape, time, ratio)
            alpha[box] = np.clip(_resample(self.alpha, places, "grid-constant"), 0, 1)
            for plane, own in zip(planes, self.content.planes, strict=True):
                plane[box] = _resample(own, places, "nearest")
        assert self.distance is not None
        return Layer(self.content.with_planes(planes), alpha, float(self.distance))

    def _box(self, shape, time, ratio):
        """Return the rows and columns of a scene of `shape` that the object covers, or None."""
        corners = self.corners(time, ratio)
        middle = [(n - 1) / 2 for n in shape]
        box = [
            slice(max(floor(at.min() + half) - 1, 0), max(min(ceil(at.max() + half) + 2, n), 0))
            for at, half, n in zip(corners, middle, shape, strict=True)
        ]
        return None if any(part.start >= part.stop for part in box) else tuple(box)

    def _places(self, box, shape, time, ratio):
        """Return where the samples of a box of a scene are in the object, rows and columns [index]."""
        view, middle = self.path.at(time), [(n - 1) / 2 for n in shape]
        y, x = (
            np.arange(part.start, part.stop) - half - ratio * (start + moved)
            for part, half, start, moved in zip(box, middle, self.place, view.shift, strict=True)
        )
        c, s = cos(view.rotation) / view.zoom, sin(view.rotation) / view.zoom
        places = np.stack([c * y[:, None] - s * x, s * y[:, None] + c * x])
        return places + np.array([(n - 1) / 2 for n in self.alpha.shape])[:, None, None]


def _resample(values, places, mode):
    """Return values interpolated with cubic splines."""
    found = scipy.ndimage.map_coordinates(values, places, order=3, mode=mode)
    # splines ring next to steps
    return np.clip(found, min(values.min(), 0), max(values.max(), 0))


@dataclass(frozen=True, eq=False)
class Animation:
    """A scene in which objects move.

    In a scene with depth each object has a distance and becomes a layer. The error account takes
    the samples at a time as true.

    Args:
        scene: The background.
        actors: The objects, nearest first.

    Raises:
        BadData: An actor does not match the scene's content, or only one of them has distances.
    """

    scene: Scene
    actors: tuple[Actor, ...]

    __repr__ = short_repr

    def __post_init__(self):
        scene = checked_scene(self.scene)
        object.__setattr__(self, "actors", tuple(self.actors))
        for number, actor in enumerate(self.actors):
            if not isinstance(actor, Actor):
                raise BadData(f"actor {number}: {type(actor).__name__}, wanted an Actor")
            if (actor.distance is None) != (scene.depth is None):
                has = "depth, wanted actors with a distance"
                if scene.depth is None:
                    has = "no depth, wanted actors without a distance"
                raise BadData(f"{scene.name}: actor {number}: the scene has {has}")
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
            A scene with the actors drawn into its samples or, with depth, as layers.
        """
        if self.scene.depth is not None:
            return self._add_layers(time)
        content, ratio = self.scene.content.surfaces, self.scene.samples_per_pixel
        planes = np.array(content.planes, np.promote_types(content.planes.dtype, np.float32))
        for actor in self.actors[::-1]:
            actor.onto(planes, time, ratio)
        return self.scene.stored(**{content.samples[-1]: planes})

    def _add_layers(self, time):
        """Return the scene with the actors as layers, at their places in the order of distances."""
        scene, ratio = self.scene, self.scene.samples_per_pixel
        behind = np.asarray(scene.depth)
        others = [(float(np.mean(layer.depth)), layer) for layer in scene.layers]
        layers = list(others)
        for actor in self.actors[::-1]:
            layer, distance = actor.layer(scene.content.shape, time, ratio), float(actor.distance)
            alpha = layer.alpha * (behind > distance)
            for mean, other in others:  # parts of a farther layer that are nearer than the actor
                if mean >= distance:
                    alpha = alpha * (1 - other.alpha * (np.asarray(other.depth) < distance))
            if not alpha.any():
                continue
            place = next((k for k, (mean, _) in enumerate(layers) if mean >= distance), len(layers))
            layers.insert(place, (distance, replace(layer, alpha=alpha.astype(np.float32))))
        return replace(scene, layers=tuple(layer for _, layer in layers))

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
