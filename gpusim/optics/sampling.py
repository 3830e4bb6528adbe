"""From scene samples to pixels: weights that integrate a finer grid over each pixel, and their sampling error.

Each blurred sample is the integral of the irradiance over its own cell, so the cumulative integral
along an axis is known exactly at the cells' edges. Between them it is interpolated by a local
polynomial; a pixel is the difference of the cumulative integral at its two edges. Neighbours at
full fill share an edge, so light that one loses the other gains. If edges fall on cells' edges
(whole ratios at full fill), nothing is interpolated.
"""

from dataclasses import dataclass
from functools import cache
from math import ceil
from typing import Any

import numpy as np

from gpusim.domain.content import Content
from gpusim.optics.lens import wavelength_nodes
from gpusim.optics.outside import border_indices
from gpusim.optics.tables import Tables

NODES = 6  # of the polynomial of the cumulative integral, smooth by a blur
AREA = 2  # of a polynomial that takes the picture as constant over each cell
# [sample] around the frame that let its outermost pixels interpolate as all others do
SPARE = NODES // 2
SAMPLED_PIXELS = 16  # along an axis, whose places among the samples stand for all
RESOLUTION = 12  # frequencies to a cycle per sample, or to 2 / q cycles, at which the sampling error is predicted
WIDEST = 8  # [cycle/sample] of these frequencies at most
OPTICS = 6  # wavelengths between which optics are interpolated in that prediction


@dataclass(frozen=True, eq=False)
class Taps:
    """Weights along one axis: pixel i is the sum over t of  weights[i, t] sample[start[i] + t].

    start: int32 (pixels,). weights: float64 (pixels, taps), each row sums to 1: a pixel is a mean over its aperture.
    centres: of the pixels among the samples, sample 0 being 0 .. 1, (pixels,).
    """

    start: np.ndarray
    weights: np.ndarray
    centres: np.ndarray


def frame_start(samples: int, pixels: int, ratio: float) -> float:
    """Where the first pixel's edge lies among `samples`: the frame is in the middle, whole ratios on whole samples."""
    start = (samples - pixels * ratio) / 2
    return start // 1 if float(ratio).is_integer() else max(start, 0.0)


def pixel_taps(
    samples: int,
    pixels: int,
    ratio: float,
    aperture: float,
    start: float,
    nodes: int = NODES,
    displacement: float = 0.0,
) -> Taps:
    """Weights of `samples` cells in `pixels` pixels.

    ratio: samples per pixel. aperture: width of the light-sensitive part [pixel]. start: of the first pixel's edge
    [sample]. nodes: of the interpolating polynomial, NODES or AREA. displacement: of the middle of the light-sensitive
    part from the pixel's [pixel]. What lies beyond the samples is dark.
    """
    centres = start + ratio * (np.arange(pixels) + 0.5 + displacement)
    first, below = _cumulative(centres - ratio * aperture / 2, samples, nodes)
    last, above = _cumulative(centres + ratio * aperture / 2, samples, nodes)
    # the cumulative at node k holds every sample before k: a sample's weight is the sum of all later nodes' weights
    count = int((last - first).max()) + below.shape[1] - 1
    at = first[:, None] + np.arange(count)
    weights = (_behind(at, last, above) - _behind(at, first, below)) / (ratio * aperture)
    # all have as many taps, and none reaches outside
    begin = np.clip(first, 0, max(samples - count, 0))
    kept = np.zeros((pixels, min(count, samples)))
    for row, values, shift in zip(kept, weights, first - begin, strict=True):
        row[shift:] = values[: len(row) - shift]
    return Taps(begin.astype(np.int32), kept, centres)


def point_taps(
    samples: int, pixels: int, ratio: float, start: float, displacement: float, moved: float
) -> Taps:
    """Weights of `samples` that are means over whole pixels already: polynomials through NODES of them, at centres.

    Arguments as of `pixel_taps`. moved: of the means from the middles of the samples [sample].
    """
    centres = start + ratio * (np.arange(pixels) + 0.5 + displacement)
    # the middle of sample k is at k + 1/2
    first, weights = _cumulative(centres - 0.5 - moved, samples - 1, NODES)
    return Taps(first.astype(np.int32), weights, centres)


