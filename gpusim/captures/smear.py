"""A scene as it falls on the sensor during an exposure in motion, as one scene of its mean light.

All of a frame up to its noise is linear in the light of the scene. So the mean over an exposure of many pictures is
one picture of the scene's mean light: sample p of that scene is the mean of the scene along the path of p, from the
opening to the closing of its row. Two methods compute it:

- `convolve`: the path has nearly one shape for all samples. The scene is convolved with that shape by its exact
  transfer function, and each sample then looks at the middle of its own path.
- `accumulate`: views of the scene are added up. Each sample looks where it is at that part of its own exposure.

A lens gathers the light of neighbouring rows, which open at other times. `Path.shear_error` is the error that this
adds behind a rolling shutter.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.domain.account import Bound
from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.distort import distort
from gpusim.kernels.optics.falloff import falloff
from gpusim.kernels.sensor.shutter import shutter
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.highlights import TRANSFORM_ERROR
from gpusim.optics.lengths import fft_length
from gpusim.optics.outside import border_indices
from gpusim.optics.ripples import places_among, ripple, world_ripples
from gpusim.optics.shutter import shutter_weights
from gpusim.pipeline.reading import planes, store
from gpusim.planner.probes import SIDE, Probes

PIECES = (1, 2, 4, 8, 16, 32, 64)  # straight pieces of a path
FINEST = 256  # pieces that count as the path itself
STRAIGHT = 1e-5  # error of a transfer function for which pieces count as the path
CHECKED = 5  # rows and columns of samples whose paths are compared
NODES = 17, 5  # rows and columns of nodes of `optics.distort`: rows also stand for times
SPARE = 128  # [sample] around a path for the tails of its interpolation, if these are cut
FADE = 32  # [sample] over which the light beyond, and tails that are not cut, fade
TAPS = 4  # [sample] around a place for its interpolation
# points of Gauss along a line, and the longest [sample] for which they give the means of waves of half a cycle a
# sample to 1e-8
GAUSS = {1: 6e-4, 2: 0.026, 3: 0.166, 4: 0.457, 5: 0.881, 7: 2.0}
CHUNK = 8  # views that are added up at once


@dataclass(frozen=True, eq=False)
class Path:
    """Places in the scene that the samples of a frame look at during their exposures.

    Attributes:
        scene: The scene.
        motion: Motion of the camera.
        start: Time at which the first row opens [s].
        seconds: Exposure time [s].
        row_time: Time from row to row [s].
        flicker: Flicker of the light, on the clock of the motion, or None.
    """

    scene: Scene
    motion: Motion
    start: float
    seconds: float
    row_time: float
    flicker: Flicker | None = None

    def opens(self, y) -> np.ndarray:
        """Return when samples open [s]. y: their rows from the middle of the frame [sample]."""
        row = (np.asarray(y) + self.scene.samples[0] / 2) / self.scene.samples_per_pixel - 0.5
        return self.start + self.row_time * row

    def places(self, y, x, part) -> np.ndarray:
        """Return places of samples in the scene [sample], shape (2, ..., rows, cols), relative to the middle.

        Args:
            y: Rows of the samples in the frame, relative to the middle [sample].
            x: Columns.
            part: Part of the exposure that has passed, 0 .. 1: a number, or shape (..., 1).
        """
        times = (self.opens(y) + part * self.seconds)[..., None]
        ratio = self.scene.samples_per_pixel
        return np.array(self.motion.places(times, np.asarray(y)[:, None], np.asarray(x), ratio))

    def light(self, y: float, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the share of the light of a row's exposure between consecutive parts of it, and where its middle is.

        The shares have the sum 1. A middle is between 0 and 1, the ends of its piece.
        """
        share, middle = np.diff(parts), np.full(len(parts) - 1, 0.5)
        if self.flicker is None:
            return share, middle
        times = parts * self.seconds
        light, moment = map(np.diff, self.flicker.since(float(self.opens(y))).integrals(times))
        total = light.sum()
        if not total > 0:
            return share, middle
        lit = light > 1e-9 * total
        middle[lit] = ((moment[lit] / light[lit] - times[:-1][lit]) / np.diff(times)[lit]).clip(
            0, 1
        )
        return light / total, middle

    @cached_property
    def sample_grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the samples whose paths are compared."""
        spread = np.linspace(-0.5, 0.5, CHECKED)
        rows, cols = self.scene.samples
        return spread * (rows - 1), spread * (cols - 1)

    @cached_property
    def points(self) -> np.ndarray:
        """Paths of the checked samples, shape (FINEST + 1, 2, rows, cols)."""
        parts = np.linspace(0, 1, FINEST + 1)[:, None]
        return self.places(*self.sample_grid, parts).swapaxes(0, 1)

    @cached_property
    def middles(self) -> np.ndarray:
        """Middles of the paths, as nodes for `optics.distort`."""
        parts = np.linspace(0, 1, FINEST + 1)
        y, _ = _edges(self.scene.content.shape, NODES)
        light, middle = np.array([self.light(row, parts) for row in y]).swapaxes(0, 1)
        along = _nodes(self, parts[:, None])  # (points, rows, cols, 3)
        found = np.einsum("yk,kyxi->yxi", light * (1 - middle), along[:-1])
        return found + np.einsum("yk,kyxi->yxi", light * middle, along[1:])

    @cached_property
    def is_common(self) -> bool:
        """True if the middles of all paths are displaced alike."""
        moves = self.middles[..., :2].reshape(-1, 2)
        return bool(np.ptp(moves, axis=0).max() < 1e-6)

    @property
    def common(self) -> np.ndarray:
        """Displacement of the middle of the middle sample's path [sample]."""
        return self.middles[NODES[0] // 2, NODES[1] // 2, :2]

    def worlds(self, is_whole: bool) -> "tuple[_World, _World]":
        """Return the world of both axes, see `convolve`."""
        points, own = self.middle_shape[0], self.middles - np.array([*np.rint(self.common), 0])
        shape, border, found = self.scene.content.shape, _border(self.scene), []
        for axis, edges in enumerate(_edges(shape, NODES)):
            n, spare = shape[axis], 0
            if not self.is_common:
                places = own[..., axis] + (edges[:, None] if axis == 0 else edges)
                spare = TAPS + max(0, ceil(np.abs(places).max() - n / 2))
            path = ceil(np.abs(points[:, axis]).max()) + 1
            found.append(_World.of(n, border, spare, path, is_whole))
        return found[0], found[1]

    @property
    def length(self) -> float:
        """Length of the longest path in the frame [sample]."""
        zoom = max(self.motion.at(self.start).zoom, self.motion.at(self.start + self.seconds).zoom)
        steps = np.diff(self.points, axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum(axis=0).max()) * zoom

    def shape(self, row: int, col: int, pieces: int) -> tuple[np.ndarray, ...]:
        """Return points of a checked sample's path relative to its middle, and `light` of the pieces."""
        parts = np.linspace(0, 1, pieces + 1)
        points = self.points[:: FINEST // pieces, :, row, col]
        light, middle = self.light(self.sample_grid[0][row], parts)
        mean = (light * (1 - middle)) @ points[:-1] + (light * middle) @ points[1:]
        return points - mean, light, middle

    @cached_property
    def pieces(self) -> int:
        """Fewest pieces that the middle sample's path consists of."""
        true = _probe(*self.shape(CHECKED // 2, CHECKED // 2, FINEST))
        for count in PIECES:
            if (
                np.abs(_probe(*self.shape(CHECKED // 2, CHECKED // 2, count)) - true).max()
                < STRAIGHT
            ):
                break
        return count

    @property
    def middle_shape(self) -> tuple[np.ndarray, ...]:
        """The shape of the middle sample's path."""
        return self.shape(CHECKED // 2, CHECKED // 2, self.pieces)

    @cached_property
    def spectrum(self) -> np.ndarray:
        """Transfer function of the middle sample's path at the frequencies of probes."""
        return _probe(*self.middle_shape)

    def shape_error(self, probes: Probes) -> Bound:
        """Return the error of one shape for all samples."""
        worst, places = np.zeros(self.spectrum.shape), np.ndindex(CHECKED, CHECKED)
        shapes = [self.shape(row, col, FINEST) for row, col in places]
        # each shape once
        for shape in {
            np.round(np.concatenate([*map(np.ravel, own)]), 9).tobytes(): own for own in shapes
        }.values():
            np.maximum(worst, np.abs(_probe(*shape) - self.spectrum), out=worst)
        return self._of_mean(probes, probes.bound(probes.exact * worst.astype(np.float32)))

    def shear_error(self, probes: Probes, displaced: float = 0.0) -> Bound:
        """Return the error of light from other rows, which is taken at the time of its own row.

        The lens's kernels are sheared: a row d samples away is d times the camera's step from row to row off.

        Args:
            probes: Probes of the scene at rest.
            displaced: Rows by which the lens displaces the picture, at most [sample].
        """
        step = self.row_time / self.scene.samples_per_pixel / self.seconds
        moves = (self.points[-1] - self.points[0]).reshape(2, -1) * step
        down, right = moves[:, np.hypot(*moves).argmax()]
        if not (down or right):
            return Bound()
        y, x = np.meshgrid(
            np.fft.fftfreq(SIDE, 1 / SIDE), np.arange(SIDE // 2 + 1.0), indexing="ij"
        )
        places = np.stack([y + down * y + right * x, x])
        sheared = np.stack(
            [
                scipy.ndimage.map_coordinates(one, places, order=1, mode="grid-wrap")
                for one in probes.tables
            ]
        )
        seen = replace(probes, light=probes.light.times(self.spectrum))
        bounds = [seen.bound(replace(seen, tables=sheared).exact - seen.exact)]
        if displaced:
            bounds.append(seen.shift_error(displaced * float(np.hypot(down, right))))
        return self._of_mean(probes, sum_errors(bounds))

    def cut_error(self, probes: Probes, is_whole: bool) -> Bound:
        """Return the error of `convolve`: of ripples from afar that are cut, and of float32 transforms.

        Args:
            probes: Probes of the scene at rest.
            is_whole: As of `convolve`.
        """
        light = probes.brightness
        if light is None or not probes.level > 0:
            return Bound()
        size = np.sqrt(np.mean(np.square(light, dtype=np.float64)))
        bounds = [probes.even_error(float(TRANSFORM_ERROR * size / probes.level))]
        places, weights = _instants(*self.middle_shape)
        for axis, world in enumerate(self.worlds(is_whole)):
            if world.is_cut:
                part = (weights * np.sin(np.pi * places[axis])) @ _waves(places[1 - axis]).T
                cut = world.cut_ripples(light.shape[axis], _border(self.scene))
                bounds.append(probes.everywhere([probes.see_ripples(axis, cut, np.abs(part))]))
        return self._of_mean(probes, sum_errors(bounds))

    def view_error(self, probes: Probes, is_convolved: bool) -> Bound:
        """Return the error of interpolated places. Fourier transforms displace without error."""
        if is_convolved and self.is_common:
            return Bound()
        view = self.motion.at(self.start + self.seconds / 2)
        left = np.abs(self.spectrum)
        seen = replace(probes, light=probes.light.times(self.spectrum), path=left)
        return seen.resampling_error(view, self.scene.samples_per_pixel)

    def _of_mean(self, probes, bound):
        """Return a bound relative to the mean light, which has less contrast than the scene."""
        before = probes.windows.weight @ np.square(probes.signal).mean(axis=(1, 2, 3))
        seen = replace(probes, light=probes.light.times(self.spectrum))
        after = probes.windows.weight @ np.square(seen.signal).mean(axis=(1, 2, 3))
        factor = float(np.sqrt(before / after)) if 0 < after < before else 1.0
        return replace(bound, rms=bound.rms * factor)


def convolve(device: Device, path: Path, is_whole: bool = True) -> Scene:
    """Return the mean light by one transfer function. See the module.

    Args:
        device: Device that computes it.
        path: The path.
        is_whole: Whether ripples count however far they come from. Else they are cut if that costs less, see
            `Path.cut_error`.

    Returns:
        A scene in host memory, with a plain view.
    """
    scene, border = path.scene, _border(path.scene)
    content, light, response = _mix(device, scene.content)
    points, *shares = path.middle_shape
    nodes, common = path.middles, path.common
    own = nodes - np.array([*np.rint(common), 0])
    if path.is_common:  # the fraction of the displacement is part of the transfer function
        points = points + (common - np.rint(common))
        own[..., :2] = 0
    worlds = path.worlds(is_whole)
    shape = tuple(one.length for one in worlds)
    first = [one.first for one in worlds]
    whole = np.zeros((4, 4, 3))
    whole[..., :2], whole[..., 2] = np.rint(common) - first, 1
    wide = distort(light, device.array(whole[None]), shape, border, device=device)
    if any(one.is_weighted for one in worlds):
        wide = falloff(wide, np.outer(*(one.weights for one in worlds))[None], device=device)
    (y, x), weights = _instants(points, *shares)
    kernel = (worlds[0].waves(y) * weights) @ worlds[1].waves(x).T
    table = scipy.fft.rfft2(kernel, workers=-1).view(np.float64).astype(np.float32)
    table, one, found = device.array(table[None, None]), np.ones((1, 1), np.float32), []
    for plane in range(light.shape[0]):
        single = device.reshape(device.part(wide, plane), (1, *shape))
        smeared = blur(single, table, one, "edge", shape, device=device)
        found.append(device.reshape(smeared, shape))
    own[..., :2] += first
    smeared = _look(device, device.stack(found), own, response, border, content.shape)
    return _scene(device, scene, content, smeared)


@dataclass(frozen=True, eq=False)
class _World:
    """The light along an axis that a transform repeats.

    Attributes:
        length: Of the transform [sample].
        first: Place of the scene's first sample in it.
        weights: Of the light at each place, float32 (length,).
        period: After which the world of the kernel repeats itself [sample]; inf: never.
        is_cut: Whether ripples from beyond are left out.
    """

    length: int
    first: int
    weights: np.ndarray
    period: float
    is_cut: bool = False

    @classmethod
    def of(cls, n: int, border: str, spare: int, path: int, is_whole: bool) -> "_World":
        """Return the world of an axis of n samples.

        Args:
            n: Samples of the scene.
            border: Its border.
            spare: Samples around the scene that are wanted as well.
            path: Samples that a path goes from its middle.
            is_whole: Whether ripples count however far they come from. Else only if that costs no more.
        """
        length = fft_length(n + 2 * (spare + path + SPARE + FADE))
        cut = cls(length, (length - n) // 2, _fade(length), length, True)
        if border == "reflect":
            # any period of the mirrored world, between nothing, in the middle of a longer transform
            before = n // 2
            length = fft_length(3 * n + 2 * spare + 3)
            first = (length - n) // 2
            weights = np.zeros(length, np.float32)
            weights[first - before : first - before + 2 * n] = 1
            whole = cls(length, first, weights, 2 * n)
            for times in range(2 * n, length, 2 * n):
                if times >= n + 2 * spare and fft_length(times) == times:
                    ones = np.ones(times, np.float32)
                    whole = cls(times, (times - n) // 2, ones, times)
                    break
        else:  # dark or even beyond, so without ripples: they come from the scene's samples only
            length = fft_length(n + 2 * spare + max(n + 2 * FADE, 2 * path + 4 * FADE))
            whole = cls(length, (length - n) // 2, _fade(length), np.inf)
        return whole if is_whole or whole.length <= cut.length else cut

    @property
    def is_weighted(self) -> bool:
        """True if not all of the light counts."""
        return bool((self.weights != 1).any())

    def waves(self, places: np.ndarray) -> np.ndarray:
        """Return a sample's band-limited light at places from it, as a transform counts them: (length, n)."""
        at = np.fft.fftfreq(self.length, 1 / self.length)[:, None]
        away = at + places
        if self.period == np.inf:
            left = np.clip((self.length / 2 - np.abs(at)) / FADE, 0, 1)
            return np.sinc(away) * _smooth(left)
        away -= self.period * np.rint(away / self.period)
        turn = away / self.period
        found = np.sinc(away) / np.sinc(turn)
        return found * np.cos(np.pi * turn) if self.period % 2 == 0 else found

    def cut_ripples(self, n: int, border: str) -> np.ndarray:
        """Return the ripples of n unit samples that are cut, see `world_ripples`."""
        at, wide = places_among(n), np.arange(self.length) - self.first
        if border == "reflect":
            used = self.weights * (1 - 2 * (wide % 2)) * ripple(at - wide, self.length)
            found = world_ripples(at, n, border)
            np.subtract.at(found.T, border_indices(wide, n, border), used.T)
            return found
        used = world_ripples(at, n, border, period=self.length)
        return world_ripples(at, n, border) - used


def _fade(size):
    """Return weights of `size` samples: 1, and 0 at both ends. Their first three derivatives are continuous."""
    at = np.arange(size)
    return _smooth(np.clip(np.minimum(at, size - 1 - at) / FADE, 0, 1)).astype(np.float32)


def _smooth(part):
    """Return a step from 0 to 1 whose first three derivatives are continuous."""
    return part**4 * (35 - 84 * part + 70 * part**2 - 20 * part**3)


def accumulate(device: Device, path: Path, count: int) -> Scene:
    """Return the mean light as a sum of views, linear between them. See the module.

    Args:
        device: Device that computes it.
        path: The path.
        count: Number of views, 2 or more.

    Returns:
        A scene in host memory, with a plain view.
    """
    scene, parts = path.scene, np.linspace(0, 1, count)
    content, light, response = _mix(device, scene.content)
    rows, cols = content.shape
    if path.flicker is None:
        own = shutter_weights(parts, 1, 1.0, 0.0)
        weights = np.repeat(own, rows, 0)
    else:
        opens = path.opens(np.arange(rows) - (rows - 1) / 2)
        times = parts * path.seconds
        weights = np.concatenate(
            [
                shutter_weights(times, 1, path.seconds, 0.0, 0.0, path.flicker.since(float(one)))
                for one in opens
            ]
        )
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    total = None
    for first in range(0, count, CHUNK):
        views = [
            _look(device, light, _nodes(path, part), response, _border(scene), content.shape)
            for part in parts[first : first + CHUNK]
        ]
        own = weights[:, first : first + CHUNK]
        if total is not None:
            views.insert(0, total)
            own = np.column_stack([np.ones(rows), own])
        stacked = device.reshape(device.stack(views), (len(views), light.shape[0] * rows, cols))
        total = shutter(stacked, np.tile(own, (light.shape[0], 1)), device=device)
        total = device.reshape(total, (light.shape[0], rows, cols))
    return _scene(device, scene, content, total)


def _probe(points: np.ndarray, light: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return the transfer function of a mean along a path of straight pieces at the frequencies of probes.

    A wave exp(2 pi i f x) becomes its mean along the path times itself.

    Args:
        points: Ends of the pieces, places looked at relative to the sample, shape (n + 1, 2).
        light: Share of the light of each piece, shape (n,).
        middle: Where the middle of that light is between the ends of the piece, 0 .. 1.

    Returns:
        Complex, shape (SIDE, SIDE // 2 + 1).
    """
    places, weights = _instants(points, light, middle)
    down, right = map(_waves, places)
    down = np.concatenate(
        [down[:-1], down[:0:-1].conj()]
    )  # half a cycle a sample is the lower of both
    return (down * weights) @ right.T


def _waves(places):
    """Return waves of 0 .. SIDE // 2 cycles to SIDE samples at places, complex (SIDE // 2 + 1, n)."""
    steps = np.repeat(np.exp(2j * np.pi / SIDE * places)[None], SIDE // 2 + 1, axis=0)
    steps[0] = 1
    return np.multiply.accumulate(steps)


def _instants(points, light, middle):
    """Return places on a path, (2, n), and weights: sums that are the means of waves along it.

    The light of a piece is even around its middle.
    """
    step = np.diff(points, axis=0)
    longest = float(np.abs(step).sum(axis=1).max())
    parts = max(1, ceil(longest / max(GAUSS.values())))
    count = next(n for n, most in GAUSS.items() if longest / parts <= most)
    nodes, mass = (own / (2 * parts) for own in np.polynomial.legendre.leggauss(count))
    along = ((np.arange(parts) + 0.5) / parts - 0.5)[:, None] + nodes
    at = middle[:, None] + along.ravel()
    places = points[:-1, :, None] + step[..., None] * at[:, None]
    weights = light[:, None] * np.tile(mass, parts)
    return places.swapaxes(0, 1).reshape(2, -1), weights.ravel()


def sum_errors(bounds: list[Bound]) -> Bound:
    """Return errors of one cause in several parts together."""
    return Bound(*(sum(figures) for figures in zip(*(one.figures for one in bounds), strict=True)))


def _border(scene):
    """Return how the samples of a scene go on outside."""
    return "edge" if scene.border == "scene" else scene.border


def mixing_form(content: Content) -> Content:
    """Return content without light of the form that interpolates.

    Materials become the planes of their spectra, or of the wavelengths if these are fewer.

    Args:
        content: The content.

    Returns:
        A Basis or a Cube of zeros.
    """
    spectra = content.entry_spectra
    many = content.labels is not None and len(spectra) > spectra.shape[1]
    if content.is_spectral or many:
        shape = len(content.wavelengths), *content.shape
        return Cube(content.wavelengths, np.broadcast_to(np.float32(0), shape))
    samples = np.broadcast_to(np.float32(0), (len(spectra), *content.shape))
    return Basis(content.wavelengths, samples, spectra)


def _mix(device, content) -> tuple[Content, Any, np.ndarray]:
    """Return the form of content that interpolates, its planes on the device, and the brightness of each plane."""
    form, table = mixing_form(content), None
    if content.labels is not None:
        spectra = content.entry_spectra
        table = spectra.T if form.is_spectral else np.eye(len(spectra))
    light = planes(device, table, store(device, content))
    return form, light, form.entry_spectra.sum(axis=1)


def _scene(device, scene, content, light) -> Scene:
    """Return a scene with other planes of light."""
    values = np.array(device.numpy(light), np.float32)
    made = replace(scene, content=content)
    return made.stored(**{content.samples[-1]: values})


def _look(device, light, nodes, response, border, shape):
    """Return planes (planes, *shape) as seen at the places of nodes."""
    bright = integrate(light, np.asarray(response, np.float32)[None], device=device)
    return distort(light, device.array(nodes[None]), shape, border, light=bright, device=device)


def _edges(shape, nodes):
    """Return the rows and columns of nodes, from edge to edge of the samples, relative to the middle."""
    return [np.linspace(-n / 2, n / 2, one) for n, one in zip(shape, nodes, strict=True)]


def _nodes(path, part):
    """Return nodes for `optics.distort` at parts of each sample's exposure, see `Path.places`."""
    y, x = _edges(path.scene.content.shape, NODES)
    places = path.places(y, x, part)
    return np.stack([places[0] - y[:, None], places[1] - x, np.ones_like(places[0])], axis=-1)
