"""Point spreads by Fourier transforms of a sampled pupil.

Lengths in the image are X = x / (2 lambda N), cycles of the pupil's phase per radius. The amplitude

    A(X, Y) = integral over the pupil of  exp(2 pi i (W(u, v) - X u - Y v)) du dv

is a sum over rows of the pupil, at Gauss nodes v between the kinks of its outline. Along a row the samples are even,
so that all rows share their waves. Samples next to the row's ends have the weights that integrate the polynomial
through the nearest ORDER of them up to the true end: the edge costs no accuracy. The irradiance |A|^2 has no
frequencies beyond the cut-off, so samples 1/4 apart (lambda N / 2) determine it. A pixel's share of each sample is the
transform of its aperture up to the cut-off, which separates into rows and columns.

Kernels end. Beyond them light falls as r^-3 along all directions of the pupil's edge, for every wavefront. `tables`
takes it from the pupil in focus, whose transfer function is exact: it adds only the difference of the kernels, which
falls as r^-5.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.fft
from scipy.special import roots_legendre

from gpusim.domain.pupil import Pupil, chord, hole_chord
from gpusim.domain.stored import stored
from gpusim.optics.amplitude import image_amplitude
from gpusim.optics.blas import one_core
from gpusim.optics.farfield import edge_tail
from gpusim.optics.memo import multiply, remember
from gpusim.optics.otf import FAST, transfer
from gpusim.optics.psf import fastest_turn, steepest_slope
from gpusim.optics.quadrature import FINE, ORDER, STEP, even_places, share_of_end

# [pixel] beyond the rays; with 32, moments of pixels change by 1e-4 pixel, of pixels with gaps by 1e-3
NEAR_PIXELS = 4.0
MARGIN = 0.5  # [pixel] and
MORE = 12  # samples around a kernel that its pixels share
ERROR = 1e-3  # of transfer functions, by light that leaves the window
NEAR = 12.0  # [X] of the window beyond the rays
FLAT = 0.75  # part of the window up to which differences count in full
PIECE = 1024  # frequencies at a time
PAIRED = 1e-12  # by which rows on both sides of the middle may differ
NODES = 4  # of the Gauss nodes of half a panel where nothing turns
PER_CYCLE = 1.5  # of them for every cycle of the phase from one end of the panel to the other


def _panels(pupil, cycles):
    """Rows v of a polygon (R,) and their weights: Gauss nodes between its corners."""
    places, masses = [], []
    for low, high in pairwise(np.unique(np.round(np.sin(pupil.corners), 12))):
        # how far the ends of rows move over the panel, along and across
        edges = np.array(chord(pupil, np.array([low, high])))
        moved = high - low + np.abs(np.diff(edges)).max()
        # none of the nodes in the middle
        x, gauss = _gauss(2 * (NODES + int(np.ceil(0.5 * PER_CYCLE * cycles * moved))))
        places.append(low + (high - low) * (x + 1) / 2)
        masses.append(gauss * (high - low) / 2)
    return np.concatenate(places), np.concatenate(masses)


def _circle(radius, cycles):
    """Rows v of a circle (R,) and their weights.

    Sums along rows are sqrt(radius^2 - v^2) times a smooth function: Gauss nodes of that weight (Chebyshev, second
    kind).
    """
    turns = cycles * radius
    count = 2 * int(np.ceil(np.pi / 2 * turns + 2 * np.cbrt(turns))) + 4 * NODES
    turn = np.arange(1, count + 1) * (np.pi / (count + 1))
    return -radius * np.cos(turn), radius * np.sin(turn) * (np.pi / (count + 1))


@lru_cache(maxsize=256)
def _gauss(count):
    return roots_legendre(count)


def rows_of(pupil: Pupil, cycles: float, count: int, diagonal: float):
    """Rows of a pupil: places v (R,), and the weights of `count` even samples u of each row (R, count), float32.

    An obstruction has rows of its own, of negative weights. cycles: of the fastest phase per radius, along rows and
    columns. diagonal: the same in any direction.
    """
    step, u = even_places(count)
    v, mass = _panels(pupil, cycles) if pupil.sides.size else _circle(1.0, diagonal)
    left, right = chord(pupil, v)
    weights = _between(left, right, u, step) * (mass * step)[:, None]
    if hole := pupil.obscuration:
        rows, mass = _circle(hole, diagonal)
        less = _between(*hole_chord(pupil, rows), u, step) * (mass * step)[:, None]
        v, weights = np.concatenate([v, rows]), np.concatenate([weights, -less])
    return v, weights.astype(np.float32)


def _between(left, right, u, step):
    return share_of_end((right[:, None] - u) / step) - share_of_end((left[:, None] - u) / step)


def irradiance(pupil: Pupil, wave, half: int) -> np.ndarray:
    """Return the energy of (2 half + 1)^2 samples around a point's image, STEP apart; all of the image has energy 1.

    float32, rows first. wave: coefficients [i, j] of x^i y^j of the wavefront [waves].
    """
    if pupil.mask is not None:
        return np.square(np.abs(image_amplitude(pupil, wave, half)))
    wave = np.asarray(wave, np.float64)
    return _irradiance(pupil, half, wave.shape, np.round(wave, 12).tobytes())


@remember(2**27)
def _irradiance(pupil, half, shape, values):
    wave = np.frombuffer(values).reshape(shape)
    cycles = half * STEP + fastest_turn(wave)
    # rounded up, so that wavelengths and places share rows
    cycles = float(np.exp2(np.ceil(8 * np.log2(max(cycles, 4))) / 8))
    even = len(pupil.sides) % 2 == 0 and not _odd(wave).any()
    v, u, weights, cos_u, sin_u, cos_v, sin_v = _grid(pupil, half, cycles, even)
    powers = np.arange(len(wave))
    # sums with cosines and sines over u, then over v, for X and Y >= 0; signs make the other quadrants
    by_cos, by_sin = np.empty((2, len(v), 2 * (half + 1)), np.float32)
    middle = len(u) // 2
    with one_core():
        path = v[:, None] ** powers @ (wave.T @ u ** powers[:, None])
        path -= np.rint(path)
        phase = path.astype(np.float32)
        phase *= np.float32(2 * np.pi)
        parts = slice(half + 1), slice(half + 1, None)
        for part, turn in zip(parts, (np.cos, np.sin), strict=True):
            values = turn(phase)
            values *= weights
            right, left = values[:, middle:], values[:, middle - 1 :: -1]
            by_cos[:, part] = (right + left) @ cos_u
            by_sin[:, part] = (right - left) @ sin_u
        if (upper := cos_v.shape[1]) < len(v):  # rows v, then rows -v
            up_cos, down_cos, up_sin, down_sin = (
                part for by in (by_cos, by_sin) for part in (by[:upper], by[upper:])
            )
            straight, crossed = cos_v @ (up_cos + down_cos), sin_v @ (up_sin - down_sin)
            along, across = cos_v @ (up_sin + down_sin), sin_v @ (up_cos - down_cos)
        else:
            straight, crossed = cos_v @ by_cos, sin_v @ by_sin
            if not even:
                along, across = cos_v @ by_sin, sin_v @ by_cos
    minus, plus = straight - crossed, straight + crossed
    energy = np.empty((2 * half + 1,) * 2, np.float32)
    below, above = slice(half, None), slice(half, None, -1)
    if even:
        energy[below, below] = energy[above, above] = _squares(minus)
        energy[below, above] = energy[above, below] = _squares(plus)
    else:
        along, across = _turn(along), _turn(across)
        both, rest = along + across, along - across
        energy[below, below], energy[above, above] = _squares(minus + both), _squares(minus - both)
        energy[below, above], energy[above, below] = _squares(plus - rest), _squares(plus + rest)
    energy *= np.float32((4 if even else 1) * STEP**2 / (np.pi * pupil.area))
    return energy


@remember(2**26)
def _grid(pupil, half, cycles, upper):
    """Rows v, their even samples u, the samples' weights, and cosines and sines of all X >= 0 at u > 0 and at v.

    upper: only rows v > 0: rows -v are the rows v from right to left. Else, if each row v has a row -v, rows v > 0 come
    first, then rows -v in the same order, and cosines and sines at v are of the first.
    """
    count = 2 * int(np.ceil(FINE * cycles)) + ORDER
    diagonal = cycles + (np.sqrt(2) - 1) * half * STEP
    v, weights = rows_of(pupil, cycles, count, diagonal)
    some = v
    if upper:
        v, weights = v[v > 0], weights[v > 0]
        some = v
    else:
        above, below = np.flatnonzero(v > 0), np.flatnonzero(v < 0)
        above, below = above[np.argsort(v[above])], below[np.argsort(-v[below])]
        if len(above) == len(below) and np.abs(v[above] + v[below]).max() < PAIRED:
            order, some = np.concatenate([above, below]), v[above]
            v, weights = v[order], weights[order]
    _, u = even_places(count)
    x = 2 * np.pi * STEP * np.arange(half + 1)
    along, across = np.outer(u[count // 2 :], x), np.outer(x, some)
    waves = (
        turn(phase).astype(np.float32) for phase in (along, across) for turn in (np.cos, np.sin)
    )
    return v, u, weights, *waves


def _turn(pair):
    """Complex numbers times i, of pairs of parts that stand side by side."""
    half = pair.shape[1] // 2
    out = np.empty_like(pair)
    np.negative(pair[:, half:], out=out[:, :half])
    out[:, half:] = pair[:, :half]
    return out


def _squares(pair):
    """Squares of sizes of pairs of parts that stand side by side."""
    half = pair.shape[1] // 2
    return pair[:, :half] ** 2 + pair[:, half:] ** 2


def _odd(wave):
    """The coefficients of a wavefront of odd order."""
    i, j = np.indices(wave.shape)
    return wave * ((i + j) % 2)


@remember(2**25)
def pixel_shares(size, half, q, aperture, spot, soft, shift) -> np.ndarray:
    """Return the share of each sample of the irradiance in each of `size` pixels, float32 (size, 2 half + 1).

    It is the transform of the pixel's aperture up to the cut-off 1 / q [cycle/pixel].

    Args:
        size: Pixels, odd.
        half: See `irradiance`.
        q: Wavelength times working f-number over the pitch.
        aperture: Width over which a pixel is integrated [pixel].
        spot: Half of the distance of a low-pass filter's images [pixel].
        soft: Standard deviation of a diffuser [pixel].
        shift: Displacement of the image [pixel].
    """
    if not shift:  # pixels are mirror images
        right = shares_at(np.arange(size // 2 + 1.0), half, q, aperture, spot, soft)
        return np.concatenate([right[:0:-1, ::-1], right])
    return shares_at(np.arange(size) - size // 2.0 - shift, half, q, aperture, spot, soft)


def shares_at(pixels, half, q, aperture, spot, soft):
    """Return shares of samples in pixels at these places, float32 (pixels, samples)."""
    farthest = int(np.ceil(np.abs(pixels).max()))
    f, by_cos, by_sin = _passed_waves(half, q, aperture, spot, soft, farthest)
    to = 2 * np.pi * np.outer(pixels, f)
    even = multiply(np.cos(to).astype(np.float32), by_cos)
    odd = multiply(np.sin(to).astype(np.float32), by_sin)
    return np.concatenate([(even - odd)[:, :0:-1], even + odd], axis=1)


@remember(2**25)
def _passed_waves(half, q, aperture, spot, soft, farthest):
    """Frequencies (F,), and their cosines and sines times the pixel's transfer, float32 (F, half + 1).

    They are at the samples from the middle on: cosines are even, sines odd.
    """
    samples = np.arange(half + 1) * (2 * q * STEP)
    count = 1.7 * (samples[-1] + farthest) / q + 16
    x, gauss = _gauss(64 * int(np.ceil(count / 64)))  # bands share nodes
    f, gauss = (x + 1) / (2 * q), gauss / (2 * q)
    passed = (2 * gauss * axis_transfer(f, aperture, spot, soft))[:, None]
    of = 2 * np.pi * np.outer(f, samples)
    return f, *((turn(of) * passed).astype(np.float32) for turn in (np.cos, np.sin))


def axis_transfer(f, aperture, spot, soft):
    """Transfer function of aperture, low-pass filter and diffuser along one axis at f [cycle/pixel]."""
    passed = np.sinc(aperture * f) * np.cos(2 * np.pi * spot * f)
    return passed * np.exp(-2 * (np.pi * soft * f) ** 2)


@lru_cache(maxsize=128)
def all_shares(half, q, aperture, spot, soft, shift):
    """Sum of `pixel_shares` over all pixels of an endless grid, (samples,): 1 if apertures tile or q >= 1."""
    samples = np.arange(-half, half + 1) * (2 * q * STEP)
    f = np.arange(1, int(np.ceil(1 / q)))
    waves = np.cos(2 * np.pi * np.multiply.outer(samples + shift, f))
    return 1 + 2 * waves @ axis_transfer(f, aperture, spot, soft)


def sampled_kernel(
    pupil: Pupil, wave, q, shift, size: int, aperture, spots, soft: float = 0.0
) -> np.ndarray:
    """Return the energy of every pixel around a point's image, (size, size), of energy 1 in all the image.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the pitch.
        shift: Displacement of the image, (rows, cols) [pixel].
        size: Side of the kernel [pixel], odd.
        aperture: Height and width over which each pixel is integrated [pixel]. Apertures that leave gaps, or
            overlap, share the light as if they tiled the image.
        spots: Distances of a low-pass filter's spots from their middle, (rows, cols) [pixel].
        soft: Standard deviation of a diffuser [pixel].
    """
    half = half_of(size, q, shift)
    energy, axes = irradiance(pupil, wave, half), _axes(q, shift, aperture, spots, soft)
    down, across = (pixel_shares(size, half, *axis) for axis in axes)
    whole = 1.0
    if q < 1:  # apertures with gaps share all light
        all_down, all_across = (all_shares(half, *axis) for axis in axes)
        whole += all_down @ energy @ all_across - energy.sum(dtype=np.float64)
    return multiply(down, multiply(energy, across.T)) / whole


def sketched_kernel(
    pupil: Pupil, wave, q, shift, size: int, aperture, spots, soft: float = 0.0
) -> np.ndarray:
    """Return a kernel like that of `sampled_kernel` in a fraction of the time, float32 of sum 1.

    Light more than NEAR beyond the rays is left out, and the rest is as much brighter. Arguments: see there.
    """
    near = int(np.ceil((fastest_turn(wave) + NEAR) / STEP))
    half = min(half_of(size, q, shift), near)
    energy, axes = irradiance(pupil, wave, half), _axes(q, shift, aperture, spots, soft)
    down, across = (pixel_shares(size, half, *axis) for axis in axes)
    kernel = multiply(down, multiply(energy, across.T))
    return kernel / kernel.sum()


def half_of(size, q, shift) -> int:
    """Return `half` of the irradiance that a kernel's pixels share."""
    reach = size / 2 + max(map(abs, shift)) + MARGIN
    return int(np.ceil(reach / (2 * q * STEP))) + MORE