def apply_border(taps: Taps, samples: int, more: int, border: str) -> Taps:
    """Return taps of `samples` from taps of as many with `more` on each side, which follow the border rule."""
    at = taps.start[:, None] + np.arange(taps.weights.shape[1]) - more
    inside = border_indices(at, samples, border)
    weights = np.where(at == inside, taps.weights, 0) if border == "zero" else taps.weights
    count = int(np.ptp(inside, axis=1).max()) + 1
    start = np.minimum(inside.min(axis=1), samples - count)
    kept = np.zeros((len(at), count))
    np.add.at(kept, (np.arange(len(at))[:, None], inside - start[:, None]), weights)
    return Taps(start.astype(np.int32), kept, taps.centres - more)


def _cumulative(edges, samples, nodes):
    """First node and Lagrange weights of the cumulative at `edges`, from the nearest `nodes` of 0 .. samples."""
    nodes = min(nodes, samples + 1)
    near = np.rint(edges)
    # rounding of places
    edges = np.clip(np.where(np.abs(edges - near) < 1e-9 * samples, near, edges), 0, samples)
    first = np.clip(np.floor(edges).astype(int) - (nodes // 2 - 1), 0, samples + 1 - nodes)
    place, other = np.arange(nodes), ~np.eye(nodes, dtype=bool)
    distance = (edges - first)[:, None] - place
    factors = np.where(other, distance[:, None, :] / np.where(other, place[:, None] - place, 1), 1)
    return first, factors.prod(axis=2)


def _behind(at, first, weights):
    """Sum of the weights of all nodes greater than `at`."""
    sums = np.pad(np.cumsum(weights[:, ::-1], axis=1)[:, ::-1], ((0, 0), (0, 1)))
    return np.take_along_axis(sums, np.clip(at + 1 - first[:, None], 0, weights.shape[1]), axis=1)


def pixel_response(taps, fy, fx) -> np.ndarray:
    """Root mean square over the pixels of the transfer from samples to a pixel at fy, fx [cycle/sample].

    taps: pair of `Taps` (rows, columns). Returns shape (Y, X).
    """
    rows, cols = taps
    return np.sqrt(_mean_response(rows, fy)[1])[:, None] * np.sqrt(_mean_response(cols, fx)[1])


def sampling_error(
    channels: "Moments",
    weights,
    q,
    share,
    ratio: float,
    aperture,
    taps,
    tables: Tables | None = None,
    displacement=(0.0, 0.0),
) -> float:
    """Return the expected relative RMS error of the mosaic from knowing the scene only at its samples.

    The scene is modelled as regions with edges in all directions: power falls as |f|^-3 in two
    dimensions (Porod), scaled to the mean square difference of neighbouring samples. A wave exp(2
    pi i f x) is seen with the transfer A(f) H(f) in place of T(f). A is 1 if samples are the scene
    at points, and sinc if they are means over their cells. H is the transfer of the samples, which
    repeats after each whole cycle per sample. T is of optics and pixel. Samples of one material
    each cannot be means, so A is 1 between materials. The error is of scene structure; point lights
    (highlights) are not included.

    Args:
        channels: Moments of the scene's channels.
        weights: Electrons per content, shape (C, L).
        q: Wavelength times f-number over the distance of samples, shape (L,).
        share: Part of the pixels that has each channel, shape (C,).
        ratio: Scene samples per pixel.
        aperture: Height and width of a pixel's aperture [pixel].
        taps: Pair of `Taps` (rows, columns); None if each pixel is one sample.
        tables: Of the lens; None without blur.
        displacement: Of the apertures' middles from the samples, (rows, cols) [pixel], if there
            are no taps.
    """
    if not share @ channels.squares > 0:
        return 0.0
    waves = _Waves(2.0 if tables is None else float(q.min()))
    optical = [None] * len(share)
    if tables is not None:
        optical = _channel_optics(waves, weights * channels.means, q, ratio, tables)
    mean = square = np.ones((len(waves.all), len(waves.all)))
    if taps is not None:
        rows, cols = taps
        mean_y, square_y = _mean_response(rows, waves.all)
        mean_x, square_x = _mean_response(cols, waves.all)
        mean, square = mean_y[:, None] * mean_x, square_y[:, None] * square_x
    error = 0.0
    for channel, part in enumerate(share):
        per_jump, per_change = _unit_errors(
            optical[channel], waves, ratio, aperture, mean, square, displacement
        )
        error += part * (
            per_jump * channels.jumps[channel] + per_change * channels.changes[channel]
        )
    return float(np.sqrt(max(error, 0.0) / (share @ channels.squares)))  # rounding below 0


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of a content seen by C channels.

    means: the mean spectrum, shape (L,). squares: mean squares of the channels (C,). jumps, changes: mean squares of
    differences between neighbours, summed over both directions: from one material to another, and all others (C,).
    """

    means: np.ndarray
    squares: np.ndarray
    jumps: np.ndarray
    changes: np.ndarray


def moments(pairs: Content, seen, weight: np.ndarray | None = None) -> Moments:
    """Return moments of pairs of neighbouring rows, one above the other, in channels `mean_and_truth` (C, rows, cols).

    weight: of each pair, 1 in the mean, (n,); None: equal weights.
    """
    if weight is not None:
        seen = seen * np.sqrt(np.repeat(weight, 2))[:, None]
    upper, lower, ids = seen[:, ::2], seen[:, 1::2], pairs.labels
    down: Any = False if ids is None else ids[::2] != ids[1::2]
    across: Any = False if ids is None else ids[::2, 1:] != ids[::2, :-1]
    jumps = changes = np.zeros(len(seen))
    for step, jumped in ((lower - upper, down), (np.diff(upper, axis=2), across)):
        if step.size:
            changed = np.where(jumped, 0, step)
            changes = changes + _mean_squares(changed)
            jumps = jumps + _mean_squares(step - changed)
    used = pairs.used(slice(None, None, 2)) @ pairs.entry_spectra
    return Moments(np.maximum(used, 0) / upper[0].size, _mean_squares(upper), jumps, changes)


def _mean_squares(planes):
    return np.einsum("cyx,cyx->c", planes, planes) / planes[0].size


class _Waves:
    """Frequencies at which samples and pixels are followed: places + replicas, equal on both axes [cycle/sample].

    places: in -1/2 .. 1/2, within the cut-off 1 / q. replicas: whole numbers. step: between the
    places. all: every frequency, replica by replica. power: of a scene with edges, of these
    frequencies along both axes.
    """

    def __init__(self, q):
        """For optics of wavelength times f-number over sample distance `q`, the smallest."""
        steps = RESOLUTION * max(1, ceil(q / 2))
        places = np.arange(-(steps // 2), (steps + 1) // 2) / steps
        widest = max(4, min(ceil(1 / q), WIDEST))
        self.replicas = np.arange(-widest, widest + 1)
        self.places, self.step = places[np.abs(places) <= 1 / q], 1 / steps
        self.all = (self.replicas[:, None] + self.places).ravel()
        self.power = _porod(self.all)

    def fold(self, transfer) -> np.ndarray:
        """The sum over waves whole cycles per sample apart, which give the same samples, at each of them."""
        k, n = len(self.replicas), len(self.places)
        return np.tile(transfer.reshape(k, n, k, n).sum(axis=(0, 2)), (k, k))


def _channel_optics(waves, seen, q, ratio, lens_tables):
    """Each channel's transfer function of the optics, without pixels, at the waves, (C, F, F).

    seen: light of each wavelength in each channel, (C, L). Under spiky lights some interpolation
    weights are negative: their sizes count, which keeps a channel's function a mean over the
    wavelengths.
    """
    share = np.abs(seen)
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
    nodes, between = wavelength_nodes(q, OPTICS)  # q goes with the wavelength
    # tables of a grid so fine that nothing is folded onto another frequency, over their own cells' transfer
    finer = 1 if q.min() >= 2 else len(waves.replicas)
    n = finer * round(1 / waves.step)
    tables = np.asarray(lens_tables.of(nodes * finer, 1.0, n, n, ratio * finer), np.float64)
    tables = np.tensordot(share @ between, tables, 1)
    if tables.shape[2] == n // 2 + 1:  # a quarter: the index of |frequency|
        fold = np.minimum(np.arange(n), n - np.arange(n))
        tables = tables[:, fold[:, None], fold]
    else:  # a half of complex numbers: the rest are the conjugates of the opposite frequencies
        half, back = np.ascontiguousarray(tables).view(complex), -np.arange(n) % n
        tables = np.concatenate([half, half[:, back][..., back[n // 2 + 1 :]].conj()], axis=2)
    index = np.rint(waves.all / waves.step).astype(int)
    cell = np.where(np.abs(index) <= n // 2, 1 / np.sinc(index / n), 0)
    return tables[:, index[:, None] % n, index % n] * (cell[:, None] * cell)


def _box(f, height=1.0, width=1.0):
    return np.sinc(height * f)[:, None] * np.sinc(width * f)


def _porod(f):
    """|f|^-3 over both axes, without what is flat."""
    square = np.add.outer(f**2, f**2)
    square[square == 0] = np.inf
    return 1 / (square * np.sqrt(square))


@cache
def _difference_power(means: bool) -> float:
    """Mean square difference of neighbouring samples, summed over both directions, of a scene of power |f|^-3."""
    f = (
        np.arange(9 * 48) + 0.5
    ) / 96  # of a quarter of the waves; the others are their mirror images
    slope = 4 * np.sin(np.pi * f) ** 2
    power = _porod(f) * (_box(f) ** 2 if means else 1.0)
    return float(4 * (power * (slope[:, None] + slope)).sum() / 96**2)


def _unit_errors(optical, waves, ratio, aperture, mean, square, displacement):
    """Mean square errors where samples differ by 1 in the mean square: points, means.

    optical: (F, F), or None without blur. mean, square: of the responses of pixels, see `_mean_response`, (F, F).
    """
    f = waves.all
    flat = np.flatnonzero(f == 0)[0], np.flatnonzero(f == 0)[0]
    true = _box(f, ratio * aperture[0], ratio * aperture[1])
    if any(displacement):
        down, across = displacement
        turn = np.exp(2j * np.pi * down * f)[:, None] * np.exp(2j * np.pi * across * f)
        true = true * turn
    seen = np.ones_like(true)  # without blur
    if optical is not None:
        true = optical * true
        seen = waves.fold(true if ratio == 1 else optical * _box(f))
        seen = seen / (np.real(seen[flat]) or 1.0)  # flat fields are exact; 0: no light
    errors = []
    for means in (False, True):
        got = seen * (_box(f) if means else 1.0)
        both = np.real(got * mean * np.conj(true))
        error = np.abs(got) ** 2 * square - 2 * both + np.abs(true) ** 2
        errors.append(float((waves.power * error).sum() * waves.step**2) / _difference_power(means))
    return errors


def _mean_response(taps, f):
    """Mean over pixels, and mean of the square, of the transfer from samples to a pixel, about the pixel's centre."""
    pixels, count = taps.weights.shape
    chosen = np.unique(np.linspace(pixels / 4, 3 * pixels / 4, SAMPLED_PIXELS).astype(int))
    chosen = chosen[chosen < pixels]
    place = taps.start[chosen, None] + np.arange(count) + 0.5 - taps.centres[chosen, None]
    waves = np.exp(2j * np.pi * place[..., None] * f)
    response = np.einsum("it,itf->if", taps.weights[chosen], waves)
    return response.mean(axis=0), (np.abs(response) ** 2).mean(axis=0)
