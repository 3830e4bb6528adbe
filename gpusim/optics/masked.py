"""Kernels and transfer tables of a pupil with a mask, in the scale of the mask's opening.

Kernels are sums of samples of the irradiance, exact at the edges of cells (`gpusim.optics.amplitude`). The transfer
function in focus is the autocorrelation of the amplitudes on a grid of which every cell has whole steps: it is bilinear
between the grid's places, exactly if no cell is cut by the pupil's outline. A wavefront adds the transform of the
difference of both irradiances, in a window.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.fft
from scipy.sparse import csr_array

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
        left = _difference(own)
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
    focus = focus_transfer(pupil)

    def make(band):
        own = Scaled(pupil, waves[band], q[band], shift)
        axes = own.axes(aperture, spots, soft)
        down, across = (
            _between(f, nodes, *axis)
            for f, nodes, axis in zip(_frequencies(rows, cols), focus[:2], axes, strict=True)
        )
        lines = np.ascontiguousarray((across @ focus[2].T).T)
        out[band] = down @ lines
        if own.wave.any():
            out[band] += _difference_table(own, rows, cols, axes)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(waves))))
    return out


def _frequencies(rows, cols):
    """Frequencies of a half spectrum, down and across [cycle/sample]."""
    return np.fft.fftfreq(rows), np.arange(cols // 2 + 1) / cols


def _between(f, nodes, q, aperture, spot, soft, shift):
    """Return the matrix from values at `nodes` of s = f q to those at frequencies f, times the pixel's transfer."""
    row, column, value = [], [], []
    reach = int(np.ceil(1 / q + 0.5))
    for whole in range(-reach, reach + 1):
        inside = np.flatnonzero(np.abs(f + whole) * q < 1)
        one = f[inside] + whole
        passed = axis_transfer(one, aperture, spot, soft) * np.exp(-2j * np.pi * one * shift)
        first, part = _cell_of(nodes, one * q)
        row += [inside, inside]
        column += [first, first + 1]
        value += [passed * (1 - part), passed * part]
    entries = (np.concatenate(part) for part in (row, column))
    matrix = (np.concatenate(value).astype(np.complex64), tuple(entries))
    return csr_array(matrix, shape=(len(f), len(nodes)))


