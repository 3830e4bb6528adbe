"""The world outside the frame: how its far parts add to the blur, and how much of it takes part.

A transform is periodic: beyond its period it repeats the picture instead of following the border
rule. The error of this depends on the lens only by its tail. The rim of a pupil of any shape and
wavefront spreads, in the mean over directions and rings, the energy

    perimeter / (2 pi^3 area) q / r^3   per square sample at the distance r

(the transform of the cusp of the transfer function at 0, whose slope is twice the mean width of the
pupil over its area; by Cauchy the mean width of an outline is its perimeter over pi). For a circle
it is q / (pi^3 r^3). Light from far away is smooth, so a coarse grid is enough for it. Straight
blades throw their light along their normals, as r^-2.
"""

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from math import ceil, prod, sqrt
from typing import Any

import numpy as np
import scipy
from scipy.special import j1

from gpusim.optics.windows import MOST_STEPS, Windows, take_windows

BORDER_REACH = 64  # [pixel] of surroundings on each side that take part in the blur, unless a tolerance needs more
# Most samples of a transform that is made longer for a tolerance: this number, or so many times the frame's
MOST_SAMPLES, MOST_TIMES = 2**22, 14
LINE_CELLS = 12  # of the coarse grid along a reach where light goes along lines
# of the coarse grid along a reach, and a period: keep the predicted error to a tenth
CELLS = 4
LEAST_CELLS = 64
PROBED = 128  # samples along an axis at which it is predicted
# A world that repeats itself after some periods differs from an endless one by powers of its width: light of a picture
# that continues is equal on both sides of a pixel but for its place between them; light on black falls as r^-3
POWERS = {"edge": (2, 3), "zero": (3, 5), "reflect": ()}
# A blur changes the root mean square of a frame whose maximum is so many times larger, or that is small, or whose
# neighbours are less similar: mean product over mean square
SPIKY, FEW, ALIKE = 10.0, 2**14, 0.8
FARTHEST = 8  # times the distance from which light counts as far: its end
# their number; samples of a side, and of a side of the part that represents others
WINDOWS = 12
WINDOW = 128
INNER = 48
FREQUENCIES = tuple(np.fft.rfftfreq(WINDOW))  # of windows, along both axes [1/sample]
# part of the reach from which on a disc of light takes the place of the tail's series
GEOMETRIC = 0.7


def rule_of(border: str) -> str:
    """Return the rule that continues the outermost samples; for a scene with own surroundings it is "edge"."""
    return "edge" if border == "scene" else border


def border_indices(at, n: int, border: str) -> np.ndarray:
    """Return which of n samples each place of an axis shows; places beyond follow the border rule.

    With "zero" they show the outermost sample, which the caller must darken.
    """
    if border == "reflect":
        return np.minimum(at % (2 * n), (-1 - at) % (2 * n))
    return np.clip(at, 0, n - 1)


def unseen_light(
    image,
    period,
    border: str,
    cell: float,
    tail: float,
    disc: float = 0.0,
    times=(1, 3, 5),
    soft: float = 1.0,
    rays: tuple[float, ...] = (),
    straight: float = 0.0,
) -> np.ndarray:
    """Return the difference of an endless world from a transform's periodic one, at the cells of a coarse grid.

    Args:
        image: Light of the frame, or of frame and margin, shape (rows, cols).
        period: Rows and columns of the transform, with the image in the middle [sample].
        border: "zero", "edge" or "reflect".
        cell: About the side of a cell [sample].
        tail: Energy of a point per square sample times r^3.
        disc: Radius of an additional even disc of energy 1 [sample]; 0: none.
        times: Periods that the computed worlds span, odd; the endless world is extrapolated
            from them.
        soft: Cells within which the tail is softened. Steps ring on the grid, by some 1e-6 at 1
            and not at 2.
        rays: Angles of the lines through a point along which a part of its tail goes, from the
            columns' direction on [rad].
        straight: That part of the tail.

    Returns:
        The cells of one period; `at_samples` interpolates between them.
    """
    powers = POWERS[border]
    times = times[-len(powers) - 1 :]
    high, wide = _cells(period, cell)
    steps = period[0] / high, period[1] / wide
    widest, soft = max(times), soft * max(steps)
    world = _coarse(image, period, (high, wide), border, widest)
    worlds = {}  # middle periods of worlds that repeat themselves after `count` periods
    for count in {1, *times}:
        around, middle = (widest - count + 1) // 2, count // 2
        rows = slice(around * high, (around + count) * high)
        part = world[rows, around * wide : (around + count) * wide]
        kernel = _kernel((count * high, count * wide), steps, tail, disc, soft, rays, straight)
        spectrum = scipy.fft.rfft2(part) * kernel.astype(part.dtype)
        # the other rows are not needed
        rows = scipy.fft.ifft(spectrum, axis=0)[middle * high : (middle + 1) * high]
        part = scipy.fft.irfft(rows, part.shape[1])
        worlds[count] = part[:, middle * wide : (middle + 1) * wide]
    columns = np.array(times, float)[:, None] ** -np.array((0.0, *powers))
    weights = np.linalg.solve(columns.T, np.eye(len(times))[0])
    endless = sum(weight * worlds[count] for weight, count in zip(weights, times, strict=True))
    return endless - worlds[1]