def moment_of_pixels(
    pupil: Pupil, wave, q, shift, aperture, spots, soft: float, centroid, size: int = 1
) -> np.ndarray:
    """Return the first moment of all pixels' energies around a point, (rows, cols) [pixel].

    It is the light's centroid if q >= 1. Coarser pixels do not follow a small spot that moves within them. The
    difference is a mean of waves of whole cycles per pixel over the light, so light far from the point does not count.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the pitch.
        shift: Displacement of the image, (rows, cols) [pixel].
        aperture: See `sampled_kernel`.
        spots: See `sampled_kernel`.
        soft: See `sampled_kernel`.
        centroid: Of the light, with the displacement, (rows, cols) [pixel].
        size: Side of the kernel that is also computed [pixel]: both are of the same samples.
    """
    if q >= 1:
        return np.asarray(centroid)
    reach = 2 * q * steepest_slope(wave) + max(spots) + 3 * soft + NEAR_PIXELS
    half = int(np.ceil(reach / (2 * q * STEP)))
    wide = max(half, half_of(size, q, shift))
    part = slice(wide - half, wide + half + 1)
    energy = irradiance(pupil, wave, wide)[part, part].astype(np.float64)
    place = np.arange(-half, half + 1) * (2 * q * STEP)
    axes = _axes(q, shift, aperture, spots, soft)
    (all_down, more_down), (all_across, more_across) = (
        (all_shares(half, *axis), all_moments(half, *axis)) for axis in axes
    )
    uneven = (all_down[:, None] * all_across - 1) * energy
    down = uneven.sum(axis=1) @ (place + shift[0]) + more_down @ energy @ all_across
    across = uneven.sum(axis=0) @ (place + shift[1]) + all_down @ energy @ more_across
    return (np.array([down, across]) + centroid) / (1 + uneven.sum())


