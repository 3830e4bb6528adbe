"""Kernels and transfer tables of a pupil with a mask, in the scale of the mask's opening.

Kernels are sums of samples of the irradiance, exact at the edges of cells (`gpusim.optics.amplitude`). The transfer
function in focus is the autocorrelation of the amplitudes on a grid of which every cell has whole steps: it is bilinear
between the grid's places, exactly if no cell is cut by the pupil's outline. A wavefront adds the transform of the
difference of both irradiances, in a window.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.polynomial.polynomial import polygrid2d
from scipy.sparse import csr_array
from scipy.special import roots_legendre

from gpusim.domain.pupil import Pupil
from gpusim.domain.stored import stored
from gpusim.optics.amplitude import opening_amplitude
from gpusim.optics.mask_edges import edge_strength, edges_of
from gpusim.optics.memo import multiply, remember
from gpusim.optics.opening import Opening
from gpusim.optics.psf import open_parts
from gpusim.optics.quadrature import STEP
from gpusim.optics.sampled import (
    ERROR,
    FLAT,
    NEAR,
    NEAR_PIXELS,
    all_moments,
    all_shares,
    axis_transfer,
    fade,
    fold_shares,
    half_of,
    pixel_shares,
    shares_at,
    size_of,
    wrap_kernel,
)
from gpusim.optics.series import scales

LINES, LINE = 5, 24  # of a wavefront along each direction, and Gauss nodes of a line
WIDEST = 256  # samples of a window on each side of the middle
BETWEEN = 1e-6  # error between wavefronts that are scaled
PER_TURN = 64  # steps of the grid for a wave per half side, but not more than
MOST_STEPS = 1024
CUT = 512  # steps along the opening if the outline cuts cells: the autocorrelation errs by 4e-4 next to frequency 0
LEVELS = (
    128  # steps of the grid of frequencies, up to the cut-off; of polygons, which have ridges, all
)
ROUND, RIDGES = 2e-4, 1e-3  # errors of the grid
PIECE = 1024  # frequencies at a time
FIRST = 16  # places next to frequency 0 that are not left out


class Scaled:
    """A wavefront of a pupil in the scale of its opening, on a grid of samples.

    Attributes:
        opening: The opening.
        wave: Coefficients [i, j] of u^i v^j, without slopes [waves].
        turn: Largest slope of `wave` [waves per half side].
        q: Wavelength times f-number over the distance of samples, of rows and of columns.
        shift: Displacement of the image, (rows, cols) [sample].
    """

    def __init__(self, pupil: Pupil, wave, q: float, shift):
        self.pupil, self.opening = pupil, Opening.of(pupil)
        self.wave, slope = self.opening.scaled(wave)
        self.turn = self.opening.steepest(self.wave)
        self.q = tuple(float(q) / half for half in self.opening.half)
        moved = np.asarray(shift) - 2 * np.array(self.q) * slope
        self.shift = tuple(moved.tolist())

    def irradiance(self, halves) -> np.ndarray:
        """Return the energy of samples around the image, float32 (2 halves[0] + 1, 2 halves[1] + 1)."""
        return _squared(opening_amplitude(self.pupil, self.opening, self.wave, self.turn, halves))

    def axes(self, aperture, spots, soft):
        """Return the arguments of `pixel_shares` after `half`, of rows and of columns."""
        settings = zip(self.q, aperture, spots, self.shift, strict=True)
        return [
            (q, float(width), float(spot), float(soft), move) for q, width, spot, move in settings
        ]


def _squared(amplitude):
    return np.square(amplitude.real) + np.square(amplitude.imag)


def masked_kernel(
    pupil: Pupil, wave, q, shift, size: int, aperture, spots, soft: float = 0.0
) -> np.ndarray:
    """Return the energy of every pixel around a point's image: see `gpusim.optics.sampled.sampled_kernel`."""
    own, at = Scaled(pupil, wave, q, shift), np.arange(size) - size // 2
    return _energies(own, (at, at), own.axes(aperture, spots, soft), is_whole=True)


