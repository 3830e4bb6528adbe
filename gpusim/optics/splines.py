"""Gaussian blurs over a world without end on grids of cubic B-splines, as matrices of few entries for one axis.

A grid of spacing D has its splines at x_i = -1/2 + D i, so that the ends of the axis, half a sample outside, are
splines' places: a mirrored world has a mirrored grid. Samples come to it as d_i = sum over x of B((x - x_i) / D) I(x),
and go back as u(x) = sum over i of  c_i B((x - x_i) / D). In between is a filter c = g * d. With B's transfer function
sinc^4 that makes a transfer function D sinc^8(D f) g(f) of it all, so a Gaussian G takes g = G / (D sinc^8).

The grid is of two levels: narrow Gaussians are filtered on the first, wider ones on the second, four times coarser,
whose splines are sums of those of the first (B(x / 2) = sum of (1, 4, 6, 4, 1) / 8 B(x - m), twice).
Source: Unser, Splines: a perfect fit for signal and image processing (1999); the filter is derived here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

COARSER = 4  # times the first level's spacing is the second's
SPACINGS = 2.8  # of the first level in the standard deviation of the narrowest Gaussian
LEAST = 2.15  # standard deviations of a Gaussian, in spacings, from which on splines carry it to 1e-7
TWICE = np.array((1, 4, 6, 4, 1)) / 8
MASK = np.convolve(TWICE, np.insert(TWICE, slice(1, None), 0))  # of the second level's splines in the first's
SPREAD = 6.0  # standard deviations at which a filter ends
SMALLEST = 1e-9  # of a row's largest entry, below which an entry is none


@dataclass(frozen=True)
class Bands:
    """Matrices whose rows have a few entries beside one another.

    start, count: first column and number of entries, shape (matrices, rows). values: float32 (matrices, rows, most).
    columns: of a matrix.
    """

    start: np.ndarray
    count: np.ndarray
    values: np.ndarray
    columns: int

    @classmethod
    def of(cls, matrices) -> "Bands":
        """Of dense ones, shape (matrices, rows, columns)."""
        matrices = np.asarray(matrices)
        is_entry = abs(matrices) > SMALLEST * np.maximum(abs(matrices).max(axis=2, keepdims=True), 1e-300)
        start = np.where(is_entry.any(2), is_entry.argmax(2), 0)
        count = np.where(is_entry.any(2), matrices.shape[2] - is_entry[:, :, ::-1].argmax(2) - start, 0)
        most = max(int(count.max(initial=1)), 1)
        first = np.minimum(start, matrices.shape[2] - most)  # so that `most` entries from there on are the matrix's
        start, count = first, start + count - first
        at = start[..., None] + np.arange(most)
        values = np.take_along_axis(matrices, at, 2) * (at < (start + count)[..., None])
        return cls(start.astype(np.int32), count.astype(np.int32), np.ascontiguousarray(values, np.float32),
                   matrices.shape[2])


@dataclass(frozen=True)
class Axis:
    """One axis of n samples.

    coarse: spacings of the second level. sigmas: of Gaussians [sample], in growing order. narrow: how many of them are
    filtered on the first level. border: "zero", "edge" or "reflect".
    """

    n: int
    coarse: int
    sigmas: tuple[float, ...]
    narrow: int
    border: str

    @property
    def fine(self) -> int:
        """Spacings of the first level."""
        return COARSER * self.coarse

    @property
    def step(self) -> float:
        """Distance of the first level's splines [sample]."""
        return self.n / self.fine

    @cached_property
    def analysis(self) -> Bands:
        """To the first level: the first sample, d_-1 .. of the axis alone, the last sample."""
        ends = np.zeros((2, self.n))
        ends[0, 0] = ends[1, -1] = 1
        return Bands.of([np.vstack([ends[:1], self._splines(np.arange(self.n)).T / self._sums[:, None], ends[1:]])])

    def synthesis(self, margin: int = 0) -> Bands:
        """From the coefficients c_-2 .. of the first level to samples, without `margin` of them on each side.

        margin: down to -step: that many more.
        """
        return Bands.of([self._splines(np.arange(margin, self.n - margin), 2)])

    @cached_property
    def restriction(self) -> Bands:
        """From what `analysis` gives to d_-2 .. of the second level, of the world without end."""
        world = self._world(4 * COARSER)
        return Bands.of([np.stack([MASK @ world[at - 6 : at + 7] for at in
                                   4 * COARSER + COARSER * np.arange(-2, self.coarse + 3)])])

    @cached_property
    def prolongation(self) -> Bands:
        """From the second level's coefficients c_-2 .. to the first's."""
        apart = np.arange(-2, self.fine + 3)[:, None] - COARSER * np.arange(-2, self.coarse + 3)
        return Bands.of([np.where(abs(apart) <= 6, MASK[np.clip(apart + 6, 0, 12)], 0)])

    def filters(self, first: bool) -> Bands:
        """Coefficients c_-2 .. from what a level has, of its Gaussians. first: whether it is the first level."""
        level, size, step, sigmas = (self._world, self.fine, self.step, self.sigmas[: self.narrow]) if first else (
            self._coarse_world, self.coarse, COARSER * self.step, self.sigmas[self.narrow :])
        found = []
        for sigma in sigmas:
            if np.isinf(sigma):
                found.append(np.tile(self._limit(level, size, step), (size + 5, 1)))
                continue
            half = int(np.ceil(SPREAD * sigma / step))
            taps, world = _taps(sigma / step, half) / step, level(half + 2)
            rows = np.arange(half, half + size + 5)[:, None] + np.arange(-half, half + 1)
            dense = np.zeros((size + 5, len(world)))
            np.put_along_axis(dense, rows, taps[None], 1)
            found.append(dense @ world)
        return Bands.of(found)

    def _splines(self, at, more=1):
        """Splines -more .. fine + more of the first level at samples, shape (samples, fine + 2 more + 1)."""
        return _cubic((np.asarray(at)[:, None] + 0.5) / self.step - np.arange(-more, self.fine + more + 1))

    @cached_property
    def _sums(self):
        """Of each spline over all samples of the world, over the spacing: 1 but for a few 1e-5."""
        return self._splines(np.arange(-4 * int(np.ceil(self.step)) - 4, self.n + 4 * int(np.ceil(self.step)) + 4)
                             ).sum(axis=0) / self.step

    def _world(self, more):
        """d_i of the world without end, i = -more .. fine + more, from what `analysis` gives."""
        i, inside = np.arange(-more, self.fine + more + 1), np.arange(-1, self.fine + 2)
        world = np.zeros((len(i), self.fine + 5))
        if self.border == "reflect":
            for image in (i[:, None] - inside, -i[:, None] - inside):
                world[:, 1:-1] += image % (2 * self.fine) == 0
            return world
        world[:, 1:-1] = i[:, None] == inside
        if self.border == "edge":
            beyond = int(np.ceil(3 * self.step)) + 1
            for column, at in ((0, np.arange(-beyond, 0)), (-1, np.arange(self.n, self.n + beyond))):
                world[more - 1 : more + self.fine + 2, column] = self._splines(at).sum(axis=0) / self._sums
            world[: more - 1, 0] = world[more + self.fine + 2 :, -1] = self.step
        return world

    def _coarse_world(self, more):
        """d_i of the world without end of the second level, i = -more .., from what `restriction` gives."""
        i = np.arange(-more, self.coarse + more + 1)
        if self.border == "reflect":
            i = abs((i + self.coarse) % (2 * self.coarse) - self.coarse)
        source = np.clip(i, -2, self.coarse + 2) + 2
        return (source[:, None] == np.arange(self.coarse + 5)) * 1.0

    def _limit(self, level, size, step):
        """Weights of what a level has in what an infinitely wide Gaussian gives."""
        if self.border == "zero":
            return np.zeros(size + 5)
        if self.border == "edge":
            world = level(size + 8)
            return (world[0] + world[-1]) / (2 * step)
        world = level(0)  # a period of the mirrored world twice, but its ends
        return (world.sum(axis=0) - (world[0] + world[-1]) / 2) / (size * step)


