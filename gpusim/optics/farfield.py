"""The far field of a lens: Gaussians whose sum falls like its tail, and grids of splines that blur with them.

Far from a point its light falls as t_3 r^-3 + t_5 r^-5 + t_7 r^-7, whatever the wavefront (see
`tail`). With

    r^-p = 2^(1 - p/2) / Gamma(p/2)  integral of  sigma^-p exp(-r^2 / 2 sigma^2)  d ln sigma,

trapezoids at sigma_g = sigma_0 ratio^g turn such a tail into Gaussians of the energies

    w_g = sum over p of  t_p  2^(1 - p/2) / Gamma(p/2)  ln(ratio)  2 pi sigma_g^(2 - p),

whose transfer function is a sum of exp(-2 pi^2 sigma_g^2 f^2). The rest of the lens ends a few
sigma_0 from the point. A blur of so much of the surroundings, plus Gaussians over an endless world,
is the lens in that world.

The blurs are matrices for one axis: Gaussian blurs over an endless world on grids of cubic B-splines.
A grid of spacing D has its splines at x_i = -1/2 + D i. The ends of the axis, half a sample
outside, are then places of splines, and a mirrored world has a mirrored grid. Samples come to the
grid as d_i = sum over x of B((x - x_i) / D) I(x), and go back as u(x) = sum over i of  c_i B((x -
x_i) / D). A filter c = g * d is in between. With B's transfer function sinc^4 the whole has the
transfer function D sinc^8(D f) g(f), so a Gaussian G takes g = G / (D sinc^8).

Grids have two or three levels: narrow Gaussians are filtered on the first, wider ones on the next,
four times coarser, whose splines are sums of the splines of the level before (B(x / 2) = sum of (1,
4, 6, 4, 1) / 8 B(x - m), twice). Source: Unser, Splines: a perfect fit for signal and image
processing (1999); the filter is derived here.

Errors of the grids (`misses`): a wave of frequency f comes to a grid of spacing D as a wave of f0 =
f - k / D, |f0| <= 1 / 2D, by sinc^4(D f), is filtered there, and goes back as waves of all f0 + m /
D, by sinc^4(D f0 + m). Only the same wave is wanted, by the Gaussians' transfer function. The rest
is an error. So are filters of few taps.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import gamma, log, pi

import numpy as np
from numpy.polynomial.polynomial import polyvander
from scipy.sparse import csr_array, diags_array, vstack

from gpusim.domain.pupil import Pupil

RATIO = 1.6  # of neighbours' widths, by default: the sum of so few ripples by 1e-3 of the tail, which averages out
LEAST = 4.0  # [sample] of a Gaussian that grids of splines carry
REACH = 4.4  # in units of the tail's smallest Gaussian over RATIO: beyond it nothing of the lens is left
WIDEST = 4.0  # periods: beyond it a Gaussian is as its limit, but for a power of its width
POWERS = (3, 5, 7)  # of the tail
# powers of sigma with which a Gaussian approaches its limit
LIMITS = {"edge": 1, "zero": 2, "reflect": np.inf, None: np.inf}

# of the grids
COARSER = 4  # times a level's spacing is the next one's
MANY = 48  # spacings of both axes from which on there are three levels, and not two
SPACINGS = 2.8  # of the first level in the standard deviation of the narrowest Gaussian, by default: to 1e-7 of a scene
LEAST_SPACINGS = 0.77  # of that many are enough for a Gaussian of the other levels
TWICE = np.array((1, 4, 6, 4, 1)) / 8
# of a level's splines in the splines of the level before
MASK = np.convolve(TWICE, np.insert(TWICE, slice(1, None), 0))
SPREAD = 5.0  # standard deviations at which a filter ends
SMALLEST = 1e-9  # of a row's largest entry, below which an entry is none
REPLICAS = 4  # of the grid's frequencies on each side, beyond which sinc^8 is below 1e-10
WIDE = 4.0  # spacings of a Gaussian from which its error is negligible


def gaussians(reach: float, longest: float, ratio: float = RATIO) -> np.ndarray:
    """Return standard deviations [sample], the last of them infinite, for the light left out within `reach`.

    Args:
        reach: Samples around the frame that take part in the blur.
        longest: Side of the world that a transform repeats [sample].
        ratio: Of neighbours' widths.
    """
    first = max(ratio * reach / REACH, LEAST)
    count = max(int(np.ceil(log(WIDEST * longest / first) / log(ratio))), 1) + 1
    return np.append(first * ratio ** np.arange(count), np.inf)


def energies(sigmas, tails, border: str | None = None) -> np.ndarray:
    """Return energies of Gaussians, shape (..., G), of tails, shape (..., 3).

    Args:
        sigmas: See `gaussians`.
        tails: See `tail`.
        border: Rule of the world, which shares out the light between the last Gaussian and
            infinity; None: all of it goes to the infinite Gaussian, as in a transfer function.
    """
    finite, ratio = sigmas[:-1], sigmas[1] / sigmas[0]
    each, more, near = np.empty((3, len(finite))), np.empty(3), np.empty(3)
    for k, p in enumerate(POWERS):
        part = 2 ** (1 - p / 2) / gamma(p / 2) * log(ratio)
        each[k] = part * 2 * pi * finite ** (2.0 - p)
        # sums of all wider Gaussians' energies, over the last one's, and of their share in it
        more[k] = 1 / (ratio ** (p - 2) - 1)
        near[k] = 1 / (ratio ** (p - 2 + LIMITS[border]) - 1)
    found = np.append(tails @ each, np.zeros((*tails.shape[:-1], 1)), axis=-1)
    last = tails * each[:, -1]
    found[..., -2] += last @ near
    found[..., -1] = last @ more - last @ near
    return found


def edge_tail(pupil: Pupil) -> float:
    """Return the energy per square sample times r^3 / q that a pupil's edges spread far from a point."""
    edges = pupil.outline + 2 * np.pi * pupil.obscuration
    return float(edges / (np.pi * pupil.area) / (2 * np.pi**3))