def masked_energies(
    pupil: Pupil, wave, q, shift, rows, cols, aperture, spots, soft: float = 0.0
) -> np.ndarray:
    """Return the energies of pixels at places around a point's image over their apertures' areas, (R, C).

    Args:
        pupil: The pupil, with a mask.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the pitch.
        shift: Displacement of the image, (rows, cols) [pixel].
        rows: Places of the pixels down, shape (R,) [pixel].
        cols: Places across, shape (C,) [pixel].
        aperture: See `gpusim.optics.sampled.sampled_kernel`.
        spots: See there.
        soft: See there.
    """
    own = Scaled(pupil, wave, q, shift)
    return _energies(own, (rows, cols), own.axes(aperture, spots, soft), is_whole=False)


def _energies(own, places, axes, is_whole):
    """Energies of pixels; is_whole: pixels with gaps, or that overlap, share all light."""
    halves = tuple(
        half_of(2 * float(np.abs(at).max()) + 1, one, (move,))
        for at, one, move in zip(places, own.q, own.shift, strict=True)
    )
    energy, whole = own.irradiance(halves), 1.0
    down, across = (
        shares_at(at - axis[-1], half, *axis[:-1])
        for at, half, axis in zip(places, halves, axes, strict=True)
    )
    if is_whole and min(own.q) < 1:
        every = [all_shares(half, *axis) for half, axis in zip(halves, axes, strict=True)]
        whole += every[0] @ energy @ every[1] - energy.sum(dtype=np.float64)
    return multiply(down, multiply(energy, across.T)) / whole


def masked_moment(pupil: Pupil, wave, q, shift, aperture, spots, soft: float, centroid):
    """Return the first moment of all pixels' energies around a point, (rows, cols) [pixel].

    Arguments as of `gpusim.optics.sampled.moment_of_pixels`.
    """
    own = Scaled(pupil, wave, q, shift)
    if min(own.q) >= 1:
        return np.asarray(centroid)
    halves = tuple(
        int(np.ceil((own.turn + (max(spots) + 3 * soft + NEAR_PIXELS) / (2 * one)) / STEP))
        for one in own.q
    )
    energy = own.irradiance(halves).astype(np.float64)
    axes = own.axes(aperture, spots, soft)
    shares, moments, places = (
        [make(half, *axis) for half, axis in zip(halves, axes, strict=True)]
        for make in (all_shares, all_moments, _places)
    )
    uneven = (shares[0][:, None] * shares[1] - 1) * energy
    down = uneven.sum(axis=1) @ places[0] + moments[0] @ energy @ shares[1]
    across = uneven.sum(axis=0) @ places[1] + shares[0] @ energy @ moments[1]
    return (np.array([down, across]) + centroid) / (1 + uneven.sum())


def _places(half, q, aperture, spot, soft, shift):
    """Places of samples [pixel]."""
    return np.arange(-half, half + 1) * (2 * q * STEP) + shift