@lru_cache(maxsize=128)
def all_moments(half, q, aperture, spot, soft, shift):
    """Sum of `pixel_shares` times the pixels' distances from a sample, over an endless grid, (samples,) [pixel]."""
    samples = np.arange(-half, half + 1) * (2 * q * STEP)
    f, step = np.arange(1, int(np.ceil(1 / q))), 1e-4
    ends = [axis_transfer(f + side * step, aperture, spot, soft) for side in (1, -1)]
    return np.sin(2 * np.pi * np.multiply.outer(samples + shift, f)) @ (
        (ends[0] - ends[1]) / (2 * np.pi * step)
    )


def _axes(q, shift, aperture, spots, soft):
    """Arguments of `pixel_shares` after `half`, for rows and columns."""
    return [
        (float(q), float(width), float(spot), float(soft), float(move))
        for width, spot, move in zip(aperture, spots, shift, strict=True)
    ]


def window(pupil: Pupil, waves) -> tuple[int, float]:
    """Return `half` of the irradiance that holds what differs from a pupil in focus, and the error of transfer tables.

    Beyond a radius X there is the share pi t / X of the light, t the strength of `edge_tail`. In focus it is where it
    is with the wavefront, to 3 b^2 / X^2 of it for rays that land b away, or along a polygon's normals anywhere within
    b of them. The rest of the differences is spread within the window. Of 15 pupils with wavefronts of up to 8 waves,
    and 60 frequencies each, half of them across a polygon's normals, the largest errors were 0.2 to 0.7 of this.
    """
    slope, strength = max(map(fastest_turn, waves)), np.pi * edge_tail(pupil)
    sides = len(pupil.sides)
    share = (
        (1 + (sides % 2 == 0)) / sides if sides else 0.0
    )  # of the sides with one normal or its opposite
    farthest = 1.1 * slope / FLAT + NEAR
    while True:
        radius = FLAT * farthest
        moved = min(3 * (slope / radius) ** 2, 1.0)
        error = float(strength / radius * max(share, 0.6 * moved))
        if error <= ERROR:
            return int(np.ceil(farthest / STEP)), error
        farthest *= 1.1