def _difference_table(own, rows, cols, axes):
    """Transfer table of the wavefront less that in focus, in a window."""
    left = _difference(own)
    half = len(left) // 2
    size = max(size_of(one, half, move) for one, move in zip(own.q, own.shift, strict=True))
    passed = [min(2 / one, 1) * count for one, count in zip(own.q, (rows, cols / 2), strict=True)]
    if size > sum(passed) / 2:  # so few frequencies cost less than as many pixels
        down, across = (
            fold_shares(f, half, *axis)
            for f, axis in zip(_frequencies(rows, cols), axes, strict=True)
        )
        some = np.flatnonzero(down.any(axis=1)), np.flatnonzero(across.any(axis=1))
        found = np.zeros((rows, cols // 2 + 1), np.complex64)
        found[np.ix_(*some)] = multiply(multiply(down[some[0]], left), across[some[1]].T)
        return found
    down, across = (pixel_shares(size, half, *axis) for axis in axes)
    return wrap_kernel(multiply(down, multiply(left, across.T)), rows, cols)


def _difference(own):
    """Irradiance with the wavefront less that in focus, which fades out and has the sum 0, (samples, samples)."""
    half, _ = window_of(own)
    flat = opening_amplitude(own.pupil, own.opening, np.zeros((1, 1)), 0.0, (half, half))
    weight = fade(half)
    left = (own.irradiance((half, half)) - _squared(flat)) * weight
    return left - weight * np.float32(left.sum(dtype=np.float64) / weight.sum(dtype=np.float64))


def focus_error(pupil: Pupil) -> float:
    """Return the error of the transfer function in focus that a grid makes."""
    if not _is_cut(pupil):
        return 0.0
    return RIDGES if pupil.sides.size else ROUND


def window_of(own: Scaled) -> tuple[int, float]:
    """Return `half` of the irradiance that holds what a wavefront changes, and the error of transfer tables.

    As `gpusim.optics.sampled.window`: beyond a radius X there is the share pi t / X of the light, t the strength of the
    edges. Straight edges throw it along few lines. A wavefront that moves rays by b < 1 changes the phases of its
    transform by less than 4 pi b.
    """
    half, slope = own.opening.half, own.turn
    strength = np.pi * edge_strength(own.pupil, half)
    share = max(edges_of(own.pupil).shares(half).values(), default=0.0)
    phase = min(4 * np.pi * slope, 1.0)
    farthest = 1.1 * slope / FLAT + NEAR
    while True:
        radius = FLAT * farthest
        moved = min(3 * (slope / radius) ** 2, 1.0)
        error = float(strength / radius * max(share, 0.6 * moved) * phase)
        if error <= ERROR:
            return int(np.ceil(farthest / STEP)), error
        farthest *= 1.1


@remember(2**27)
def focus_transfer(pupil: Pupil) -> tuple[np.ndarray, ...]:
    """Return the transfer function in focus at places of s = f q in the scale of the opening, complex64.

    Returns:
        Places down and across, ascending from -1 to 1, and the values between which it is bilinear.
    """
    values, cells = _grid(pupil)
    counts = values.shape
    lengths = [scipy.fft.next_fast_len(2 * count) for count in counts]
    spectrum = scipy.fft.fft2(values, lengths)
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    found = scipy.fft.ifft2(power)
    levels = CUT if pupil.sides.size else LEVELS
    steps = [_kept(count, own, levels) for count, own in zip(counts, cells, strict=True)]
    found = found[np.ix_(*(step % length for step, length in zip(steps, lengths, strict=True)))]
    opening = Opening.of(pupil).half
    area = np.pi * pupil.area / (opening[0] * opening[1])
    found *= 4 / (counts[0] * counts[1]) / area
    for axis, count in enumerate(counts):  # nothing beyond the cut-off
        found = np.where(np.expand_dims(np.abs(steps[axis]) == count, 1 - axis), 0, found)
    found[np.ix_(steps[0] == 0, steps[1] == 0)] = 1
    down, across = (step / count for step, count in zip(steps, counts, strict=True))
    return down, across, found.astype(np.complex64)


def _kept(count, cells, levels):
    """Steps of the grid, -count .. count, at which the autocorrelation is kept: bends are at multiples of cells."""
    every = np.arange(count + 1)
    fine = every <= FIRST
    graded = every % max(count // levels, 1) == 0
    near = (every <= 8 * FIRST) & (every % 4 == 0)
    kept = every[fine | near | graded | (every % (count // cells) == 0)]
    return np.concatenate([-kept[:0:-1], kept])


def _grid(pupil):
    """Amplitudes of the steps of a grid over the opening, and the number of cells along both axes."""
    assert pupil.mask is not None
    edges_y, edges_x, values = pupil.mask.pieces
    cells = [
        int(np.rint((edges[-1] - edges[0]) / 2 * count))
        for edges, count in zip((edges_y, edges_x), pupil.mask.values.shape, strict=True)
    ]
    is_whole = not _is_cut(pupil)
    counts = [one * (1 if is_whole else -(-CUT // one)) for one in cells]
    at_y, at_x = (
        np.linspace(edges[0], edges[-1], count + 1)
        for edges, count in zip((edges_y, edges_x), counts, strict=True)
    )
    own = [
        np.searchsorted(edges, (at[1:] + at[:-1]) / 2) - 1
        for edges, at in ((edges_y, at_y), (edges_x, at_x))
    ]
    found = values[np.ix_(*own)]
    return found if is_whole else found * open_parts(pupil, at_y, at_x), cells


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
