"""Line spreads from the pixels around straight edges: a non-negative mixture of known spreads.

The mixture has Gaussians and the projections of discs, each spread further by diffraction at the aperture and by
the pixel. Weights follow from non-negative least squares on the pixels of all edges of one direction: no
window cuts the tails, and nothing is divided by the pixel's transfer. Source of the slanted-edge method: ISO
12233:2014, e-SFR.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from gpusim.domain.errors import BadData
from gpusim.domain.short_repr import short_repr
from gpusim.fit.edge_corners import Lean
from gpusim.fit.edge_finding import FoundEdge

BINS = 8  # per pixel along the normal
FINE = 32  # samples per pixel of tables
PERIOD = 512  # [pixel] of tables
MOST = 20000  # pixels that determine an edge's line
BLOCKS = 10  # along an edge, one left out at a time for intervals
GAUSSIANS = np.append(0.0, np.geomspace(0.15, 10, 10))  # standard deviations [pixel]
DISCS = np.geomspace(0.4, 14, 9)  # radii [pixel]
FLOOR = 0.006  # relative error of MTF50 that the mixture itself makes, without noise
BLOCKED = 0.85  # standard deviation over the jackknife's, which non-negative weights make too large
# weight of the weights' squares over a pixel's noise, which must not make a mixture of sharp and wide spreads
RIDGE = 12.0
LEAST_NOISE = 5e-4  # over the step
FASTEST = 6.0  # [cycle/pixel] the pixel's own transfer leaves 1e-3 beyond


@dataclass(frozen=True)
class EdgeLine:
    """The line of an edge, which may bend.

    Args:
        row, col: A point near its middle [pixel].
        angle: Of the normal to the lighter side, from the columns' axis x towards rows [rad].
        shift: Of the line from the point along the normal [pixel].
        bend: Distance of the middle from the ends' chord, 1 at half the length [pixel].
        half: Half of the length [pixel].
    """

    row: float
    col: float
    angle: float
    shift: float
    bend: float
    half: float

    __repr__ = short_repr

    def place(self, rows: np.ndarray, cols: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances of pixels along the normal and along the edge [pixel]."""
        x, y = cols - self.col, rows - self.row
        d = x * np.cos(self.angle) + y * np.sin(self.angle)
        t = y * np.cos(self.angle) - x * np.sin(self.angle)
        return d - self.shift - self.bend * ((t / self.half) ** 2 - 1 / 3), t


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """Pixels of one channel around an edge.

    Args:
        distance: From the edge along its normal [pixel], shape (N,).
        values: Evened values, shape (N,).
        block: Number of the part of the edge's length, shape (N,).
        line: The edge's line.
        levels: Dark and light value.
    """

    distance: np.ndarray
    values: np.ndarray
    block: np.ndarray
    line: EdgeLine
    levels: tuple[float, float]

    __repr__ = short_repr

    @property
    def noise(self) -> float:
        """Standard deviation of a pixel far from the edge on its light side, over the step [1]."""
        far = self.distance > 0.7 * self.distance.max()
        seen = self.values[far]
        # neighbours on the distance scale differ by noise only
        order = np.argsort(self.distance[far])
        return float(np.std(np.diff(seen[order])) / np.sqrt(2))

    @cached_property
    def bin_values(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean distance (B,), sums of values and counts by block (BLOCKS, B)."""
        number = np.floor(self.distance * BINS).astype(int)
        number -= number.min()
        size = number.max() + 1
        both = self.block * size + number
        counts = np.bincount(both, minlength=BLOCKS * size).reshape(BLOCKS, size)
        sums = np.bincount(both, self.values, BLOCKS * size).reshape(BLOCKS, size)
        places = np.bincount(number, self.distance, size)
        kept = counts.sum(0) > 0
        return places[kept] / counts.sum(0)[kept], sums[:, kept], counts[:, kept]


def read_edge(values: np.ndarray, mask: np.ndarray, edge: FoundEdge) -> EdgeSamples:
    """Find an edge's line among the pixels of a channel, and their distances from it.

    The line, which may bend, is a least squares fit of a Gaussian-blurred edge on surfaces whose light varies
    linearly.

    Args:
        values: Light values, shape (rows, cols).
        mask: Pixels of the channel.
        edge: The edge.

    Returns:
        The pixels, light evened.

    Raises:
        BadData: The edge is not seen in this channel.
    """
    rows, cols, _ = _cut(mask, edge)
    seen = values[rows, cols]
    if len(seen) < 200:
        raise BadData(f"{len(seen)} pixels of the channel around an edge, wanted 200 or more")
    chosen = np.linspace(0, len(seen) - 1, min(MOST, len(seen))).astype(int)
    half = edge.length / 2

    def line(params):
        return EdgeLine(edge.row, edge.col, *map(float, params[:3]), half)

    def model(params, rows, cols):
        d, t = line(params).place(rows, cols)
        step = 0.5 * scipy.special.erfc(-d / (np.sqrt(2) * np.exp(params[3])))
        return (params[4] + (params[5] - params[4]) * step) * (1 + params[6] * t / half)

    d, _ = line((edge.angle, 0.0, 0.0)).place(rows, cols)
    dark, bright = np.median(seen[d < -edge.width / 3]), np.median(seen[d > edge.width / 3])
    scale = bright - dark
    start = np.array([edge.angle, 0.0, 0.0, 0.0, dark / scale, bright / scale, 0.0])
    found = scipy.optimize.least_squares(
        lambda p: model(p, rows[chosen], cols[chosen]) - seen[chosen] / scale,
        start,
        bounds=(
            start - np.array([0.2, 6, 6, 4, np.inf, np.inf, 1]),
            start + np.array([0.2, 6, 6, 3, np.inf, np.inf, 1]),
        ),
        x_scale=[1e-2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1],
        loss="soft_l1",
        f_scale=0.1,
    ).x
    d, t = line(found).place(rows, cols)
    even = seen / (1 + found[6] * t / half)
    block = np.clip(((t / edge.length + 0.5) * BLOCKS).astype(int), 0, BLOCKS - 1)
    return EdgeSamples(d, even / scale, block, line(found), (float(found[4]), float(found[5])))


def _cut(mask, edge):
    """Return rows and columns of a channel's pixels in the rectangle around an edge, and their distances."""
    reach = np.hypot(edge.length / 2, edge.width) + 1
    top, left = max(int(edge.row - reach), 0), max(int(edge.col - reach), 0)
    part = mask[top : int(edge.row + reach) + 2, left : int(edge.col + reach) + 2]
    rows, cols = np.nonzero(part)
    rows, cols = rows + top, cols + left
    x, y = cols - edge.col, rows - edge.row
    d = x * np.cos(edge.angle) + y * np.sin(edge.angle)
    t = y * np.cos(edge.angle) - x * np.sin(edge.angle)
    inside = (np.abs(d) <= edge.width) & (np.abs(t) <= edge.length / 2)
    return rows[inside], cols[inside], d[inside]


def diffraction(frequency: np.ndarray, cutoff: float) -> np.ndarray:
    """Return the transfer of a circular aperture.

    Args:
        frequency: [cycle/pixel], any shape.
        cutoff: Wavelength times f-number over the pitch [1]; 0: no diffraction.

    Returns:
        Transfer [1].

    Source:
        Goodman, Introduction to Fourier Optics, 6.4.
    """
    part = np.minimum(np.abs(frequency) * cutoff, 1)
    return np.asarray(2 / np.pi * (np.arccos(part) - part * np.sqrt(1 - part**2)))


def disc_transfer(frequency: np.ndarray) -> np.ndarray:
    """Return the transfer of an even disc of radius 1 at frequencies of any shape."""
    around = 2 * np.pi * np.abs(frequency)
    small = around < 1e-6
    return np.where(small, 1.0, 2 * scipy.special.j1(around) / np.where(small, 1, around))


def line_transfers(frequency: np.ndarray, cutoff: float) -> np.ndarray:
    """Return the transfer of each spread of the mixture, without the pixel.

    Args:
        frequency: [cycle/pixel], shape (F,).
        cutoff: See `diffraction`.

    Returns:
        Transfer [1], shape (A, F).
    """
    plain = np.concatenate(
        [
            np.exp(-2 * np.pi**2 * np.outer(GAUSSIANS, frequency) ** 2),
            disc_transfer(np.outer(DISCS, frequency)),
        ]
    )
    return plain * diffraction(frequency, cutoff)


def _edge_spreads(angle, distances, cutoff, aperture):
    """Return the edge spreads (A, B) along a normal at distances [pixel], 0 to 1 from dark to light."""
    count = FINE * PERIOD
    f = np.arange(count // 2 + 1) / PERIOD
    f = f[f <= FASTEST]
    pixel = np.sinc(f * np.cos(angle) * aperture[1]) * np.sinc(f * np.sin(angle) * aperture[0])
    transfers = line_transfers(f, cutoff) * pixel
    # the integral of the line spread: 1/2 + d / PERIOD + sum of sines
    waves = np.zeros((len(transfers), count // 2 + 1), complex)
    waves[:, 1 : len(f)] = transfers[:, 1:] / (2j * np.pi * f[1:])
    place = np.arange(-count // 2, count // 2) / FINE
    inside = np.abs(place) <= np.abs(distances).max() + 1
    table = np.roll(np.fft.irfft(waves, count, axis=1) * FINE, count // 2, axis=1)[:, inside]
    return np.stack(
        [np.interp(distances, place[inside], one) for one in table + 0.5 + place[inside] / PERIOD]
    )


@dataclass(frozen=True, eq=False)
class LineSpread:
    """Blur along one direction.

    Args:
        cutoff: See `diffraction`.
        aperture: Width of the pixel's aperture along the direction over the pitch.
        tilt: RMS angle between the edges' normals and the direction [rad].
        turn: Mean of the angle with its sign; 0 if as many edges are turned one way as the other.
        weights: Of the mixture, shape (A,), sum 1.
        resamples: The same with one block of the edges left out each, shape (BLOCKS, A).
        residual: Distances [pixel] and residuals over the step [1] of all edges, (2, N), for plots.
        misfit: RMS residual over the step in bins [1].
        expected: The residual that noise explains [1].
    """

    cutoff: float
    aperture: float
    tilt: float
    turn: float
    weights: np.ndarray
    resamples: np.ndarray
    residual: np.ndarray
    misfit: float
    expected: float

    __repr__ = short_repr

    def transfer(self, frequency: np.ndarray, has_pixel: bool = True) -> np.ndarray:
        """Return the transfer [1] at frequencies [cycle/pixel], shape (F,), with the pixel or without."""
        lens = self.weights @ line_transfers(frequency, self.cutoff)
        return lens * np.sinc(frequency * self.aperture) if has_pixel else lens

    @cached_property
    def mtf50(self) -> tuple[float, float, float]:
        """Frequency [cycle/pixel] at which the transfer along the normal falls to half, and its 95 % interval."""
        f = np.linspace(0, 2, 2001)
        table = line_transfers(f, self.cutoff) * np.sinc(f * self.aperture)
        value = falls_to_half(f, self.weights @ table)
        others = np.array([falls_to_half(f, weights @ table) for weights in self.resamples])
        count = len(others)
        error = np.sqrt((count - 1) / count * ((others - others.mean()) ** 2).sum())
        reach = 1.96 * np.hypot(BLOCKED * error, FLOOR * value)
        return value, max(value - reach, 0.0), value + reach


def falls_to_half(frequency: np.ndarray, response: np.ndarray) -> float:
    """Return the first frequency at which a response is 0.5, linear between samples; the last one if none."""
    below = np.flatnonzero(np.abs(response) <= 0.5)
    if not len(below) or not below[0]:
        return float(frequency[-1])
    k = below[0]
    part = (response[k - 1] - 0.5) / (response[k - 1] - response[k])
    return float(frequency[k - 1] + part * (frequency[k] - frequency[k - 1]))


def fit_line(
    edges: list[EdgeSamples],
    cutoff: float,
    aperture: tuple[float, float] = (1.0, 1.0),
    main: LineSpread | None = None,
) -> LineSpread:
    """Fit the blur along one direction to the edges that show it.

    Args:
        edges: Their pixels; all normals near rows, or all near columns.
        cutoff: See `diffraction`.
        aperture: Height and width of the pixel's aperture over the pitch.
        main: Blur of the channel of most light, which is likely to be near; None: not known.

    Returns:
        The blur.
    """
    tables = []
    for edge in edges:
        place, sums, counts = edge.bin_values
        tables.append((_edge_spreads(edge.line.angle, place, cutoff, aperture), sums, counts))
    ridge = RIDGE * max(LEAST_NOISE, float(np.mean([edge.noise for edge in edges])))
    likely = np.zeros((BLOCKS + 1, len(tables[0][0])))
    if main is not None:
        step = np.mean([edge.levels[1] - edge.levels[0] for edge in edges])
        likely = step * np.vstack([main.resamples, main.weights])
    whole = _solve(tables, np.ones(BLOCKS, bool), likely[-1], ridge)
    parts = np.stack(
        [_solve(tables, np.arange(BLOCKS) != left, likely[left], ridge) for left in range(BLOCKS)]
    )
    count = len(tables[0][0])
    weights, own = whole[:count], parts[:, :count]
    residual, noise = [], []
    for number, (edge, (table, sums, counts)) in enumerate(zip(edges, tables, strict=True)):
        n = counts.sum(0)
        left = (sums.sum(0) / n - whole[count + number] - table.T @ weights) / weights.sum()
        residual.append(np.stack([edge.bin_values[0], left]))
        noise.append(edge.noise**2 / weights.sum() ** 2 / n)
    together = np.concatenate(residual, axis=1)
    is_across = abs(np.cos(edges[0].line.angle)) > np.sqrt(0.5)
    turns = [(edge.line.angle + np.pi / 4) % (np.pi / 2) - np.pi / 4 for edge in edges]
    return LineSpread(
        cutoff,
        aperture[int(is_across)],
        float(np.sqrt(np.mean(np.square(turns)))),
        float(np.mean(turns)),
        weights / weights.sum(),
        own / own.sum(1, keepdims=True),
        together,
        float(np.sqrt(np.mean(together[1] ** 2))),
        float(np.sqrt(np.mean(np.concatenate(noise)))),
    )


def _solve(tables, used, likely, ridge):
    """Return weights of the mixture, then the dark level of each edge.

    used: blocks, shape (BLOCKS,). likely: weights that are taken if the pixels do not tell, shape (A,).
    ridge: weight of the differences from them.
    """
    rows, wanted = [], []
    for number, (table, sums, counts) in enumerate(tables):
        n = counts[used].sum(0)
        root = np.sqrt(n)
        dark = np.zeros((len(n), len(tables)))
        dark[:, number] = 1
        rows.append(np.hstack([table.T, dark]) * root[:, None])
        wanted.append(np.divide(sums[used].sum(0), root, out=np.zeros(len(n)), where=n > 0))
    count, columns = len(tables[0][0]), rows[0].shape[1]
    rows.append(ridge * np.eye(count, columns))
    wanted.append(ridge * likely)
    # the same problem with as many rows as columns
    both = np.hstack([np.concatenate(rows), np.concatenate(wanted)[:, None]])
    triangle = np.linalg.qr(both, mode="r")
    return scipy.optimize.nnls(triangle[:, :-1], triangle[:, -1])[0]


@dataclass(frozen=True, eq=False)
class Place:
    """Blur of one channel at one place in the frame.

    Args:
        row, col: The place [pixel].
        letter: The channel.
        across, down: Blur along rows and along columns; None: no edge shows it.
        sources: Names of the files.
        lean: Of the blur between rows and columns; None: no corners of squares show it.
    """

    row: float
    col: float
    letter: str
    across: LineSpread | None
    down: LineSpread | None
    sources: tuple[str, ...] = ()
    lean: Lean | None = None

    __repr__ = short_repr