def fade(half):
    """Weight of the samples of a window: 1 up to FLAT of its radius, 0 from the radius on."""
    at = np.arange(-half, half + 1) / half
    radius = np.clip((np.hypot(at[:, None], at) - FLAT) / (1 - FLAT), 0, 1)
    return (np.cos(np.pi / 2 * radius) ** 2).astype(np.float32)


def _difference(pupil, wave, half, focus, fading):
    """Irradiance with a wavefront less that in focus, which fades out and has the sum 0, (samples, samples)."""
    left = (irradiance(pupil, wave, half) - focus) * fading
    return left - fading * np.float32(left.sum(dtype=np.float64) / fading.sum(dtype=np.float64))


def difference_kernels(pupil: Pupil, waves, q, aperture, spots, soft, shift) -> np.ndarray:
    """Return kernels of wavefronts less the kernel in focus, of sum 0, float32 (bands, size, size).

    Arguments as of `difference_tables`.
    """
    half, _ = window(pupil, waves)
    sizes = [size_of(one, half) for one in q]
    focus, fading = irradiance(pupil, np.zeros((1, 1)), half), fade(half)
    out = np.zeros((len(waves), max(sizes), max(sizes)), np.float32)

    def make(band):
        left = _difference(pupil, waves[band], half, focus, fading)
        axes = _axes(q[band], shift, aperture, spots, soft)
        down, across = (pixel_shares(sizes[band], half, *axis) for axis in axes)
        rim = (max(sizes) - sizes[band]) // 2
        inner = slice(rim, rim + sizes[band])
        out[band, inner, inner] = multiply(down, multiply(left, across.T))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(waves))))
    return out


