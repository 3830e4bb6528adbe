"""Scenes of directions: the image of a panorama behind a lens.

The samples of an equirectangular scene are directions. `view_panorama` follows the chief ray of each place of the
image to its direction. So fisheyes see beyond 90 degrees, at which a plane ends.

Radiance is conserved along rays. A lens whose image of the angle t from the axis lies at r(t) spreads the light of a
solid angle over the area r dr: a place gets radiance x f^2 sin(t) / (r dr/dt), 1 on the axis of a lens with r = f t
there. A point keeps its energy per solid angle with relative illumination "none"; with "cos4" the pupil foreshortens
by cos(t), which is the cos^4 law of a pinhole; a curve that is given is the image of an even panorama.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import ceil, pi

import numpy as np
import scipy

from gpusim.domain.calibration import Calibration, Fisheye, Framed
from gpusim.domain.camera import Camera
from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.distortion import Model, fit_to_frame, ideal
from gpusim.domain.errors import BadData, OutOfRange, checked_count
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import IMAGE, PANORAMA, Scene
from gpusim.optics.lenses import lens_of

FARTHEST = np.radians(95.0)  # from the axis: the image ends there
STEEPEST = np.radians(85.0)  # to which the cos^4 law goes: it is 0 at 90 degrees
ANGLES = 2001  # at which a fisheye's mapping is tabulated before Newton's method
NEWTON_STEPS = 4
MARGIN = 32  # [pixel] of the image around the frame, for the blur
MOST_PARTS = 8  # of a place along an axis whose mean is taken; finer panoramas are halved first
ROWS = 8  # of the image at once


def view_panorama(
    scene: Scene,
    camera: Camera,
    *,
    size: tuple[int, int] | None = None,
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    samples_per_pixel: float | None = None,
) -> Scene:
    """Return the part of a panorama that a camera sees, as an image.

    Its samples are places in the image of this lens: the frame displaces them no more, and adds
    only a relative illumination that is given. Each is the mean of the panorama over its area.

    Args:
        scene: A scene of projection "equirectangular". Its middle is ahead, its top is above; the
            columns go around once from behind by the left, and join. `fov` is the camera's
            horizontal field of view; None: from its pixels and focal length, or calibration.
        camera: The camera.
        size: Columns and rows of the frame [pixel]; None: the calibration's.
        yaw: Turns the camera to the right [rad].
        pitch: Turns it up [rad].
        roll: Turns it about its axis, clockwise as it looks [rad].
        samples_per_pixel: Samples of the image along a pixel; None: the scene's.

    Returns:
        The image, with ids of the nearest samples as labels. Beyond 95 degrees, or where the
        lens's mapping ends, it is dark; `notes` has the part of the frame.

    Raises:
        BadData: The scene is no panorama, or the frame has no size.
        OutOfRange: The cos^4 law is asked for beyond 85 degrees, or the mapping is not one to one.
        DoesNotFit: The image needs more memory than there is.
    """
    if scene.projection != PANORAMA:
        raise BadData(f'{scene.name}: view_panorama needs a scene with projection="{PANORAMA}"')
    optics, sensor = camera.optics, camera.sensor
    if size is None and isinstance(optics.distortion, Calibration):
        size = optics.distortion.width, optics.distortion.height
    if size is None:
        raise BadData(
            f"{scene.name} is a panorama and {camera.name} has no calibration with a size: "
            "give size, columns and rows of the frame"
        )
    cols, rows = (checked_count(f"size of {scene.name}", n, 1) for n in size)
    ratio = float(scene.samples_per_pixel if samples_per_pixel is None else samples_per_pixel)
    model: Model | None = None
    if optics.distortion is not None:
        model = fit_to_frame(optics.distortion, (rows, cols), sensor.pixel_pitch)
    slope = sensor.pixel_pitch / optics.image_distance
    if scene.fov:
        slope = 2 * np.tan(scene.fov / 2) / cols
    rays = _Rays(model, sensor.pixel_pitch, slope, _turn(yaw, pitch, roll))
    margin = 0 if lens_of(camera).is_pointlike else rays.margin((rows, cols), MARGIN) * ceil(ratio)
    samples = tuple(round(n * ratio) + 2 * margin for n in (rows, cols))
    content = scene.content.on_host()
    planes, spectra = _linear_planes(content)
    count = len(planes)
    needed = 4 * count * (samples[0] * samples[1] + 3 * planes[0].size)
    require_memory(f"what {camera.name} sees of {scene.name}", needed)
    levels = list(_halve(np.ascontiguousarray(np.moveaxis(planes, 0, -1))))
    out = np.zeros((count, *samples), np.float32)
    labels = {name: np.zeros(samples, label.dtype) for name, label in scene.labels.items()}
    dark, inside = 0, np.s_[margin : samples[0] - margin, margin : samples[1] - margin]
    step = 1 / ratio
    across = (np.arange(samples[1]) - (samples[1] - 1) / 2) * step
    for first in range(0, samples[0], ROWS):
        strip = slice(first, min(first + ROWS, samples[0]))
        down = (np.arange(strip.start, strip.stop) - (samples[0] - 1) / 2) * step
        own = np.isin(np.arange(strip.start, strip.stop), np.arange(samples[0])[inside[0]])
        angle = rays.angles(down[:, None], across)[own][:, inside[1]]
        dark += int((angle > FARTHEST).sum())
        _check_cos4(optics, angle)
        out[:, strip] = _average(levels, rays, optics, down, across, step)
        for name, label in scene.labels.items():
            y, x, is_seen = rays.places(down[:, None], across, label.shape)
            found = label[
                np.clip(np.rint(y), 0, len(label) - 1).astype(int),
                np.rint(x).astype(int) % label.shape[1],
            ]
            labels[name][strip] = np.where(is_seen, found, 0)
    notes = scene.notes
    if dark:
        share = 100 * dark / (rows * cols * ratio**2)
        notes = (*notes, f"the lens's image ends within the frame: {share:.3g} % of it are dark")
    seen: Content = Cube(content.wavelengths, out)
    if spectra is not None:
        seen = Basis(content.wavelengths, out, spectra)
    return replace(
        scene,
        content=seen,
        projection=IMAGE,
        image_of=lens_key(camera),
        border="scene" if margin else "edge",
        margin=margin,
        samples_per_pixel=ratio,
        notes=notes,
        labels=labels,
    )


def lens_key(camera: Camera) -> tuple:
    """Return the settings of a camera that the image of a panorama depends on."""
    optics, pitch = camera.optics, camera.sensor.pixel_pitch
    illumination = optics.relative_illumination
    kind = illumination if isinstance(illumination, str) else "given"
    # a calibration has its own focal length
    focal = None if isinstance(optics.distortion, Calibration) else optics.image_distance
    return optics.distortion, pitch, focal, kind


def _linear_planes(content: Content):
    """Planes of a content that light adds up in, float32 (K, rows, cols), and their spectra or None for a cube."""
    if content.labels is None and not hasattr(content, "maps"):
        spectra = None if content.is_spectral else content.entry_spectra
        return np.asarray(content.planes, np.float32), spectra
    return content.bands_at(slice(None)).astype(np.float32), None


def _check_cos4(optics, angle):
    steepest = float(angle[angle <= FARTHEST].max(initial=0.0))
    if optics.relative_illumination == "cos4" and steepest > STEEPEST:
        raise OutOfRange(
            "optics.relative_illumination",
            f'"cos4" with a frame that sees to {np.degrees(steepest):.3g} degrees from its axis',
            'a curve or "none" beyond 85 degrees: the cos^4 law is 0 at 90',
        )


def _average(levels, rays, optics, down, across, step):
    """Return the light of places (K, len(down), len(across)), the mean over the area of each."""
    height, width = len(down), len(across)
    # samples of the panorama in a place, by the angle between places
    ratio = rays.largest_step(down, across, step) / (pi / levels[0].shape[0])
    level = 0
    while 2 * ratio > MOST_PARTS and level + 1 < len(levels):
        level, ratio = level + 1, ratio / 2
    panorama = levels[level]
    rows, cols, count = panorama.shape
    parts = min(ceil(2 * ratio) + 1, MOST_PARTS)
    offsets = ((np.arange(parts) + 0.5) / parts - 0.5) * step
    even = not isinstance(optics.relative_illumination, str)
    lit, entries = np.zeros(height * width), []
    for dy in offsets:
        for dx in offsets:
            y, x, is_seen = rays.places(down[:, None] + dy, across + dx, (rows, cols))
            gain = np.where(is_seen, rays.gains(down[:, None] + dy, across + dx, optics), 0.0)
            lit += is_seen.ravel() / parts**2
            entries += _bilinear(y, x, gain / parts**2, (rows, cols))
    weights, samples = (np.concatenate(part) for part in zip(*entries, strict=True))
    owners = np.tile(np.arange(height * width), len(entries))
    size = height * width, rows * cols
    matrix = scipy.sparse.csr_matrix((weights.astype(np.float32), (owners, samples)), shape=size)
    seen = (matrix @ panorama.reshape(-1, count)).T
    if even:
        # the mean of the panorama, however the lens spreads it
        total = np.asarray(matrix.sum(axis=1)).ravel()
        level = rays.level * np.where(lit > 0.5, 1.0, 0.0)
        seen = seen * np.divide(level, total, out=np.zeros_like(total), where=total > 0)
    return seen.reshape(count, height, width)


def _bilinear(y, x, weights, shape):
    """Return four pairs of weights and samples of a panorama, for bilinear values; columns join at the seam.

    Beyond the poles rows go on at the other side.
    """
    rows, cols = shape
    first_y, first_x = np.floor(y).astype(int), np.floor(x).astype(int)
    v, u = y - first_y, x - first_x
    found = []
    for i, share_y in ((0, 1 - v), (1, v)):
        row = first_y + i
        is_turned = (row < 0) | (row >= rows)
        row = np.where(row < 0, -1 - row, np.where(row >= rows, 2 * rows - 1 - row, row))
        for j, share_x in ((0, 1 - u), (1, u)):
            col = (first_x + j + is_turned * (cols // 2)) % cols
            found.append(((weights * share_y * share_x).ravel(), (row * cols + col).ravel()))
    return found


def _halve(planes) -> Iterator[np.ndarray]:
    """Yield planes (rows, cols, K), and means over 2 x 2, 4 x 4 ... samples while both sides are even and long."""
    yield planes
    while min(planes.shape[:2]) >= 32 and planes.shape[0] % 2 == 0 and planes.shape[1] % 4 == 0:
        rows, cols, count = planes.shape
        planes = planes.reshape(rows // 2, 2, cols // 2, 2, count).mean(axis=(1, 3))
        yield planes


def _turn(yaw, pitch, roll):
    """Rotation of directions (right, down, ahead) of the camera into directions of the panorama, (3, 3)."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    about_down = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_right = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_axis = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return about_down @ about_right @ about_axis


