"""The truth of a scene with depth, float64: own sheets, own distances, visibility by rays.

A scene is cut into sheets, nearest first: its layers, and its picture, cut at jumps of the circle of
confusion. Behind a nearer sheet a picture shows nothing; the nearest farther sample continues there.
The lens and the view displace every sheet: light and coverage are band-limited between their
samples, and a distance is the nearest sample's.

Within a sheet each sample is spread with the transfer function of its own distance, field point and
wavelength: splines of degree DEGREE in the dioptres, through distances that differ by at most STEP
waves of defocus. Sheets are composed front to back, wavelength by wavelength, in a world that
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

from gpusim.domain.optics import Optics
from gpusim.domain.spectrum import Spectrum
from gpusim.judge.truth_blur import blurred_planes
from gpusim.judge.truth_field import varying_rates
from gpusim.judge.truth_light import MODES, pixel_places, placed_light, placed_nearest
from gpusim.optics.weights import electrons_per_content

JUMP = 0.5  # [sample] of the circle of confusion between neighbours: an edge that hides
STEP, MOST = 0.15, 64  # [wave] of defocus between distances, and their number
FEW = 4  # as many distances are taken as they are
DEGREE = 5
POINTS = 256  # of the pupil
TINY = 1e-4  # [radius of the pupil] of differences along it


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
    border = "reflect" if scene.border == "reflect" else "edge"
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
    circles = (1 / optics.object_distance - 1 / depth) * optics.image_distance**2
    circles = circles / (optics.working_f_number * pitch)
    place = np.digitize(circles, cuts(circles))
    for number in np.unique(place):
        nearer, at = place < number, tuple(np.indices(place.shape))
        if nearer.any():
            at = scipy.ndimage.distance_transform_edt(
                nearer, return_distances=False, return_indices=True
            )
        rows, cols = at
        found.append((light[:, rows, cols], place[rows, cols] == number, depth[rows, cols]))
    return [
        Sheet(
            placed_light(camera, scene, own * cover),
            placed_light(camera, scene, cover[None] * 1.0, is_flux=False)[0],
            placed_nearest(camera, scene, distances),
        )
        for own, cover, distances in found
    ]


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
        self.camera, self.scene, self.light = camera, scene, light
        self.distances, self.shares = shares_of(camera.optics, scene.wavelengths, sheet.depth)

    def cameras(self):
        """Yield the camera of each distance, and the light there."""
        for distance, share in zip(self.distances, self.shares, strict=True):
            optics = at_distance(self.camera.optics, distance)
            yield dataclasses.replace(self.camera, optics=optics), self.light * share

    def planes(self, border):
        """Return the mean irradiance over the pixels of every wavelength, (L, rows, cols)."""
        return sum(
            blurred_planes(light, camera, self.scene, border) for camera, light in self.cameras()
        )


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
        for own, light in _Spread(camera, scene, sheet, sheet.light).cameras():
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
    parts, farthest = [], 0.0
    for sheet in sheets:
        planes, own = np.tensordot(weights, sheet.light, 1), []
        distances, shares = shares_of(optics, scene.wavelengths, sheet.depth)
        for distance, share in zip(distances, shares, strict=True):
            rays = ray_places(at_distance(optics, distance), middle, pitch, points)
            farthest = max(farthest, float(np.abs(rays).max()))
            own.append((planes * share, sheet.cover * share, rays))
        parts.append(own)
    rim = ceil(farthest) + 8
    border: Any = "symmetric" if scene.border == "reflect" else "edge"
    around = ((rim, rim), (rim, rim))
    parts = [
        [
            (
                np.pad(planes, ((0, 0), *around), mode=MODES[scene.border]),
                np.pad(cover, around, mode=border),
                rays,
            )
            for planes, cover, rays in own
        ]
        for own in parts
    ]
    seen: float | np.ndarray = 0.0
    means: list = [[0.0, 0.0] for _ in parts]
    for point in range(points.shape[1]):
        through: float | np.ndarray = 1.0
        for own, mean in zip(parts, means, strict=True):
            light = sum(_move(planes, rays[:, point]) for planes, _, rays in own)
            cover = sum(_move(cover[None], rays[:, point])[0] for _, cover, rays in own)
            seen = seen + through * light
            through = through * (1 - np.clip(cover, 0, 1))
            mean[0], mean[1] = mean[0] + light, mean[1] + cover
    count = points.shape[1]
    settings = camera, scene, rim, middle
    apart: float | np.ndarray = 0.0
    through = 1.0
    for light, cover in means:
        apart = apart + through * _blur_in_focus(np.asarray(light) / count, *settings)
        hidden = _blur_in_focus(np.asarray(cover)[None] / count, *settings)[0]
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
    spectrum = scipy.fft.fft2(planes)
    fy, fx = (np.fft.fftfreq(n) for n in planes.shape[1:])
    s = np.minimum(np.hypot(fy[:, None], fx) * q, 1)
    round_pupil = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    spectrum = spectrum * round_pupil * np.sinc(cell[0] * fy)[:, None] * np.sinc(cell[1] * fx)
    # at the pixels' places: whole samples, and a phase for the rest
    found = spectrum
    at = [scene.margin + rim + place for place in pixel_places(camera, scene)]
    for axis, (f, places) in enumerate(zip((fy, fx), at, strict=True), 1):
        waves = np.exp(2j * np.pi * np.outer(places, f)) / len(f)
        found = np.moveaxis(np.tensordot(waves, found, (1, axis)), 0, axis)
    return found.real


def pupil_points(optics: Optics) -> np.ndarray:
    """Return points (x, y) of a pupil, even in its area, in radii: (2, POINTS or more).

    Source:
        Vogel's spiral, Mathematical Biosciences 44 (1979) 179.
    """
    pupil, count = optics.pupil, POINTS
    while True:
        number = np.arange(count) + 0.5
        radius, angle = np.sqrt(number / count), np.pi * (3 - np.sqrt(5)) * number
        inside = radius > pupil.obscuration
        if pupil.blades:
            sector = 2 * np.pi / pupil.blades
            turned = (angle - pupil.rotation) % sector - sector / 2
            inside &= radius * np.cos(turned) < np.cos(sector / 2)
        if inside.sum() >= POINTS:
            return np.stack([radius * np.cos(angle), radius * np.sin(angle)])[:, inside]
        count += POINTS // 4


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


def _move(planes, by):
    """Return planes moved by a fraction of samples, linear between them."""
    moved = [
        scipy.ndimage.shift(one, by, order=1, mode="nearest", prefilter=False) for one in planes
    ]
    return np.stack(moved)