def tail(pupil: Pupil, q, waves, variance: float) -> np.ndarray:
    """Return t_3, t_5, t_7 of every wavelength in the mean over directions, shape (L, 3).

    t_3 is q times `edge_tail`. Each point of the pupil's rim spreads its light about the place
    where its ray lands, b from the image: the tail is t_3 (r^2 + b^2) / (r (r^2 - b^2)^2) = t_3
    (r^-3 + 3 b^2 r^-5 + 5 b^4 r^-7 + ...). A blur with variance v along an axis adds v / 4 of the
    Laplacian's mean, 9 r^-5.

    Args:
        pupil: The pupil.
        q: Wavelength times f-number over the distance of samples, shape (L,).
        waves: Wavefronts of the wavelengths, see `Optics.waves`.
        variance: Sum along both axes of the variances of everything that spreads light a little:
            the samples' aperture, a low-pass filter's spots and a diffuser [sample^2].
    """
    q, inner = np.asarray(q, np.float64), pupil.obscuration
    cusp = edge_tail(pupil) * q
    squares = _squares(waves, q, 1.0)
    if inner:  # the rims' lengths weigh them
        both = squares, _squares(waves, q, inner)
        squares = np.tensordot(both, (1 / (1 + inner), inner / (1 + inner)), (0, 0))
    spread = 9 / 4 * variance
    # factor of |s|^3 in the transfer function of a round pupil in focus
    cubic = 2 / (3 * pi) * ((1 + 1 / inner) / (1 - inner**2) if inner else 1.0)
    third = 9 / (16 * pi**4) * cubic * q**3
    fifth = cusp * (3 * squares[:, 0] + spread) + third
    return np.stack([cusp, fifth, 5 * cusp * squares[:, 1]], axis=1)