class _Rays:
    """Chief rays of places in the image, in pixels from the frame's middle.

    level: light of an even panorama on the axis.
    """

    def __init__(self, model: Model | None, pitch: float, slope: float, turn: np.ndarray):
        self.model, self.pitch, self.slope, self.turn = model, pitch, slope, turn
        lens = model.lens if isinstance(model, Framed) else model
        self.fisheye = lens if isinstance(lens, Fisheye) else None
        self.level = float(self._follow(*self._axis())[1].item())

    def _axis(self):
        """Place of the optical axis."""
        if not isinstance(self.model, Framed):
            return np.zeros((1, 1)), np.zeros((1, 1))
        x, y = (np.full((1, 1), at * self.model.radius / self.pitch) for at in self.model.middle)
        return y, x

    def margin(self, shape, most):
        """Return the pixels around a frame of `shape` that the lens images too: `most`, or 0."""
        try:
            self._follow(*((n / 2 + most) * np.ones((1, 1)) for n in shape))
        except OutOfRange:
            return 0
        return most

    def angles(self, y, x):
        """Return the angles from the axis [rad]; infinite beyond the lens's image."""
        return self._follow(y, x)[2]

    def gains(self, y, x, optics):
        """Return light over radiance of places."""
        _, spread, angle = self._follow(y, x)
        if optics.relative_illumination == "cos4":
            spread = spread * np.cos(np.minimum(angle, pi / 2))
        return spread

    def places(self, y, x, shape):
        """Return row and column of a panorama of `shape` that places look at, and whether the lens images them."""
        direction, _, angle = self._follow(y, x)
        right, down, ahead = np.tensordot(self.turn, direction, 1)
        longitude, latitude = np.arctan2(right, ahead), np.arcsin(np.clip(-down, -1, 1))
        rows, cols = shape
        row = (0.5 - latitude / pi) * rows - 0.5
        return row, (0.5 + longitude / (2 * pi)) * cols - 0.5, angle <= FARTHEST

    def largest_step(self, down, across, step):
        """Return the largest angle between neighbouring places [rad]."""
        ends = [at[:: max(1, len(at) // 16)] for at in (down, across)]
        y, x = ends[0][:, None], ends[1]
        middle, _, angle = self._follow(y, x)
        apart = [
            np.linalg.norm(self._follow(y + dy, x + dx)[0] - middle, axis=0)
            for dy, dx in ((step, 0.0), (0.0, step))
        ]
        return float(np.max(np.where(angle <= FARTHEST, np.maximum(*apart), 0.0)))

    def _follow(self, y, x):
        """Directions (right, down, ahead), (3, ...), solid angle per area of the image, and angle from the axis."""
        y, x = np.broadcast_arrays(np.asarray(y, np.float64), np.asarray(x, np.float64))
        key = y.tobytes(), x.tobytes()
        if getattr(self, "_last", (None,))[0] != key:
            self._last = key, self._rays(y, x)
        return self._last[1]

    def _rays(self, y, x):
        if self.fisheye is not None:
            return self._fisheye_rays(y, x)
        jacobian = np.ones(y.shape)
        if self.model is None:
            right, down = x * self.slope, y * self.slope
        else:
            step = self.pitch / self.model.radius
            u, v = ideal(self.model, x * step, y * step)
            a, b, c, d = self.model.derivative(u, v)
            jacobian = 1 / (a * d - b * c)
            if isinstance(self.model, Framed):
                right, down = self.model.normalise(u, v)
            else:
                right, down = (part / step * self.slope for part in (u, v))
        length = np.sqrt(1 + right**2 + down**2)
        direction = np.stack([right, down, np.ones(y.shape)]) / length
        return direction, jacobian / length**3, np.arccos(np.clip(1 / length, -1, 1))

    def _fisheye_rays(self, y, x):
        """The same for a fisheye, whose image goes on beyond 90 degrees."""
        lens, step = self.fisheye, self.pitch / self.model.radius
        x, y = x * step, y * step
        if isinstance(self.model, Framed):
            x, y = self.model.normalise(x, y)
        height = np.hypot(x, y)
        angle = np.linspace(0, FARTHEST * 1.02, ANGLES)
        known, _ = _fisheye_height(lens, angle)
        turn = np.flatnonzero(np.diff(known) <= 0)
        end = turn[0] + 1 if len(turn) else ANGLES
        found = np.interp(height, known[:end], angle[:end])
        for _ in range(NEWTON_STEPS):
            value, slope = _fisheye_height(lens, found)
            change = np.divide(height - value, slope, out=np.zeros_like(found), where=slope > 0)
            found = np.clip(found + change, 0, angle[end - 1])
        _, slope = _fisheye_height(lens, found)
        sine = np.sin(found)
        # sin(t) / (r dr/dt), 1 / scale^2 on the axis
        spread = np.divide(
            sine, height * slope, out=np.full_like(height, lens.scale**-2), where=height > 1e-9
        )
        share = np.divide(
            sine, height, out=np.full_like(height, 1 / lens.scale), where=height > 1e-9
        )
        direction = np.stack([x * share, y * share, np.cos(found)])
        is_beyond = height > known[end - 1]
        return direction, spread, np.where(is_beyond, np.inf, found)


def _fisheye_height(lens: Fisheye, angle):
    """Return the image height of angles from the axis, and its derivative, in focal lengths."""
    q = angle * angle
    height = angle * (1 + q * (lens.k1 + q * (lens.k2 + q * (lens.k3 + q * lens.k4))))
    slope = 1 + q * (3 * lens.k1 + q * (5 * lens.k2 + q * (7 * lens.k3 + q * 9 * lens.k4)))
    return lens.scale * height, lens.scale * slope