def axes(shape, sigmas, border: str) -> list[Axis]:
    """Both axes of samples of this shape (rows, cols), whose grids are fine enough for all of these Gaussians."""
    coarse = [max(1, int(np.ceil(n * SPACINGS / (COARSER * sigmas[0])))) for n in shape]
    widest = max(n / one for n, one in zip(shape, coarse, strict=True))
    narrow = int(np.searchsorted(sigmas, LEAST * widest))
    return [Axis(n, one, tuple(sigmas), narrow, border) for n, one in zip(shape, coarse, strict=True)]


def multiplications(shape, planes: int, channels: int, sigmas) -> float:
    """Of a far field of so many planes and channels, about: what the matrices of both axes have to multiply."""
    down, across = axes(shape, sigmas, "edge")
    total = 4.0 * planes * shape[1] * (shape[0] + 5 * down.step) + 4.0 * channels * (down.fine + shape[0]) * across.fine
    total += 4.0 * planes * (down.fine + 5) * (shape[1] + 5 * across.step) + 4.0 * shape[0] * shape[1]
    for first, part in ((True, sigmas[: down.narrow]), (False, sigmas[down.narrow :])):
        sizes = [(axis.fine if first else axis.coarse) + 5 for axis in (down, across)]
        steps = [axis.step * (1 if first else COARSER) for axis in (down, across)]
        for size, step in zip(sizes, steps, strict=True):
            total += channels * sizes[0] * sizes[1] * np.minimum(2 * SPREAD * np.asarray(part) / step, size).sum()
    return float(total)


def _cubic(x):
    """The cubic B-spline of knots at whole numbers, in its middle 2 / 3."""
    x = abs(x)
    return np.where(x < 1, 2 / 3 - x**2 + x**3 / 2, np.maximum(2 - x, 0) ** 3 / 6)


def _taps(sigma, half):
    """Values g_-half .. g_half of the filter whose transfer function is that of a Gaussian over sinc^8 [spacing]."""
    length = 1 << int(np.ceil(np.log2(2 * half + 64)))
    frequency = np.fft.rfftfreq(length)
    taps = np.fft.irfft(np.exp(-2 * (np.pi * sigma * frequency) ** 2) / np.sinc(frequency) ** 8, length)
    return taps[abs(np.arange(-half, half + 1))]
