"""Labels of a scene, carried to the pixels: depth, ids, boxes and flow go where the light goes.

Axis, distortion, view, samples per pixel, displaced pixels and binning move them. Blur does not: a pixel has the labels
of the point that its middle looks at.
"""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.calibration import Framed
from gpusim.domain.camera import Camera
from gpusim.domain.distortion import Model, RadialPolynomial, fit_to_frame, ideal
from gpusim.domain.mosaics import bin_mosaic
from gpusim.domain.scene import BOXES, FLOW, IMAGE, Scene
from gpusim.optics.correction import magnification
from gpusim.optics.outside import border_indices
from gpusim.optics.sampling import frame_start

DEPTH = "depth"
SURFACE = 1.05  # neighbours whose distances differ by less are of one surface
OUTLINE = 65  # points of a side of a box
BEYOND = 1.1  # times the farthest height that the frame sees: outlines end there


def carry_labels(scene: Scene, camera: Camera) -> dict[str, np.ndarray]:
    """Return the labels of a scene at the pixels of a camera.

    A pixel has the labels of the scene point that its middle looks at. Binned pixels have theirs at
    the middle of their parts. If the processor corrects the lens, they are those of its picture: raw
    values are still where the lens puts them, and so are labels of a `gpusim.view_panorama`.
    Outside the scene labels follow its border; for border "zero" they are 0, and the depth is
    infinite.

    Args:
        scene: The scene.
        camera: The camera.

    Returns:
        "depth" [m], float32 (rows, cols), if the scene has depth: along the axis, of the nearest
        layer that covers at least half. And `scene.labels` by name: maps of whole numbers from the
        nearest sample; "flow", float32 (rows, cols, 2), in pixels; "boxes", float64 (n, 4), around
        the images of the scene's boxes, cut at the frame [pixel]. Boxes outside have no area.

    Raises:
        OutOfRange: The lens does not image the frame one to one.
    """
    if scene.depth is None and not scene.labels:
        return {}
    placing = _Placing.of(scene, camera)
    y, x = placing.sources
    carried: dict[str, np.ndarray] = {}
    if scene.depth is not None:
        carried[DEPTH] = _carry_depth(scene, y, x)
    rows, cols = _nearest(y), _nearest(x)
    for name, label in scene.labels.items():
        label = np.asarray(label)
        if name == BOXES:
            carried[name] = placing.carry_boxes(label)
        elif name == FLOW:
            moved = _look_up(label, rows, cols, scene.border, 0).astype(np.float64)
            seen = placing.image(y, x)
            after = placing.image(y + moved[..., 0], x + moved[..., 1])
            carried[name] = np.stack(np.subtract(after, seen), axis=-1).astype(np.float32)
        else:
            carried[name] = _look_up(label, rows, cols, scene.border, 0)
    return carried


