"""The truth of a scene with depth, float64: own sheets, own distances, visibility by rays.

A scene is cut into sheets, nearest first: its layers, and its picture, cut at jumps of the circle of
confusion. Behind a nearer sheet a picture shows nothing; the nearest farther sample continues there.
The lens and the view displace every sheet: light and coverage are band-limited between their
samples, and a distance is the nearest sample's.

Within a sheet each sample is spread with the transfer function of its own distance, field point and
wavelength: splines of degree DEGREE in the dioptres, through distances that differ by at most STEP
waves of defocus. A slanted surface turns more of its area to one side of the pupil than to the
other, so that a uniform wall has a uniform picture at any slope: distances share the gradients of
the light, not the light (`divide`). Sheets are composed front to back, wavelength by wavelength, in a world that
continues to infinity. The product of spreads leaves out that sheets are hidden and seen through the
same points of the pupil, and that a point's light is hidden before it is spread. That covariance is
the difference of two images: of geometrical optics by rays through POINTS points of the pupil, with
the visibility at each point, blurred by the lens in focus; and the composition of each sheet's mean
light and coverage, blurred so.
"""

import dataclasses
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
import scipy

from gpusim.data.weights import electrons_per_content
from gpusim.domain.optics import Optics
from gpusim.domain.spectrum import Spectrum
from gpusim.judge.truth_blur import blurred_planes
from gpusim.judge.truth_field import varying_rates
from gpusim.judge.truth_light import MODES, pixel_places, placed_light, placed_nearest
from gpusim.judge.truth_mask import is_inside, light_of_mask

JUMP = 0.5  # [sample] of the circle of confusion between neighbours: an edge that hides
STEP, MOST = 0.15, 64  # [wave] of defocus between distances, and their number
FEW = 4  # as many distances are taken as they are
DEGREE = 5
POINTS = 256  # of the pupil
MANY = 16  # times as many, of which those of a mask are chosen
FAR = 64  # [sample] around images that diffraction blurs
RIM = 32  # [sample] around a scene of several distances
TINY = 1e-4  # [radius of the pupil] of differences along it
TIMES = 8  # that the source of a ray is corrected: each leaves less than JUMP of the error


@dataclass(frozen=True, eq=False)
class Sheet:
    """A sheet in the image.

    Attributes:
        light: Light times coverage of every wavelength, (L, rows, cols).
        cover: Coverage, (rows, cols).
        depth: Distances [m], (rows, cols).
    """

    light: np.ndarray
    cover: np.ndarray
    depth: np.ndarray


def at_distance(optics: Optics, distance: float) -> Optics:
    """Return a lens that spreads light from the plane in focus as `optics` does from a distance.

    Args:
        optics: The lens.
        distance: [m].
    """
    more = (1 / optics.object_distance - 1 / distance) * optics.image_distance**2
    defocus = optics.defocus
    if isinstance(defocus, Spectrum):
        return dataclasses.replace(
            optics, defocus=Spectrum(defocus.wavelengths, defocus.values + more, defocus.name)
        )
    return dataclasses.replace(optics, defocus=defocus + more)


def depth_rates(camera, scene, parts, is_uniform) -> list[np.ndarray]:
    """Return electrons per second of every channel before fall-off, one array (C, h, w) per part.

    Args:
        camera: The camera.
        scene: A scene with depth.
        parts: Parts of the frame, pairs of slices.
        is_uniform: Whether the blur is the same all over the field.
    """
    sheets = sheets_of(camera, scene)
    weights = electrons_per_content(scene, camera)
    axis = dataclasses.replace(camera, optics=camera.optics.on_axis())
    border = _of_surfaces(scene.border)
    lit = [_Spread(axis, scene, sheet, sheet.light) for sheet in sheets]
    total, through = np.zeros((len(weights), *scene.shape)), 1.0
    covers = []
    for number, sheet in enumerate(sheets):
        own = lit[number].planes(scene.border)
        if number < len(sheets) - 1:
            same = np.broadcast_to(sheet.cover, sheet.light.shape)
            covers.append(_Spread(axis, scene, sheet, same).planes(border))
        total += np.tensordot(weights, through * own, 1)
        if number < len(sheets) - 1:
            through = through * (1 - np.clip(covers[-1], 0, 1))
    if len(sheets) > 1:
        total += hidden_difference(axis, scene, sheets, weights)
    found = [total[:, *part] for part in parts]
    if not is_uniform:
        _add_varying(found, camera, scene, sheets, covers, parts)
    return found