def _cells(shape, cell):
    """Rows and columns of a grid over `shape` samples with cells of about this side."""
    return max(1, round(shape[0] / cell)), max(1, round(shape[1] / cell))


def _coarse(image, period, cells, border, wide):
    """Means over the cells of a world of `wide` periods, (rows, cols)."""
    down, below = _means(image.shape[0], period[0], cells[0], border, wide, image.dtype)
    across, beside = _means(image.shape[1], period[1], cells[1], border, wide, image.dtype)
    return (across @ (down @ image).T).T[below[:, None], beside]


def at_samples(coarse, shape, period, rows, cols) -> np.ndarray:
    """Return `unseen_light` for an image of `shape` at samples `rows` x `cols`, which may lie around it."""
    down, across = (
        _spline_weights(count, (((length - n) // 2 + at + 0.5) * count / length - 0.5).tobytes())
        for n, length, at, count in zip(shape, period, (rows, cols), coarse.shape, strict=True)
    )
    return (across @ (down @ scipy.ndimage.spline_filter(coarse, mode="grid-wrap")).T).T


@lru_cache(maxsize=32)
def _spline_weights(count, places):
    """Weights of the coefficients of a periodic cubic spline through `count` cells, at places."""
    places = np.frombuffer(places)[None]
    weights = [
        scipy.ndimage.map_coordinates(cell, places, order=3, mode="grid-wrap", prefilter=False)
        for cell in np.eye(count)
    ]
    return scipy.sparse.csr_array(np.stack(weights, axis=1))


def seen_light(image, deviation: float, margin: int, border: str) -> tuple[float, float]:
    """Return the root mean square and the maximum of the frame as a lens shows it.

    Args:
        image: Light of the frame with its margin, shape (rows, cols).
        deviation: Of the Gaussian that approximates the lens if few pixels hold the light
            [sample].
        margin: Samples around the frame.
        border: The scene's border.
    """
    inside = _inside(image, margin)
    # float64: no square of float32 overflows
    level = sqrt(np.einsum("ij,ij->", inside, inside, dtype=np.float64) / inside.size)
    highest = inside.max(initial=0)
    is_smooth = inside.size > FEW and highest <= SPIKY * level and _likeness(inside) > ALIKE
    if is_smooth or not deviation or not level > 0:
        return float(level), float(highest)
    blurred = _blur_to_pixels(inside, deviation, "constant" if border == "zero" else "reflect")
    return sqrt(np.square(blurred, dtype=np.float64).mean()), float(blurred.max())


def _likeness(image):
    """Mean product of neighbours along some rows and columns, over the mean square; the smaller of the two."""
    found = []
    for whole in (image, image.T):
        some = np.ascontiguousarray(whole[:: len(whole) // PROBED + 1])
        found.append(np.vdot(some[:, 1:], some[:, :-1]) / max(np.vdot(some, some), 1e-300))
    return float(min(found))


def _blur_to_pixels(image, deviation, mode):
    """The image blurred by a Gaussian and integrated over pixels, which keeps points below a lens's peak.

    mode: of `scipy.ndimage`, for the surroundings.
    """
    edges = np.arange(ceil(4 * deviation) + 1) + 0.5
    inside = scipy.special.erf(edges / (sqrt(2) * deviation))
    half = np.diff(inside) / 2
    weights = np.concatenate([half[::-1], inside[:1], half]) / inside[-1]
    down = scipy.ndimage.correlate1d(image, weights, 0, mode=mode)
    return scipy.ndimage.correlate1d(down, weights, 1, mode=mode)


def spread_afar(image, border: str, margin: int, tail: float, distance: float) -> np.ndarray:
    """Return the light that comes to the frame from farther than `distance`, minus the light that leaves so far.

    Args:
        image: Light of the frame, or of frame and margin, shape (rows, cols).
        border: "zero", "edge" or "reflect".
        margin: Samples around the frame.
        tail: Energy of a point per square sample times r^3.
        distance: [sample].

    Returns:
        Light on a coarse grid.
    """
    reach, (rows, cols) = int(FARTHEST * CELLS), image.shape
    modes: dict[str, Any] = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}
    high, wide = _cells(image.shape, distance / CELLS)
    coarse = _coarse(image, image.shape, (high, wide), "edge", 1).astype(np.float64)
    world = np.pad(coarse, reach, mode=modes[border])
    at = np.arange(-reach, reach + 1)
    radius = np.hypot(at[:, None] * rows / high, at * cols / wide)
    area = rows * cols / (high * wide)
    kernel = np.where(radius > distance, tail * area / np.maximum(radius, distance) ** 3, 0)
    spectrum = scipy.fft.rfft2(world) * scipy.fft.rfft2(kernel, world.shape)
    light = scipy.fft.irfft2(spectrum, world.shape)[2 * reach :, 2 * reach :]
    light -= kernel.sum() * coarse
    above, left = round(margin / rows * high), round(margin / cols * wide)
    return light[above : high - above, left : wide - left]


@dataclass(frozen=True, eq=False)
class Outside:
    """Facts about a scene from which the planner decides how much of the surroundings takes part in the blur.

    Attributes:
        image: Light of the frame, or of frame and margin, without highlights that are added one
            by one, shape (rows, cols).
        border: The scene's border.
        margin: The scene's margin [sample].
        tail: Energy of a point per square sample times r^3.
        spread: Radius within which the rays of a point meet the image [sample].
        level: Root mean square of the frame.
        noise: Variance of the read noise over the electrons at that level.
        missing: Light that every sample is known to lack.
        around: Samples on each side whose mean approximates the light that a lens mixes.
        rays: Lines along which a part of the tail goes, see `unseen_light`.
        straight: That part of the tail.
        deviation: Of the Gaussian that approximates the lens [sample].
        is_moved: Whether the frame is a view of the scene.
    """

    image: np.ndarray
    border: str
    margin: int
    tail: float
    spread: float
    level: float
    noise: float
    missing: float = 0.0
    around: int = 0
    rays: tuple[float, ...] = ()
    straight: float = 0.0
    deviation: float = 0.0
    is_moved: bool = False
    _windows: dict = field(init=False, repr=False, default_factory=dict)
    held: dict = field(init=False, repr=False, default_factory=dict)

    def at(self, noise: float) -> "Outside":
        """Return the facts for another read noise. What does not depend on it is computed once for all."""
        made = copy(self)
        object.__setattr__(made, "noise", noise)
        for name in ("darkest", "_probes"):
            made.__dict__.pop(name, None)
        return made

    @cached_property
    def is_spiky(self) -> bool:
        """Whether few points are far brighter than the frame."""
        return bool(self.image.max(initial=0) > SPIKY * self.level)

    def error(self, period, reach: float) -> tuple[float, float, float]:
        """Return the relative RMS error from light that a transform does not see, and its extremes in noise.

        Each point of the rim spreads light about the place where its ray lands, a distance b away
        in the mean over the rim: the tail is (r^2 + b^2) / (r (r^2 - b^2)^2) in place of r^-3. If b
        comes near the reach, a disc replaces the part within.

        Args:
            period: Rows and columns of the transform [sample].
            reach: Samples around the image that follow the border rule.

        Returns:
            Relative RMS; 99.9 % quantile and maximum, which times the root of the electrons at
            the level are in sigma.
        """
        if not (self.level > 0 and self.tail):
            return 0.0, 0.0, 0.0
        near = min(self.spread / reach, GEOMETRIC) ** 2
        disc = self.spread if self.spread > GEOMETRIC * reach else 0.0
        cell = max(min(reach / (LINE_CELLS if self.rays else CELLS), max(period) / LEAST_CELLS), 1)
        rule = rule_of(self.border)
        tail = self.tail * (1 + near) / (1 - near) ** 2
        coarse = unseen_light(
            self.image, period, rule, cell, tail, disc, rays=self.rays, straight=self.straight
        )
        rows, cols, sigma = self._probes
        lost = at_samples(coarse, self.image.shape, period, rows, cols) + self.missing
        error = np.abs(lost) / self.level
        rms = float(np.sqrt((error**2).mean()))
        sigmas = error / sigma
        return rms, float(np.quantile(sigmas, 0.999)), float(sigmas.max())

    def brighter(self, period) -> float:
        """Return the root mean square of a transform's input of this period over the frame's, at least 1."""
        if self.border == "zero" or not self.level > 0:
            return 1.0
        counts = []  # of the places of a period that show each row, and each column
        for n, length in zip(self.image.shape, period, strict=True):
            at = np.arange(length) - (length - n) // 2
            counts.append(np.bincount(border_indices(at, n, rule_of(self.border)), minlength=n))
        image = self.image
        rows = np.einsum("yx,yx->y", image, image).astype(np.float64)
        (several,) = np.nonzero(counts[1] != 1)
        rows += np.square(image[:, several]) @ (counts[1][several] - 1.0)
        return max(sqrt(counts[0] @ rows / prod(period)) / self.level, 1.0)

    def windows(self, inner: int = INNER) -> tuple[Windows, np.ndarray]:
        """Return windows of the frame and their light, float32 (n, WINDOW, WINDOW), a dark world included.

        inner: side of the part of a window that represents other parts of the frame [sample].
        """
        if inner in self._windows:
            return self._windows[inner]
        windows = Windows.of(
            self.image,
            self.margin,
            self.border,
            WINDOWS,
            side=WINDOW,
            rim=(WINDOW - inner) // 2,
            beside=1,
        )
        (rows, cols), rule = self.image.shape, rule_of(self.border)
        y, x = border_indices(windows.rows, rows, rule), border_indices(windows.cols, cols, rule)
        light = take_windows(self.image, y, x).astype(np.float32, copy=False)
        if self.border == "zero":
            light *= (y == windows.rows)[:, :, None] & (x == windows.cols)[:, None, :]
        self._windows[inner] = windows, light
        return windows, light

    @property
    def spectrum(self) -> tuple[np.ndarray, float]:
        """Mean squares of the frame's light at FREQUENCIES along both axes, and of longer waves."""
        if "spectrum" not in self.held:
            self.held["spectrum"] = self._find_spectrum()
        return self.held["spectrum"]

    def _find_spectrum(self):
        windows, light = self.windows()
        fade = np.hanning(WINDOW + 1)[:-1].astype(np.float32)
        fade = np.multiply.outer(fade, fade)
        light = (light - np.tensordot(light, fade / fade.sum(), 2)[:, None, None]) * fade
        power = np.tensordot(windows.weight, np.abs(scipy.fft.rfft2(light)) ** 2, 1)
        power[:, 1:-1] *= 2  # for the other half
        power[1 : WINDOW // 2] += power[: WINDOW // 2 : -1]
        power = power[: WINDOW // 2 + 1] / (WINDOW**2 * np.square(fade).sum())
        inside = _inside(self.image, self.margin)
        # `level` is of the light behind a lens
        some = inside[:: max(1, round(inside.size / MOST_STEPS))]
        return power, max(float(np.var(some, dtype=np.float64)) - float(power.sum()), 0.0)

    @cached_property
    def darkest(self) -> tuple[float, float]:
        """99.9 % quantile and maximum over the frame of 1 over the noise's standard deviations.

        These are over the root of the electrons at the level.
        """
        least = 1 / self._probes[2]
        return float(np.quantile(least, 0.999)), float(least.max())

    @cached_property
    def _probes(self):
        """Rows and columns where the error is computed, and the root of light and noise over the level there."""
        (y, rows, inner_y), (x, cols, inner_x) = map(self._probes_along, self.image.shape)
        local = self.image[rows].mean(axis=1)[:, cols].mean(axis=2)
        if self.border == "zero" and self.is_moved:
            local = local * 0
        elif self.border == "zero" and self.deviation:  # a lens mixes the black world in
            local = local * np.multiply.outer(inner_y, inner_x)
        return y, x, np.sqrt(np.maximum(local / self.level, 0) + self.noise)

    def _probes_along(self, n):
        """Places along an axis of n samples, those around each, and the part of the lens's light from the frame."""
        count = min(n - 2 * self.margin, PROBED)
        at = np.unique(np.linspace(self.margin, n - self.margin - 1, count).astype(int))
        around = np.clip(at[:, None] + np.arange(-self.around, self.around + 1), 0, n - 1)
        if not self.deviation:
            return at, around, 1.0
        ends = (np.array([[-0.5], [n - 0.5]]) - at) / self.deviation
        return at, around, np.diff(scipy.special.ndtr(ends), axis=0)[0]


def most_reach(shape, longest: int) -> int:
    """Return the surroundings up to which a transform is made longer [sample].

    longest: longest side of a transform [sample].
    """
    rows, cols = shape
    samples = max(MOST_SAMPLES, MOST_TIMES * rows * cols)
    by_samples = int((sqrt((rows - cols) ** 2 + 4 * samples) - rows - cols) / 4)
    return max(0, min(by_samples, (longest - max(shape)) // 2))


def _inside(image, margin):
    return image[margin : image.shape[0] - margin, margin : image.shape[1] - margin]


@lru_cache(maxsize=32)
def _means(n, period, cells, border, wide, dtype):
    """Means over the cells of a world of `wide` periods: weights of the image's n samples, of type `dtype`.

    Returns:
        The weights of each mean, once if cells have the same, and which of them each cell has.
    """
    length, step = wide * period, period / cells
    at = np.arange(length) - (wide // 2 * period + (period - n) // 2)
    source = border_indices(at, n, border)
    light = (at == source) * 1.0 if border == "zero" else np.ones(length)
    start = np.arange(length) / step  # a sample is in one cell, or partly in the next
    first = np.minimum((start * (1 + 1e-12)).astype(int), wide * cells - 1)
    share = np.clip((first + 1 - start) * step, 0, 1)
    entries = np.concatenate([light * share, light * (1 - share)]) / step
    cell = np.concatenate([first, np.minimum(first + 1, wide * cells - 1)])
    places = cell, np.concatenate([source, source])
    weights = scipy.sparse.csr_array((entries, places), shape=(wide * cells, n)).astype(dtype)
    weights.sum_duplicates()
    own: dict[bytes, int] = {}
    first, which = [], np.empty(wide * cells, int)
    for number, (start, end) in enumerate(pairwise(weights.indptr)):
        row = weights.indices[start:end].tobytes() + weights.data[start:end].tobytes()
        which[number] = own.setdefault(row, len(first))
        if len(own) > len(first):
            first.append(number)
    return weights[first], which


@lru_cache(maxsize=32)
def _kernel(cells, steps, tail, disc, soft, rays, straight):
    """Transform of tail r^-3, softened within `soft`, and of a disc, at the frequencies of a world of cells.

    (r^2 + a^2)^(-3/2) has the transform 2 pi / a exp(-2 pi a f); of two of them the terms in a^2 /
    r^5 cancel. Light along a line is 1 / (r^2 + a^2), with the transform pi / a exp(-2 pi a |f|), f
    the frequency along it, softened in the same way. All lines together have the energy of the tail
    beyond any r.
    """
    fy, fx = np.fft.fftfreq(cells[0]) / steps[0], np.fft.rfftfreq(cells[1]) / steps[1]
    f = np.hypot(fy[:, None], fx)
    kernel = tail * (1 - straight) * 2 * np.pi * _soften(soft, f)
    for angle in rays:
        along = np.abs(fy[:, None] * np.sin(angle) + fx * np.cos(angle))
        kernel = kernel + tail * straight * np.pi**2 / len(rays) * _soften(soft, along)
    if disc:
        v = np.maximum(2 * np.pi * disc * f, 1e-9)
        kernel = kernel + 2 * j1(v) / v * np.exp(-((np.pi * soft * f) ** 2))
    return kernel


def _soften(soft, f):
    return (4 / 3 * np.exp(-2 * np.pi * soft * f) - np.exp(-4 * np.pi * soft * f) / 6) / soft