@dataclass(frozen=True, eq=False)
class _Placing:
    """Places of a scene's samples and of a camera's pixels.

    Places of samples and pixels are indices: 0 is the middle of the first one. Samples include the margin.
    """

    scene: Scene
    distortion: Model | None
    pitch: float  # [m] of samples
    displacement: tuple[float, float]
    binning: tuple[int, int]
    pixels: tuple[np.ndarray, np.ndarray]  # middles of binned pixels, in indices of the sensor's

    @classmethod
    def of(cls, scene: Scene, camera: Camera) -> "_Placing":
        optics, sensor = camera.optics, camera.sensor
        distortion: Model | None = None
        if scene.projection == IMAGE:  # displaced already
            distortion = None
        elif camera.processor.corrects_lens:  # the picture of a pinhole, magnified
            displaced = sensor.displacement
            zoom = magnification(optics, scene.shape, sensor.pixel_pitch, displaced)
            distortion = RadialPolynomial(0.0, 0.0, sensor.pixel_pitch, 1 / zoom)
        elif optics.distortion is not None:
            distortion = fit_to_frame(optics.distortion, scene.shape, sensor.pixel_pitch)
        stride, _ = bin_mosaic(sensor.cfa_indices, sensor.binning)
        pixels = [
            _middles(n, parts, step)
            for n, parts, step in zip(scene.shape, sensor.binning, stride, strict=True)
        ]
        return cls(
            scene,
            distortion,
            sensor.pixel_pitch / scene.samples_per_pixel,
            sensor.displacement,
            sensor.binning,
            (pixels[0], pixels[1]),
        )

    @property
    def sources(self):
        """Places in the scene that the pixels look at, two arrays (rows, cols)."""
        y, x = np.meshgrid(*self.pixels, indexing="ij")
        return self.source(y, x)

    def source(self, y, x):
        """Return the places in the scene that places of the sensor look at."""
        y, x = (
            (place - shift) / step
            for place, shift, step in zip((y, x), *self._pixels_of_samples(), strict=True)
        )
        if self.distortion is not None:
            step = self.pitch / self.distortion.radius
            x, y = (part / step for part in ideal(self.distortion, x * step, y * step))
        y, x = self.scene.view.place(y, x, self.scene.samples_per_pixel)
        return y + self._middle[0], x + self._middle[1]

    def image(self, y, x):
        """Return the places on the sensor of places in the scene, in binned pixels."""
        y, x = self.scene.view.locate(
            y - self._middle[0], x - self._middle[1], self.scene.samples_per_pixel
        )
        if self.distortion is not None:
            step = self.pitch / self.distortion.radius
            x, y = (part / step for part in self.distortion.distort(x * step, y * step))
        return tuple(
            (place * step + shift + 0.5) / parts - 0.5
            for place, shift, step, parts in zip(
                (y, x), *self._pixels_of_samples(), self.binning, strict=True
            )
        )

    @property
    def _middle(self):
        return [(n - 1) / 2 for n in self.scene.content.shape]

    def _pixels_of_samples(self):
        """Pixel at the middle of the samples, and pixels per sample, of both axes."""
        ratio = float(self.scene.samples_per_pixel)
        shifts = [
            (n / 2 - frame_start(n, pixels, ratio)) / ratio - 0.5 - move
            for n, pixels, move in zip(
                self.scene.samples, self.scene.shape, self.displacement, strict=True
            )
        ]
        return shifts, [1 / ratio] * 2

    def carry_boxes(self, boxes):
        """Return the boxes around the images of boxes, cut at the frame, (n, 4)."""
        share = np.linspace(0, 1, OUTLINE)
        sides = np.concatenate(
            [
                [share, 0 * share],
                [share, 0 * share + 1],
                [0 * share, share],
                [0 * share + 1, share],
            ],
            axis=1,
        )
        limits = [len(places) for places in self.pixels]
        found = np.empty((len(boxes), 4))
        for out, (top, left, bottom, right) in zip(found, np.asarray(boxes, float), strict=True):
            y = top + (bottom - top) * sides[0] - 0.5
            x = left + (right - left) * sides[1] - 0.5
            ends = [
                np.clip((at.min() + 0.5, at.max() + 0.5), 0, limit)
                for at, limit in zip(self.image(*self._within_sight(y, x)), limits, strict=True)
            ]
            out[:] = ends[0][0], ends[1][0], ends[0][1], ends[1][1]
        return found

    def _within_sight(self, y, x):
        """Places moved toward the axis until the lens images them: just beyond the frame."""
        if self.distortion is None:
            return y, x
        rows, cols = self.scene.shape
        edge = [np.linspace(-0.5, n - 0.5, OUTLINE) for n in (rows, cols)]
        around = (
            np.concatenate(
                [edge[0], edge[0], np.full(OUTLINE, -0.5), np.full(OUTLINE, rows - 0.5)]
            ),
            np.concatenate(
                [np.full(OUTLINE, -0.5), np.full(OUTLINE, cols - 0.5), edge[1], edge[1]]
            ),
        )
        seen = self.source(*around)
        down, across = self._axis()
        farthest = BEYOND * np.hypot(seen[0] - down, seen[1] - across).max()
        height = np.hypot(y - down, x - across)
        share = np.minimum(1.0, farthest / np.maximum(height, 1e-9))
        return down + share * (y - down), across + share * (x - across)

    def _axis(self):
        """Place in the scene that lies on the optical axis."""
        y = x = 0.0
        if isinstance(self.distortion, Framed):
            x, y = (at * self.distortion.radius / self.pitch for at in self.distortion.middle)
        y, x = self.scene.view.place(y, x, self.scene.samples_per_pixel)
        return y + self._middle[0], x + self._middle[1]


def _middles(count, parts, stride):
    """Middles of binned pixels along an axis of `count` pixels, in indices of the sensor's."""
    number = np.arange(count // (stride * parts) * stride)
    block, first = np.divmod(number, stride)
    return block * stride * parts + first + stride * (parts - 1) / 2


def _nearest(places):
    return np.floor(places + 0.5).astype(int)


def _look_up(values, rows, cols, border, outside):
    """Return values at indices, continued by the rule of a border; `outside` beyond border "zero"."""
    rule = "edge" if border == "scene" else border
    y, x = (
        border_indices(at, n, rule) for at, n in zip((rows, cols), values.shape[:2], strict=True)
    )
    found = values[y, x]
    if border == "zero":
        found[(y != rows) | (x != cols)] = outside
    return found


def _carry_depth(scene, y, x):
    """Return the depth at places, float32: linear in 1 / depth on a surface, else of the nearest sample."""
    depth = np.asarray(scene.depth, np.float64)
    for layer in reversed(scene.layers):
        depth = np.where(layer.alpha >= 0.5, layer.depth, depth)
    rows, cols = np.floor(y).astype(int), np.floor(x).astype(int)
    near = np.array(
        [
            [_look_up(depth, rows + i, cols + j, scene.border, np.inf) for j in (0, 1)]
            for i in (0, 1)
        ]
    )
    v, u = y - rows, x - cols
    with np.errstate(divide="ignore"):
        inverse = np.einsum("iyx,jyx,ijyx->yx", [1 - v, v], [1 - u, u], 1 / near)
        is_surface = near.max(axis=(0, 1)) < SURFACE * near.min(axis=(0, 1))
        nearest = _look_up(depth, _nearest(y), _nearest(x), scene.border, np.inf)
        return np.where(is_surface, 1 / inverse, nearest).astype(np.float32)