def sheets_of(camera, scene) -> list[Sheet]:
    """Return the sheets of a scene, nearest first, where the lens and the view put them."""
    content = scene.content.on_host()
    light, depth = content.bands_at(slice(None)), np.asarray(scene.depth, np.float64)
    found = []
    for layer in scene.layers:
        own = np.broadcast_to(np.asarray(layer.depth, np.float64), depth.shape)
        alpha = np.asarray(layer.alpha, np.float64)
        found.append((layer.content.on_host().bands_at(slice(None)), alpha, own))
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel
    optics = camera.optics
    circles = circles_of(optics, pitch, depth)
    place = np.digitize(circles, cuts(circles))
    for number in np.unique(place):
        rows, cols = _nearest(place < number)
        found.append((light[:, rows, cols], place[rows, cols] == number, depth[rows, cols]))
    return [
        Sheet(
            placed_light(camera, scene, own * cover),
            placed_light(camera, scene, cover[None] * 1.0, is_flux=False)[0],
            placed_nearest(camera, scene, distances[_nearest(cover == 0)]),
        )
        for own, cover, distances in found
    ]


def _nearest(missing):
    """Return the indices of the nearest sample that is not missing, for each sample."""
    if not missing.any() or missing.all():
        return tuple(np.indices(missing.shape))
    found = scipy.ndimage.distance_transform_edt(
        missing, return_distances=False, return_indices=True
    )
    return tuple(found)


def circles_of(optics: Optics, pitch: float, depth) -> np.ndarray:
    """Return the signed circle of confusion at distances [m], in samples of `pitch` [m].

    Args:
        optics: The lens.
        pitch: Distance of the samples [m].
        depth: Distances [m].
    """
    moved = (1 / optics.object_distance - 1 / depth) * optics.image_distance**2
    return moved / (optics.working_f_number * pitch)


def cuts(circles: np.ndarray) -> list[float]:
    """Return the fewest circles of confusion [sample] between all neighbours that differ by JUMP.

    Args:
        circles: Signed circles of confusion, (rows, cols).

    Source:
        The greedy algorithm for stabbing intervals.
    """
    apart = []
    for axis in (0, 1):
        pair = np.delete(circles, 0, axis).ravel(), np.delete(circles, -1, axis).ravel()
        apart.append(np.sort(np.stack(pair), axis=0))
    low, high = np.concatenate(apart, axis=1)
    jumps = high - low > JUMP
    low, high = low[jumps], high[jumps]
    found: list[float] = []
    while len(low):
        end = high.min()
        start = low[low < end].max()  # all intervals that begin before `end` contain this gap
        found.append(float((start + end) / 2))
        inside = low < found[-1]
        low, high = low[~inside], high[~inside]
    return found


class _Spread:
    """The light of a sheet at the pixels, from the distances of its samples."""

    def __init__(self, camera, scene, sheet, light):
        self.camera, self.scene, self.sheet, self.light = camera, scene, sheet, light

    def cameras(self, border, rim):
        """Yield the camera of each distance, and the light there, with `rim` samples around it."""
        optics, around = self.camera.optics, ((rim, rim), (rim, rim))
        depth = np.pad(self.sheet.depth, around, mode=MODES[_of_surfaces(border)])
        distances, shares = shares_of(optics, self.scene.wavelengths, depth)
        light = np.pad(self.light, ((0, 0), *around), mode=MODES[border])
        for distance, share in zip(distances, shares, strict=True):
            own = at_distance(optics, distance)
            yield dataclasses.replace(self.camera, optics=own), divide(light, share)

    def planes(self, border):
        """Return the mean irradiance over the pixels of every wavelength, (L, rows, cols)."""
        scene, rim = self.scene, self._rim(border)
        if rim:
            content = scene.content.on_host()
            content = content.with_samples(lambda one: np.pad(one, _around(one, rim), mode="edge"))
            scene = dataclasses.replace(
                scene,
                content=content,
                margin=scene.margin + rim,
                border="scene",
                depth=None,
                layers=(),
                labels={},
            )
        return sum(
            blurred_planes(light, camera, scene, border)
            for camera, light in self.cameras(border, rim)
        )

    def _rim(self, border):
        """Return the samples around the scene in which the light that has one distance is not only its own."""
        if border == "reflect" or len(np.unique(self.sheet.depth)) == 1:
            return 0
        optics, sensor = self.camera.optics, self.camera.sensor
        pitch = sensor.pixel_pitch / self.scene.samples_per_pixel
        return RIM + ceil(np.abs(circles_of(optics, pitch, self.sheet.depth)).max())