def _squares(waves, q, radius):
    """Means of b^2 and b^4, b how far from the image the rays through a rim land [sample], shape (L, 2)."""
    angle = np.linspace(0, 2 * pi, 64, endpoint=False)
    order, by = waves.shape[1] - 1, np.arange(1, waves.shape[1])
    x, y = polyvander(radius * np.cos(angle), order), polyvander(radius * np.sin(angle), order)
    along = np.einsum("lij,ai,aj->la", waves[:, 1:] * by[:, None], x[:, :-1], y, optimize=True)
    across = np.einsum("lij,ai,aj->la", waves[:, :, 1:] * by, x, y[:, :-1], optimize=True)
    square = (2 * q[:, None]) ** 2 * (along**2 + across**2)
    return np.stack([square.mean(axis=1), (square**2).mean(axis=1)], axis=1)


@dataclass(frozen=True)
class Bands:
    """Matrices whose rows have a few adjacent entries.

    Attributes:
        start: First column, shape (matrices, rows).
        count: Number of entries, shape (matrices, rows).
        values: Entries, float32 (matrices, rows, most).
        columns: Columns of a matrix.
    """

    start: np.ndarray
    count: np.ndarray
    values: np.ndarray
    columns: int

    @classmethod
    def of(cls, matrices) -> "Bands":
        """Of sparse ones of one shape."""
        rows, columns = matrices[0].shape
        start, count = np.zeros((2, len(matrices), rows), int)
        entries = []
        for number, matrix in enumerate(map(csr_array, matrices)):
            matrix.sum_duplicates()  # and sorts them
            row, size = np.repeat(np.arange(rows), np.diff(matrix.indptr)), abs(matrix)
            largest = np.maximum(size.max(axis=1).toarray().ravel(), 1e-300)
            is_entry = size.data > SMALLEST * largest[row]
            row, column, value = row[is_entry], matrix.indices[is_entry], matrix.data[is_entry]
            ends = np.searchsorted(row, np.arange(rows + 1))
            there = ends[1:] > ends[:-1]
            start[number, there] = column[ends[:-1][there]]
            count[number, there] = column[ends[1:][there] - 1] + 1 - start[number, there]
            entries.append((row, column, value))
        most = max(int(count.max(initial=1)), 1)
        # `most` entries from there on are within the matrix
        first = np.minimum(start, columns - most)
        start, count = first, start + count - first
        values = np.zeros((len(matrices), rows, most), np.float32)
        for own, begin, (row, column, value) in zip(values, start, entries, strict=True):
            own[row, column - begin[row]] = value
        return cls(start.astype(np.int32), count.astype(np.int32), values, columns)

    def in_blocks(self, rows: int) -> "Blocks":
        """The same, so many rows of a matrix at a time."""
        matrices, all_rows, most = self.values.shape
        blocks = -(-all_rows // rows)
        more = [(0, 0), (0, blocks * rows - all_rows)]
        start, count = (
            np.pad(array, more, mode="edge").reshape(matrices, blocks, rows)
            for array in (self.start, self.count)
        )
        first = start.min(axis=2)
        length = (start + count).max(axis=2) - first
        values = np.zeros((matrices, blocks, int(length.max()), rows), np.float32)
        own = np.pad(self.values, [*more, (0, 0)]).reshape(matrices, blocks, rows, most)
        matrix, block, row, entry = np.nonzero(own)
        values[matrix, block, (start - first[..., None])[matrix, block, row] + entry, row] = own[
            own != 0
        ]
        return Blocks(first.astype(np.int32), length.astype(np.int32), values, all_rows)


@dataclass(frozen=True)
class Blocks:
    """Matrices in blocks of rows, each with a few adjacent columns.

    Attributes:
        start: First column, shape (matrices, blocks).
        count: Number of columns, shape (matrices, blocks).
        values: Entries, float32 (matrices, blocks, most, rows of a block).
        rows: Rows of a matrix.
    """

    start: np.ndarray
    count: np.ndarray
    values: np.ndarray
    rows: int


@dataclass(frozen=True)
class Axis:
    """One axis of n samples.

    coarse: spacings of the last level. sigmas: of Gaussians [sample], in growing order. ends: how many of them are
    filtered up to each level. border: "zero", "edge" or "reflect".
    """

    n: int
    coarse: int
    sigmas: tuple[float, ...]
    ends: tuple[int, ...]
    border: str

    @property
    def levels(self) -> int:
        """Their number."""
        return len(self.ends)

    def size(self, level: int) -> int:
        """Spacings of a level."""
        return COARSER ** (self.levels - 1 - level) * self.coarse

    def splines(self, level: int) -> int:
        """Splines of a level that an axis keeps."""
        return self.size(level) + 5

    def of_level(self, level: int) -> slice:
        """The Gaussians that are filtered there."""
        return slice(self.ends[level - 1] if level else 0, self.ends[level])

    @property
    def step(self) -> float:
        """Distance of the first level's splines [sample]."""
        return self.n / self.size(0)

    @cached_property
    def analysis(self) -> Bands:
        """Return the map to the first level: the first sample, d_-1 .. of the axis, the last sample."""
        first, last = (csr_array(([1.0], ([0], [at])), shape=(1, self.n)) for at in (0, self.n - 1))
        inner = diags_array(1 / self._sums) @ self._splines(np.arange(self.n)).T
        return Bands.of([vstack([first, inner, last])])

    def synthesis(self, margin: int = 0) -> Bands:
        """From the coefficients c_-2 .. of the first level to samples, without `margin` of them on each side.

        margin: down to -step: that many more.
        """
        return Bands.of([self._splines(np.arange(margin, self.n - margin), 2)])

    def restriction(self, level: int) -> Bands:
        """Return the bands from a level's values, see `_world`, to d_-2 .. of the next, in an endless world."""
        world = self._world(level, 4 * COARSER)
        return Bands.of([self._coarser(level, 4 * COARSER - 6, world.shape[0]) @ world])

    def prolongation(self, level: int) -> Bands:
        """From the next level's coefficients c_-2 .. to a level's."""
        return Bands.of([self._coarser(level, -4, self.splines(level)).T])

    def _coarser(self, level, first, columns):
        """The next level's splines from a level's, whose `first` is the one below the middle one, sparse."""
        count = self.splines(level + 1)
        at = COARSER * np.arange(-2, count - 2) + first
        return _band_matrix(at, np.broadcast_to(MASK, (count, len(MASK))), columns)

    def filters(self, level: int) -> Bands:
        """Return the maps from a level's values to the coefficients c_-2 .. of its Gaussians."""
        found, size, step = [], self.size(level), self.n / self.size(level)
        for sigma in self.sigmas[self.of_level(level)]:
            if np.isinf(sigma):
                found.append(csr_array(np.tile(self._limit(level, step), (size + 5, 1))))
                continue
            taps = _taps(sigma / step) / step
            world = self._world(level, len(taps) // 2 + 2)
            rows = np.broadcast_to(taps, (size + 5, len(taps)))
            found.append(_band_matrix(np.arange(size + 5), rows, world.shape[0]) @ world)
        return Bands.of(found)

    def _splines(self, at, more=1):
        """Splines -more .. fine + more of the first level at samples, sparse (samples, fine + 2 more + 1)."""
        place = (np.asarray(at) + 0.5) / self.step + more
        first = np.floor(place).astype(int) - 1
        values = _cubic(place[:, None] - first[:, None] - np.arange(4))
        return _band_matrix(first, values, self.size(0) + 2 * more + 1)

    @cached_property
    def _sums(self):
        """Of each spline over all samples of the world, over the spacing: 1 but for a few 1e-5."""
        beyond = 4 * int(np.ceil(self.step)) + 4
        return self._splines(np.arange(-beyond, self.n + beyond)).sum(axis=0) / self.step

    def _world(self, level, more):
        """d_i of the endless world, i = -more .. size + more, from a level's values, sparse.

        The first level has the values of `analysis`, the others d_-2 .. of that world.
        """
        size = self.size(level)
        i = np.arange(-more, size + more + 1)
        rows, shape = np.arange(len(i)), (len(i), size + 5)
        if level:
            if self.border == "reflect":
                i = abs((i + size) % (2 * size) - size)
            return csr_array((np.ones(len(i)), (rows, np.clip(i, -2, size + 2) + 2)), shape=shape)
        if self.border == "reflect":
            period = 2 * size
            images = [i % period, i % period - period, -i % period, -i % period - period]
            images, rows = np.concatenate(images), np.tile(rows, 4)
            there = (images >= -1) & (images <= size + 1)
            entries = np.ones(there.sum()), (rows[there], images[there] + 2)
            return csr_array(entries, shape=shape)
        there = (i >= -1) & (i <= size + 1)
        entries = [(np.ones(there.sum()), rows[there], i[there] + 2)]
        if self.border == "edge":
            beyond = int(np.ceil(3 * self.step)) + 1
            near = rows[more - 1 : more + size + 2]
            before = 0, np.arange(-beyond, 0), rows[: more - 1]
            after = size + 4, np.arange(self.n, self.n + beyond), rows[more + size + 2 :]
            for column, at, far in (before, after):
                inside = self._splines(at).sum(axis=0) / self._sums
                entries.append((inside, near, np.full(len(near), column)))
                entries.append((np.full(len(far), self.step), far, np.full(len(far), column)))
        values, row, column = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        return csr_array((values, (row, column)), shape=shape)

    def _limit(self, level, step):
        """Weights of a level's values in the limit of an infinitely wide Gaussian."""
        size = self.size(level)
        if self.border == "zero":
            return np.zeros(size + 5)
        # without an end, or a period of the mirrored world twice, but its ends
        world = self._world(level, size + 8 if self.border == "edge" else 0)
        ends = (world[[0]] + world[[-1]]).toarray().ravel()
        if self.border == "edge":
            return ends / (2 * step)
        return (world.sum(axis=0) - ends / 2) / (size * step)


def axes(shape, sigmas, border: str, spacings: float = SPACINGS) -> list[Axis]:
    """Both axes of samples of this shape (rows, cols), whose grids are fine enough for all of these Gaussians.

    spacings: of the first level in the standard deviation of the narrowest.
    """
    levels = 3 if min(shape) * spacings >= MANY * sigmas[0] else 2
    least = COARSER ** (levels - 1)
    coarse = np.maximum(np.ceil(np.multiply(shape, spacings) / (least * sigmas[0])), 1).astype(int)
    widest = np.divide(shape, coarse).max() / least
    limits = LEAST_SPACINGS * spacings * widest * COARSER ** np.arange(1, levels)
    ends = *np.searchsorted(sigmas, limits).tolist(), len(sigmas)
    (rows, cols), (down, across) = shape, coarse.tolist()
    sigmas = tuple(sigmas)
    return [Axis(rows, down, sigmas, ends, border), Axis(cols, across, sigmas, ends, border)]


@lru_cache(maxsize=512)
def multiplications(
    shape: tuple[int, int],
    planes: int,
    channels: int,
    sigmas: tuple[float, ...],
    spacings: float = SPACINGS,
) -> float:
    """Return about how many multiplications a far field of so many planes and channels takes, on both axes."""
    down, across = axes(shape, sigmas, "edge", spacings)
    high, wide = down.splines(0), across.splines(0)
    total = 4.0 * planes * shape[1] * (shape[0] + 5 * down.step) + 4.0 * channels * shape[0] * wide
    total += 4.0 * planes * high * (shape[1] + 5 * across.step) + 4.0 * shape[0] * shape[1]
    for level in range(down.levels):
        area = down.splines(level) * across.splines(level)
        part = np.asarray(sigmas[down.of_level(level)])
        for axis in (down, across):
            taps = np.minimum(2 * SPREAD * part * axis.size(level) / axis.n, axis.splines(level))
            total += channels * area * taps.sum()
    return float(total)


def _band_matrix(first, values, columns):
    """Sparse matrix whose rows have `values` (rows, entries) from the columns `first` on; others are cut off."""
    at = np.asarray(first)[:, None] + np.arange(values.shape[1])
    there = (at >= 0) & (at < columns)
    ends = np.append(0, np.cumsum(there.sum(axis=1)))
    return csr_array((values[there], at[there], ends), shape=(len(at), columns))


def _cubic(x):
    """The cubic B-spline of knots at whole numbers, in its middle 2 / 3."""
    x = abs(x)
    return np.where(x < 1, 2 / 3 - x**2 + x**3 / 2, np.maximum(2 - x, 0) ** 3 / 6)


def response(sigma: float, frequency) -> np.ndarray:
    """Transfer function of the filter that makes a Gaussian of this sigma [spacing], at frequencies [1/spacing]."""
    taps = _taps(sigma)[int(np.ceil(SPREAD * sigma)) :]
    phases = 2 * np.pi * np.multiply.outer(frequency, np.arange(1, len(taps)))
    return taps[0] + 2 * np.cos(phases) @ taps[1:]


def _taps(sigma):
    """Values of the filter with the transfer function of a Gaussian over sinc^8, out to SPREAD sigmas [spacing].

    Their sum is one, so flat light is unchanged for any number of taps.
    """
    half = int(np.ceil(SPREAD * sigma))
    length = 1 << int(np.ceil(np.log2(2 * half + 64)))
    frequency = np.fft.rfftfreq(length)
    transfer = np.exp(-2 * (np.pi * sigma * frequency) ** 2) / np.sinc(frequency) ** 8
    taps = np.fft.irfft(transfer, length)
    taps = taps[abs(np.arange(-half, half + 1))]
    return taps / taps.sum()


def misses(shape: tuple[int, int], sigmas, energies, spacings: float, down, across) -> np.ndarray:
    """Mean square errors of waves whose own is 1, shape (channels, frequencies down, frequencies across).

    shape: samples of the frame. sigmas: of the Gaussians, shape (G,) [sample]. energies: of each in a channel, shape
    (channels, G). spacings: of splines in the first of the sigmas. down, across: the frequencies [1/sample].
    """
    found = np.zeros((len(energies), len(down), len(across)))
    for part, y, x in _levels(tuple(shape), tuple(sigmas), spacings, tuple(down), tuple(across)):
        each = energies[:, part, None]
        there = np.multiply.outer(y.there, x.there)  # and back as the same wave
        back = np.multiply.outer(y.back, x.back) - there**2
        wanted, filtered = y.wanted.T @ (each * x.wanted), y.taps.T @ (each * x.taps)
        found += there**2 * filtered**2 * back + (there**2 * filtered - wanted) ** 2
    return found


class _Waves:
    """Waves along an axis, of frequencies (n,) [1/sample], and the Gaussians of a level.

    there: factor with which a wave comes to the grid, (n,). back: sum of the squares of the waves
    that go back, (n,). taps, wanted: transfer functions of the filters and of the Gaussians, (G,
    n).
    """

    def __init__(self, axis, level, sigmas, at):
        step = axis.n / axis.size(level)
        own = step * at
        here = own - np.rint(own)
        self.there = np.sinc(own) ** 4
        self.back = sum(np.sinc(here + m) ** 8 for m in range(-REPLICAS, REPLICAS + 1))
        self.taps = np.array([response(sigma / step, here) for sigma in sigmas])
        self.wanted = np.exp(-2 * (np.pi * np.multiply.outer(sigmas, at)) ** 2)


@lru_cache(maxsize=64)
def _levels(shape, sigmas, spacings, down, across):
    """Which Gaussians are of each level that has any, and the waves of both axes there."""
    (y, x), found = axes(shape, sigmas, "edge", spacings), []
    for level in range(y.levels):
        part = np.arange(len(sigmas))[y.of_level(level)]
        part = part[np.take(sigmas, part) < WIDE * min(y.n / y.size(level), x.n / x.size(level))]
        own = np.take(sigmas, part)
        if len(part):
            rows = _Waves(y, level, own, np.array(down))
            found.append((part, rows, _Waves(x, level, own, np.array(across))))
    return found