def size_of(q, half, shift=0.0) -> int:
    """Return the side of a kernel that holds a window of the irradiance [pixel]."""
    return 2 * int(np.ceil(2 * q * STEP * half + abs(shift) + MARGIN)) + 1


stored_difference_kernels = stored(difference_kernels)


@stored
def difference_tables(
    pupil: Pupil, waves, q, rows, cols, aperture, spots, soft, shift
) -> np.ndarray:
    """Return tables of wavefronts less the tables of the pupil in focus, complex64 (bands, rows, cols // 2 + 1).

    Args:
        pupil: The pupil.
        waves: Coefficients of the wavefronts [waves], (bands, n, n).
        q: Wavelength times working f-number over the pitch, (bands,).
        rows: Rows of the transform's period.
        cols: Columns of the transform's period.
        aperture: Height and width over which each pixel is integrated [pixel].
        spots: Halves of the distances of a low-pass filter's images, (rows, cols) [pixel].
        soft: Standard deviation of a diffuser [pixel].
        shift: Displacement of the image, (rows, cols) [pixel].
    """
    half, _ = window(pupil, waves)
    sizes = [size_of(one, half) for one in q]
    focus, fading = irradiance(pupil, np.zeros((1, 1)), half), fade(half)
    out = np.empty((len(waves), rows, cols // 2 + 1), np.complex64)

    def make(band):
        left = _difference(pupil, waves[band], half, focus, fading)
        first, second = _axes(q[band], shift, aperture, spots, soft)
        size = sizes[band]
        if 2 * max(rows, cols) < size:  # so few frequencies cost less than as many pixels
            down = fold_shares(np.fft.fftfreq(rows), half, *first)
            across = fold_shares(np.arange(cols // 2 + 1) / cols, half, *second)
            out[band] = multiply(multiply(down, left), across.T)
        else:
            down, across = (pixel_shares(size, half, *axis) for axis in (first, second))
            out[band] = wrap_kernel(multiply(down, multiply(left, across.T)), rows, cols)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(waves))))
    return out


def fold_shares(f, half, q, aperture, spot, soft, shift):
    """Transform of `pixel_shares`, of all pixels of an endless grid, at f [cycle/pixel], complex64 (f, samples)."""
    samples = np.arange(-half, half + 1) * (2 * q * STEP) + shift
    total = np.zeros((len(f), len(samples)), complex)
    reach = int(np.ceil(1 / q + 0.5))
    for whole in range(-reach, reach + 1):
        inside = np.flatnonzero(np.abs(f + whole) * q < 1)
        one = f[inside] + whole
        passed = axis_transfer(one, aperture, spot, soft)
        total[inside] += passed[:, None] * np.exp(-2j * np.pi * np.outer(one, samples))
    return total.astype(np.complex64)


def wrap_kernel(kernel, rows, cols):
    """Half spectrum of a kernel that a period repeats, its middle at sample 0."""
    at = np.arange(len(kernel)) - len(kernel) // 2
    y, x = at[:, None] % rows, at % cols
    if len(at) <= min(rows, cols):
        lines = np.zeros((len(at), cols), np.float32)
        lines[:, x] = kernel
        spectra = np.zeros((rows, cols // 2 + 1), np.complex64)
        spectra[y[:, 0]] = scipy.fft.rfft(lines, axis=1)  # the other rows are 0
        return scipy.fft.fft(spectra, axis=0, overwrite_x=True)
    wide = np.zeros((rows, cols), np.float32)
    np.add.at(wide, (y, x), kernel)
    return scipy.fft.rfft2(wide)


def sampled_transfer(pupil: Pupil, wave, sx, sy) -> np.ndarray:
    """Return the transfer function at frequencies (sx, sy), in units of the cut-off: see `gpusim.optics.otf.transfer`.

    Its error is the one that `window` returns. wave: coefficients [i, j] of x^i y^j of the wavefront [waves].
    """
    wave = np.asarray(wave, np.float64)
    half, _ = window(pupil, wave[None])
    focus = irradiance(pupil, np.zeros((1, 1)), half)
    left = _difference(pupil, wave, half, focus, fade(half))
    found = transfer(pupil, np.zeros((1, 1, 1)), sx, sy, error=FAST, fast=True)[0]
    at = np.arange(-half, half + 1) * (-4j * np.pi * STEP)
    inside = np.flatnonzero(np.hypot(sx, sy) < 1)
    for piece in np.array_split(inside, -(-len(inside) // PIECE) or 1):
        down, across = (np.exp(np.outer(s[piece], at)).astype(np.complex64) for s in (sy, sx))
        found[piece] += np.einsum("fi,fi->f", multiply(down, left), across)
    return found