def masked_transfer(pupil: Pupil, wave, sx, sy) -> np.ndarray:
    """Return the transfer function at frequencies (sx, sy), in units of the cut-off: see `gpusim.optics.otf.transfer`.

    wave: coefficients [i, j] of x^i y^j of the wavefront [waves].
    """
    own = Scaled(pupil, wave, 1.0, (0.0, 0.0))
    half = own.opening.half
    s = [np.asarray(one, np.float64) / side for one, side in zip((sy, sx), half, strict=True)]
    found = np.zeros(s[0].shape, complex)
    inside = np.flatnonzero(np.maximum(*np.abs(s)) < 1)
    y, x = (one[inside] for one in s)
    *nodes, values = focus_transfer(pupil)
    (i, v), (j, u) = (_cell_of(at, one) for at, one in zip(nodes, (y, x), strict=True))
    found[inside] = (1 - v) * ((1 - u) * values[i, j] + u * values[i, j + 1])
    found[inside] += v * ((1 - u) * values[i + 1, j] + u * values[i + 1, j + 1])
    if own.wave.any():
        left = _difference(pupil, own.wave, window_of(pupil, own.wave)[0])
        at = np.arange(len(left)) - len(left) // 2
        for piece in np.array_split(np.arange(len(inside)), -(-len(inside) // PIECE) or 1):
            down, across = (
                np.exp(np.outer(one[piece], -4j * np.pi * STEP * at)).astype(np.complex64)
                for one in (y, x)
            )
            found[inside[piece]] += np.einsum("fi,fi->f", multiply(down, left), across)
    # the opening's rays may land elsewhere: s q' shift of q' = 1 / half
    return found * np.exp(-2j * np.pi * (np.asarray(sy) * own.shift[0] + sx * own.shift[1]))


def _cell_of(nodes, s):
    """Number of the node before each s, and the part of the way to the next."""
    first = np.searchsorted(nodes, s, "right") - 1
    return first, (s - nodes[first]) / (nodes[first + 1] - nodes[first])


@stored
def masked_tables(pupil: Pupil, waves, q, rows, cols, aperture, spots, soft, shift) -> np.ndarray:
    """Return transfer tables, complex64 (bands, rows, cols // 2 + 1).

    Arguments as of `gpusim.optics.sampled.difference_tables`.
    """
    out = np.zeros((len(waves), rows, cols // 2 + 1), np.complex64)
    focus, frequencies = focus_transfer(pupil), _frequencies(rows, cols)
    scaled = [Scaled(pupil, wave, one, shift) for wave, one in zip(waves, q, strict=True)]
    changes = _Changes(pupil, np.stack([own.wave for own in scaled]))

    def make(band):
        axes = scaled[band].axes(aperture, spots, soft)
        down, across = (
            _between(f, nodes, *axis)
            for f, nodes, axis in zip(frequencies, focus[:2], axes, strict=True)
        )
        out[band] = down @ np.ascontiguousarray((across @ focus[2].T).T)
        changes.add(out[band], band, axes, frequencies, cols)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(waves))))
    return out


class _Changes:
    """What wavefronts change in transfer tables; bands mostly have one wavefront, scaled.

    In a window of the image; if that would be larger than WIDEST, as autocorrelations on the grid of `_grid`.
    """

    def __init__(self, pupil, waves):
        self.pupil, self.waves, self.half = pupil, waves, 0
        self.is_none = not waves.any()
        if self.is_none:
            return
        self.turn = max(map(Opening.of(pupil).steepest, waves))
        _, nodes, self.to_bands = scales(waves, BETWEEN)
        half = max(window_of(pupil, wave)[0] for wave in nodes)
        if half <= WIDEST:
            self.half = half
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                made = pool.map(lambda wave: _difference(pupil, wave, half), nodes)
                self.parts = np.stack(list(made))

    def _on_grid(self, wave):
        """Differences of the autocorrelation at all steps, complex64 (2 n + 1, 2 m + 1)."""
        least = min(max(CUT, int(PER_TURN * self.turn)), MOST_STEPS) + 1
        values, _ = _grid(self.pupil, least)
        v, u = (2 * (np.arange(count) + 0.5) / count - 1 for count in values.shape)
        turned = values * np.exp(2j * np.pi * polygrid2d(u, v, wave).T)
        found = _autocorrelation(self.pupil, turned) - _autocorrelation(self.pupil, values)
        counts = zip(values.shape, found.shape, strict=True)
        steps = [np.arange(-count, count + 1) % length for count, length in counts]
        return found[np.ix_(*steps)].astype(np.complex64)

    def add(self, table, band, axes, frequencies, cols):
        """Add the change of a band to its table (rows, cols // 2 + 1)."""
        if self.is_none:
            return
        if not self.half:
            left = self._on_grid(self.waves[band])
            down, across = (
                _between(f, np.linspace(-1, 1, count), *axis, is_cubic=True)
                for f, count, axis in zip(frequencies, left.shape, axes, strict=True)
            )
            table += down @ np.ascontiguousarray((across @ left.T).T)
            return
        left = np.tensordot(self.to_bands[band].astype(np.float32), self.parts, 1)
        size = max(size_of(axis[0], self.half, axis[-1]) for axis in axes)
        passed = sum(
            min(2 / axis[0], 1) * len(f) for axis, f in zip(axes, frequencies, strict=True)
        )
        if size > passed / 2:  # so few frequencies cost less than as many pixels
            down, across = (
                fold_shares(f, self.half, *axis) for f, axis in zip(frequencies, axes, strict=True)
            )
            some = np.flatnonzero(down.any(axis=1)), np.flatnonzero(across.any(axis=1))
            table[np.ix_(*some)] += multiply(multiply(down[some[0]], left), across[some[1]].T)
            return
        down, across = (pixel_shares(size, self.half, *axis) for axis in axes)
        kernel = multiply(down, multiply(left, across.T))
        table += wrap_kernel(kernel, len(table), cols)


def _frequencies(rows, cols):
    """Frequencies of a half spectrum, down and across [cycle/sample]."""
    return np.fft.fftfreq(rows), np.arange(cols // 2 + 1) / cols


def _between(f, nodes, q, aperture, spot, soft, shift, is_cubic=False):
    """Return the matrix from values at `nodes` of s = f q to those at frequencies f, times the pixel's transfer.

    Linear, or cubic through even nodes.
    """
    row, column, value = [], [], []
    reach = int(np.ceil(1 / q + 0.5))
    for whole in range(-reach, reach + 1):
        inside = np.flatnonzero(np.abs(f + whole) * q < 1)
        one = f[inside] + whole
        passed = axis_transfer(one, aperture, spot, soft) * np.exp(-2j * np.pi * one * shift)
        first, t = _cell_of(nodes, one * q)
        weights = {0: 1 - t, 1: t}
        if is_cubic:
            weights = {
                -1: -t * (t - 1) * (t - 2) / 6,
                0: (t + 1) * (t - 1) * (t - 2) / 2,
                1: -(t + 1) * t * (t - 2) / 2,
                2: (t + 1) * t * (t - 1) / 6,
            }
        for offset, weight in weights.items():
            at = first + offset
            known = (at >= 0) & (at < len(nodes))
            row.append(inside[known])
            column.append(at[known])
            value.append((passed * weight)[known])
    entries = tuple(np.concatenate(part) for part in (row, column))
    matrix = (np.concatenate(value).astype(np.complex64), entries)
    return csr_array(matrix, shape=(len(f), len(nodes)))


def _difference(pupil, wave, half):
    """Irradiance with a wavefront less that in focus, which fades out and has the sum 0, (samples, samples)."""
    opening, halves = Opening.of(pupil), (half, half)
    turn = opening.steepest(wave)
    flat = opening_amplitude(pupil, opening, np.zeros((1, 1)), 0.0, halves)
    own = opening_amplitude(pupil, opening, wave, turn, halves)
    weight = fade(half)
    left = (_squared(own) - _squared(flat)) * weight
    return left - weight * np.float32(left.sum(dtype=np.float64) / weight.sum(dtype=np.float64))


def focus_error(pupil: Pupil) -> float:
    """Return the error of the transfer function in focus that a grid makes."""
    if not _is_cut(pupil):
        return 0.0
    return RIDGES if pupil.sides.size else ROUND


def window_of(pupil: Pupil, wave: np.ndarray) -> tuple[int, float]:
    """Return `half` of the irradiance that holds what a wavefront changes, and the error of transfer tables.

    As `gpusim.optics.sampled.window`: beyond a radius X there is the share pi t / X of the light, t the strength of the
    edges. Straight edges throw it along few lines, whose profiles have transfer functions of their own. A wavefront
    changes the mean of these (`_change_of_lines`).

    wave: in the scale of the opening, see `gpusim.optics.opening.Opening.scaled` [waves].
    """
    return _window(pupil, np.round(wave, 9).tobytes(), wave.shape)


@lru_cache(maxsize=1024)
def _window(pupil, values, shape):
    wave, opening = np.frombuffer(values).reshape(shape), Opening.of(pupil)
    slope, strength = opening.steepest(wave), np.pi * edge_strength(pupil, opening.half)
    shares = edges_of(pupil).shares(opening.half)
    straight = max(shares.values(), default=0.0) * _change_of_lines(wave)
    rest = 0.6 * max(1 - sum(shares.values()), 0.0)
    farthest = 1.1 * slope / FLAT + NEAR
    while True:
        radius = FLAT * farthest
        moved = min(3 * (slope / radius) ** 2, 1.0)
        error = float(1.5 * strength / radius * max(straight, rest * moved))
        if error <= ERROR:
            return int(np.ceil(farthest / STEP)), error
        farthest *= 1.1


def _change_of_lines(wave):
    """Return the most that a wavefront changes the mean transfer function of parallel lines of the opening, 0 .. 1."""
    u, share = roots_legendre(LINE)
    at = np.linspace(-1, 1, LINES)
    s = (np.arange(LINE // 2) + 0.5) / (LINE // 2)
    # the overlap of a line with itself, at l - s and l + s
    long = (1 - s)[:, None] * u
    most = 0.0
    for turned in (wave, wave.T):
        change = [
            polygrid2d(at, (long + side * s[:, None]).ravel(), turned).reshape(LINES, *long.shape)
            for side in (1, -1)
        ]
        mean = (np.exp(2j * np.pi * (change[0] - change[1])) @ (share / 2)).mean(axis=0)
        most = max(most, float((np.abs(mean - 1) * (1 - s)).max()))
    return min(most, 1.0)


@remember(2**27)
def focus_transfer(pupil: Pupil) -> tuple[np.ndarray, ...]:
    """Return the transfer function in focus at places of s = f q in the scale of the opening, complex64.

    Returns:
        Places down and across, ascending from -1 to 1, and the values between which it is bilinear.
    """
    values, cells = _grid(pupil, CUT)
    counts = values.shape
    found = _autocorrelation(pupil, values)
    levels = CUT if pupil.sides.size else LEVELS
    steps = [_kept(count, own, levels) for count, own in zip(counts, cells, strict=True)]
    found = found[np.ix_(*(step % length for step, length in zip(steps, found.shape, strict=True)))]
    found[np.ix_(steps[0] == 0, steps[1] == 0)] = 1
    down, across = (step / count for step, count in zip(steps, counts, strict=True))
    return down, across, found.astype(np.complex64)


def _autocorrelation(pupil, values):
    """Autocorrelation of amplitudes on a grid over the opening, over the open area, by steps in a period.

    There are at least 2 n + 1 steps, so that it is 0 n steps from the middle.
    """
    spectrum = scipy.fft.fft2(values, [scipy.fft.next_fast_len(2 * n + 1) for n in values.shape])
    found = scipy.fft.ifft2(np.square(spectrum.real) + np.square(spectrum.imag))
    opening = Opening.of(pupil).half
    return found * (4 * opening[0] * opening[1] / values.size / (np.pi * pupil.area))


def _kept(count, cells, levels):
    """Steps of the grid, -count .. count, at which the autocorrelation is kept: bends are at multiples of cells."""
    every = np.arange(count + 1)
    fine = every <= FIRST
    graded = every % max(count // levels, 1) == 0
    near = (every <= 8 * FIRST) & (every % 4 == 0)
    kept = every[fine | near | graded | (every % (count // cells) == 0)]
    return np.concatenate([-kept[:0:-1], kept])


def _grid(pupil, least):
    """Amplitudes of the steps of a grid over the opening, and the number of cells along both axes.

    least: Steps along an axis, if the outline cuts cells or there is a wavefront.
    """
    assert pupil.mask is not None
    edges_y, edges_x, values = pupil.mask.pieces
    cells = [
        int(np.rint((edges[-1] - edges[0]) / 2 * count))
        for edges, count in zip((edges_y, edges_x), pupil.mask.values.shape, strict=True)
    ]
    is_cut = _is_cut(pupil)
    counts = [one * (-(-least // one) if is_cut or least > CUT else 1) for one in cells]
    at_y, at_x = (
        np.linspace(edges[0], edges[-1], count + 1)
        for edges, count in zip((edges_y, edges_x), counts, strict=True)
    )
    own = [
        np.searchsorted(edges, (at[1:] + at[:-1]) / 2) - 1
        for edges, at in ((edges_y, at_y), (edges_x, at_x))
    ]
    found = values[np.ix_(*own)]
    return found if not is_cut else found * open_parts(pupil, at_y, at_x), cells


def _is_cut(pupil):
    """Whether the outline cuts a cell that has light."""
    edges_y, edges_x, values = pupil.mask.pieces
    rows, cols = np.nonzero(values)
    y, x = (
        np.stack([edges[place], edges[place + 1]])
        for edges, place in ((edges_y, rows), (edges_x, cols))
    )
    y, x = y[:, None], x[None]  # corners, (2, 2, cells)
    if (np.hypot(y, x) > 1).any():
        return True
    for angle in pupil.sides:
        if (x * np.cos(angle) + y * np.sin(angle) > pupil.inner_radius).any():
            return True
    nearest = [np.clip(0, one.min(axis=axis), one.max(axis=axis)) for axis, one in ((0, y), (1, x))]
    return bool(np.hypot(nearest[0].ravel(), nearest[1].ravel()).min() < pupil.obscuration)
