"""A light field from a scene with depth: the scene as pinholes in the entrance pupil see it."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
import scipy

from gpusim.captures.parallax import LOST, Surface, find_places, list_surfaces, order_layers
from gpusim.domain.camera import Camera
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import BadData, OutOfRange, checked_count
from gpusim.domain.light_field import LightField, cell_centres
from gpusim.domain.memory import require_memory
from gpusim.domain.progress import announce_each
from gpusim.domain.scene import Layer, Scene, checked_scene

BORDERS = {"zero": "constant", "edge": "edge", "reflect": "symmetric", "scene": "edge"}
FARTHEST = 1e9  # [m] stands for infinity: parallax against infinity below 1e-6 samples
RIM = 12  # samples after which the ends of a spline's filter are forgotten: 0.268^12 = 1e-7
MOST_VIEWS = 101  # along one axis
LEAST_NOTED = 5e-5  # share of a view: less is not noted


def light_field(
    scene: Scene,
    camera: Camera,
    views: Sequence[int] = (9, 9),
    spread: float = 1.0,
) -> LightField:
    """Return a scene as pinholes in the entrance pupil of a camera see it.

    A sample at the distance D is displaced by -d / (2 N_w) (x, y) at the sensor, see `LightField`.
    As for its blur, the pitch of the camera's pixels makes samples of it, whatever the scene's field
    of view. Nearer things hide farther ones. Behind them the scene's layers are seen if it has any; a
    map of distances is cut into surfaces at its jumps, and each continues behind the nearer ones with
    the light and the distance of its nearest sample. A note of each view says how much of it is
    continued.

    Samples are interpolated by cubic splines. A Cube and a Basis keep their form. Materials and
    pictures become a Basis of the same spectra, because samples between two surfaces mix both; light
    that varies over the scene becomes a Cube. Labels are left out.

    Args:
        scene: The scene, with depth.
        camera: The camera, for its pupil, focus, and pixels.
        views: Rows and columns of views, T and S.
        spread: Half the side of the grid in radii of the entrance pupil. 1 covers the pupil; cells
            in its corners are outside a circular one.

    Returns:
        The light field, aligned at the camera's object distance.

    Raises:
        BadData: The scene has no depth, or `views` is no pair.
        OutOfRange: A number is out of its range, or the parallax is larger than the picture.
        DoesNotFit: The views do not fit into memory.
    """
    checked_scene(scene)
    if scene.depth is None:
        raise BadData(
            f"{scene.name}: a light field needs the scene's depth, a number for each sample"
        )
    if not isinstance(views, Sequence | np.ndarray) or len(views) != 2:
        raise BadData(f"views = {views!r}: wanted two numbers, rows and columns of views")
    shape = (
        checked_count("views: rows", views[0], most=MOST_VIEWS),
        checked_count("views: columns", views[1], most=MOST_VIEWS),
    )
    if not (isinstance(spread, int | float | np.number) and 0 < spread < 1e3):  # also refuses NaN
        raise OutOfRange("spread", spread, "0 < spread < 1000, in radii of the pupil")
    optics, pitch = camera.optics, camera.sensor.pixel_pitch / scene.samples_per_pixel
    radius = spread * optics.focal_length / (2 * optics.f_number)
    focal, vergence = optics.image_distance / pitch, 1 / optics.object_distance
    # things that a pinhole at (y, x) displaces by + focal (y, x) (1 / D - vergence), a camera at -(y, x) does
    moves = -radius * np.pad(cell_centres(shape), ((0, 0), (0, 0), (0, 1))).reshape(-1, 3)
    scene = _make_finite(scene)
    reach = focal * np.abs(moves).max() * _largest_vergence(scene, vergence)
    if not reach < max(scene.content.shape):
        raise OutOfRange(
            "parallax of the light field",
            f"{reach:.4g} samples",
            f"less than the picture's {max(scene.content.shape)}; use a smaller spread",
        )
    sheets = list_surfaces(scene, focal, np.abs(moves).max(axis=0))
    samples = len(sheets) * sheets[0].alpha.size * (len(sheets[0].content.planes) + 2)
    require_memory(f"{scene.name} in {shape[0]} x {shape[1]} views", 4 * samples * (len(moves) + 1))
    rim = ceil(reach) + RIM
    splines = [_Spline(sheet, BORDERS[scene.border], rim) for sheet in sheets]

    def look(move):
        return _view(scene, splines, focal, move, vergence)

    with ThreadPoolExecutor(count_cores()) as pool:
        seen = announce_each(pool.map(look, moves), lambda done: f"views, {done} of {len(moves)}")
        found = iter(list(seen))
    rows = tuple(tuple(next(found) for _ in range(shape[1])) for _ in range(shape[0]))
    return LightField(rows, float(radius), float(optics.object_distance), scene.name)


def _make_finite(scene):
    """Return a scene with FARTHEST for infinite distances, without labels."""
    layers = tuple(
        replace(layer, depth=np.minimum(layer.depth, FARTHEST)) for layer in scene.layers
    )
    left_out = (f"labels left out of views: {', '.join(scene.labels)}",) if scene.labels else ()
    return replace(
        scene,
        depth=np.minimum(scene.depth, FARTHEST),
        layers=layers,
        labels={},
        notes=scene.notes + left_out,
    )


def _largest_vergence(scene, vergence):
    """Return the largest difference of a reciprocal distance from `vergence` [1/m]."""
    depths = [scene.depth, *(layer.depth for layer in scene.layers)]
    ends = [end for depth in depths for end in (np.min(depth), np.max(depth))]
    return float(np.abs(1 / np.array(ends, np.float64) - vergence).max())


def _view(scene, splines, focal, move, vergence):
    """Return the scene from one place. splines: surfaces, nearest first."""
    layers, continued, through = [], 0.0, 1.0
    for spline in splines:
        planes, alpha, depth, known = spline.look_from(focal, move, vergence)
        continued = continued + through * alpha * (1 - known)
        through = through * (1 - alpha)
        layers.append(Layer(spline.content.with_planes(planes), alpha, depth))
    *front, back = layers
    notes, share = scene.notes, float(np.mean(continued))
    if share > LEAST_NOTED:
        notes += (f"hidden surfaces continued in {share:.2%} of this view",)
    return replace(
        scene,
        content=back.content,
        depth=np.asarray(back.depth),
        layers=tuple(layer for layer in order_layers(front, back.depth) if layer.alpha.any()),
        notes=notes,
    )


class _Spline:
    """A surface to be seen from many places: its samples with a rim, filtered once.

    border: how `np.pad` continues it. rim: width [sample].
    """

    def __init__(self, sheet: Surface, border: Any, rim: int):
        around = ((rim, rim), (rim, rim))
        planes = np.asarray(sheet.content.planes, np.float32)
        self.content, self.depth, self.rim = sheet.content, sheet.depth, rim
        self.is_positive, self.is_flat = planes.min() >= 0, np.ptp(sheet.depth) == 0
        self.planes = np.pad(planes, ((0, 0), *around), border)
        for axis in (1, 2):
            scipy.ndimage.spline_filter1d(self.planes, 3, axis, self.planes, "mirror")
        self.alpha = np.pad(np.asarray(sheet.alpha, np.float32), around, border)
        self.known = np.pad(np.asarray(sheet.known, np.float32), around, "edge")

    def look_from(self, focal, move, vergence):
        """Return light, coverage, distance and share of known light as a camera at `move` sees them."""
        if self.is_flat:
            depth, shift = self.depth, focal * move[:2] * (1 / self.depth[0, 0] - vergence)
            planes = self._displace(self.planes, shift, _cubic)
            alpha, known = self._displace(np.stack([self.alpha, self.known]), shift, _linear)
        else:
            places, depth, error = find_places(self.depth, focal, move, vergence)
            places = places + self.rim
            planes = np.stack([_interpolate(one, places, 3) for one in self.planes])
            alpha, known = (_interpolate(one, places, 1) for one in (self.alpha, self.known))
            known = np.where(error > LOST, 0, known)
        if self.is_positive:
            np.maximum(planes, 0, out=planes)  # splines ring next to steps
        return planes, np.clip(alpha, 0, 1), depth, np.clip(known, 0, 1)

    def _displace(self, values, shift, weigh):
        """Return values at places displaced by one shift (down, right) [sample], without the rim."""
        for axis, length in zip((1, 2), shift, strict=True):
            whole = int(np.floor(length))
            weights = weigh(length - whole)
            first = self.rim + whole + 1 - len(weights) // 2
            count = values.shape[axis] - 2 * self.rim
            parts = (
                np.float32(weight) * np.moveaxis(values, axis, 1)[:, first + k : first + k + count]
                for k, weight in enumerate(weights)
            )
            values = np.moveaxis(sum(parts), 1, axis)
        return np.ascontiguousarray(values)


def _cubic(part):
    """Return the weights of a cubic B-spline at a part of a sample after the second of four."""
    near, far = part, 1 - part
    return (
        far**3 / 6,
        2 / 3 - near**2 + near**3 / 2,
        2 / 3 - far**2 + far**3 / 2,
        near**3 / 6,
    )


def _linear(part):
    """Return the weights of two neighbours."""
    return 1 - part, part


def _interpolate(values, places, order):
    """Return values at places, float32; values of order 3 are filtered."""
    return scipy.ndimage.map_coordinates(
        values, places, np.float32, order, mode="nearest", prefilter=False
    )