def divide(light: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the part of the light that is spread from one of the distances of a surface.

    Let c(s) be the circle of confusion at s. A ray through the point u of the pupil takes the light L
    of s to x = s + u c(s), and a surface shows the area 1 + u . grad c of a sample to u. With k(c) the
    spread of a sample, g(c) that with each point of the pupil times u, and G(c) the integral of g from
    0 to c, k(c) = k(0) - div G(c), so that the picture of L is

        sum over s of L (k + grad c . g) = k(0) * L - sum over s of grad L . G(x - s, c(s)).

    Uniform light remains uniform. Of distances that share G, each has the sum over its share of
    grad L . G: the same as the spread of a light M with laplacian M = div (share grad L), if G has no
    curl, as for a round pupil. The parts of all distances add up to L.

    Args:
        light: Light, (L, rows, cols). Beyond it, its mirror image follows.
        share: Share of the distance in each sample, (rows, cols).
    """
    if np.ptp(share) == 0:
        return light * share.flat[0]
    laplacian, total = np.zeros(share.shape), np.zeros(light.shape)
    for axis in (1, 2):
        wave = _waves(light.shape, axis)
        laplacian = laplacian - wave**2
        total = total + scipy.fft.idct(_flow(light, share, axis) * wave, axis=axis)
    laplacian[0, 0] = 1.0
    series = scipy.fft.dctn(total, axes=(1, 2)) / laplacian
    series[:, 0, 0] = 0
    found = scipy.fft.idctn(series, axes=(1, 2))
    outermost = np.ones(share.shape, bool)
    outermost[1:-1, 1:-1] = False
    level = (light * share - found)[:, outermost].mean(axis=1)
    return found + level[:, None, None]


def _flow(light, share, axis):
    """Return the sine series of the share times the light's derivative along an axis, between the samples.

    The derivative is of the cosine series through the samples.
    """
    n = light.shape[axis]
    found = np.zeros(light.shape)
    if n < 2:
        return found
    inner = [slice(None)] * 3
    inner[axis] = slice(1, None)
    series = -scipy.fft.dct(light, axis=axis) * _waves(light.shape, axis)
    slope = scipy.fft.idst(series[*inner], 1, axis=axis)
    low, high = np.take(share, range(n - 1), axis - 1), np.take(share, range(1, n), axis - 1)
    found[*inner] = scipy.fft.dst((low + high) / 2 * slope, 1, axis=axis)
    return found


def _waves(shape, axis):
    """Return the factors by which derivatives along an axis multiply a cosine series.

    Near the shortest wave, where those of the next one alias, they stop to grow: a point that lies on
    a slope would ring with it.
    """
    f = np.arange(shape[axis]) / shape[axis]  # [half cycle/sample]
    waves = np.pi * f * (1 - f**6 / 7)
    return waves[:, None] if axis == 1 else waves


def _of_surfaces(border):
    """Return the rule by which surfaces go on: in the dark, too."""
    return "reflect" if border == "reflect" else "edge"


def _around(array, rim):
    return [(0, 0)] * (array.ndim - 2) + [(rim, rim)] * 2


def shares_of(optics: Optics, wavelengths, depth) -> tuple[list[float], list[np.ndarray]]:
    """Return distances [m], and the share of each sample in the spread of each, arrays like depth.

    Args:
        optics: The lens.
        wavelengths: [nm].
        depth: Distances of samples [m].
    """
    levels = np.unique(depth)
    if len(levels) <= FEW:
        return levels.tolist(), [(depth == level) * 1.0 for level in levels]
    near = 1 / depth
    low, high = near.min(), near.max()
    per_wave = 8 * optics.working_f_number**2 * np.min(wavelengths) * 1e-9
    waves = (high - low) * optics.image_distance**2 / per_wave
    count = int(np.clip(ceil(waves / STEP) + 1, DEGREE + 2, MOST))
    nodes = np.linspace(low, high, count)
    spline = scipy.interpolate.make_interp_spline(nodes, np.eye(count), DEGREE)
    shares = spline(np.clip(near, low, high))
    return (1 / nodes).tolist(), list(np.moveaxis(shares, -1, 0))


def _add_varying(found, camera, scene, sheets, covers, parts):
    """Add the difference of a blur that varies from the blur on the axis, to parts of the frame.

    Sheets in front are taken as for the blur on the axis.
    """
    middle = len(scene.wavelengths) // 2
    through = 1.0
    for number, sheet in enumerate(sheets):
        for own, light in _Spread(camera, scene, sheet, sheet.light).cameras(scene.border, 0):
            if not light.any():
                continue
            rates = varying_rates(light, own, scene, parts)
            for total, more, part in zip(found, rates, parts, strict=True):
                total += more * (through if isinstance(through, float) else through[part])
        if number < len(covers):
            through = through * (1 - np.clip(covers[number][middle], 0, 1))


def hidden_difference(camera, scene, sheets, weights) -> np.ndarray:
    """Return the covariance of visibility over the pupil: electrons per second (C, rows, cols).

    Args:
        camera: The camera, with the blur on its axis.
        scene: The scene.
        sheets: Sheets of the scene, nearest first.
        weights: Electrons per content, (C, L).
    """
    optics, pitch = camera.optics, camera.sensor.pixel_pitch / scene.samples_per_pixel
    middle = float(scene.wavelengths[len(scene.wavelengths) // 2])
    points = pupil_points(optics)
    ends = np.array([extreme(one.depth) for one in sheets for extreme in (np.min, np.max)])
    rim = ceil(np.abs(_rays(optics, middle, pitch, points, ends)).max()) + 8
    border: Any = "symmetric" if scene.border == "reflect" else "edge"
    around = ((rim, rim), (rim, rim))
    parts = []
    for sheet in sheets:
        planes = np.tensordot(weights, sheet.light, 1)
        planes = np.pad(planes, ((0, 0), *around), mode=MODES[scene.border])
        cover = np.pad(sheet.cover, around, mode=border)
        parts.append(
            (np.concatenate([planes, cover[None]]), np.pad(sheet.depth, around, mode=border))
        )
    seen: float | np.ndarray = 0.0
    means: list = [0.0 for _ in parts]
    for point in points.T:
        through: float | np.ndarray = 1.0
        for number, (planes, depth) in enumerate(parts):
            rays = _rays(optics, middle, pitch, point[:, None], depth)
            *light, cover = _look(planes, rays)
            seen = seen + through * np.stack(light)
            through = through * (1 - np.clip(cover, 0, 1))
            means[number] = means[number] + np.stack([*light, cover])
    count = points.shape[1]
    settings = camera, scene, rim, middle
    apart: float | np.ndarray = 0.0
    through = 1.0
    for mean in means:
        *light, hidden = _blur_in_focus(mean / count, *settings)
        apart = apart + through * np.stack(light)
        through = through * (1 - np.clip(hidden, 0, 1))
    return _blur_in_focus(np.asarray(seen) / count, *settings) - apart


def _blur_in_focus(planes, camera, scene, rim, wavelength):
    """Return planes (C, rows, cols) at the pixels, blurred by the lens in focus."""
    cell = [
        side / camera.sensor.pixel_pitch * scene.samples_per_pixel
        for side in camera.sensor.aperture
    ]
    q = wavelength * 1e-9 * camera.optics.working_f_number / camera.sensor.pixel_pitch
    q = q * scene.samples_per_pixel
    # what comes from farther is the same for both images
    planes = np.pad(planes, _around(planes, FAR), mode="edge")
    spectrum = scipy.fft.fft2(planes)
    fy, fx = (np.fft.fftfreq(n) for n in planes.shape[1:])
    s = np.minimum(np.hypot(fy[:, None], fx) * q, 1)
    round_pupil = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    spectrum = spectrum * round_pupil * np.sinc(cell[0] * fy)[:, None] * np.sinc(cell[1] * fx)
    # at the pixels' places: whole samples, and a phase for the rest
    found = spectrum
    at = [scene.margin + rim + FAR + place for place in pixel_places(camera, scene)]
    for axis, (f, places) in enumerate(zip((fy, fx), at, strict=True), 1):
        waves = np.exp(2j * np.pi * np.outer(places, f)) / len(f)
        found = np.moveaxis(np.tensordot(waves, found, (1, axis)), 0, axis)
    return found.real


def pupil_points(optics: Optics) -> np.ndarray:
    """Return points (x, y) of a pupil, as dense as its light, in radii: (2, POINTS or more).

    Source:
        Vogel's spiral, Mathematical Biosciences 44 (1979) 179.
    """
    pupil, count = optics.pupil, POINTS
    while True:
        number = np.arange(count) + 0.5
        radius, angle = np.sqrt(number / count), np.pi * (3 - np.sqrt(5)) * number
        places = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
        light = is_inside(pupil, *places) * light_of_mask(pupil, *places)
        if pupil.mask is None and light.sum() >= POINTS:
            return places[:, light > 0]
        if light.sum() >= MANY * POINTS:  # as dense as the light
            wanted = (np.arange(POINTS) + 0.5) / POINTS * light.sum()
            return places[:, np.searchsorted(np.cumsum(light), wanted)]
        count += POINTS // 4 if pupil.mask is None else count


def ray_places(optics: Optics, wavelength: float, pitch: float, points) -> np.ndarray:
    """Return where rays through points of the pupil meet the image, (2, N) (rows, cols) [sample].

    Args:
        optics: The lens, for the plane in focus.
        wavelength: [nm].
        pitch: Distance of the samples [m].
        points: Points (x, y) of the pupil, (2, N).
    """
    waves = optics.waves(np.array([wavelength]))[0]
    q = wavelength * 1e-9 * optics.working_f_number / pitch
    x, y = points

    def value(x, y):
        return np.polynomial.polynomial.polyval2d(x, y, waves)

    down = value(x, y + TINY) - value(x, y - TINY)
    across = value(x + TINY, y) - value(x - TINY, y)
    return -2 * q * np.stack([down, across]) / (2 * TINY)


def _rays(optics, wavelength, pitch, points, depth):
    """Return where rays of samples at distances meet the image, from each sample, (2, N, *levels) [sample].

    It is linear in the dioptres. levels: the shape of the distances, or of one.
    """
    depth = np.unique(depth) if np.ptp(depth) == 0 else depth
    focus = 1 / optics.object_distance
    ends = [
        ray_places(at_distance(optics, distance), wavelength, pitch, points)
        for distance in (optics.object_distance, 1 / (focus + 1))
    ]
    near = 1 / depth - focus  # [m-1]
    return np.add.outer(ends[0], 0 * near) + np.multiply.outer(ends[1] - ends[0], near)


def _look(planes, rays):
    """Return the light of planes (C, rows, cols) that a point of the pupil sends to each sample.

    Rays of sample s meet s + rays(s), linear between samples: the source of a place is found by
    iteration, which converges as neighbours differ by less than a sample.
    """
    if rays.shape[1:] == (1, 1):
        return _move(planes, rays[:, 0, 0])
    rays = rays[:, 0]
    at = np.indices(planes.shape[1:], float)
    source = at - rays
    for _ in range(TIMES):
        moved = [_between(one, source) for one in rays]
        source = at - moved
    return np.stack([_between(one, source) for one in planes])


def _between(values, places):
    return scipy.ndimage.map_coordinates(values, places, order=1, mode="nearest")


def _move(planes, by):
    """Return planes moved by a fraction of samples, linear between them."""
    moved = [
        scipy.ndimage.shift(one, by, order=1, mode="nearest", prefilter=False) for one in planes
    ]
    return np.stack(moved)
