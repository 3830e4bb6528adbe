"""Point spreads on a grid of pixels: of a pupil, by diffraction, and transfer tables of spreads given as arrays."""

from functools import lru_cache
from itertools import product

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyder, polygrid2d, polyval2d

from gpusim.domain.errors import OutOfRange
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil
from gpusim.optics.farfield import edge_tail

# Gauss-Legendre points per side of a pixel for a kernel to 1e-3 of its peak or better, from this q on
QUADRATURE = ((1.0, 4), (0.7, 5), (0.5, 7), (0.25, 10), (0.0, 16))
SAMPLES_PER_CYCLE = 6  # of the pupil's phase, at the edge of the kernel
CELLS = 128  # along the pupil, for mean slopes of the wavefront


def pupil_kernel(outline: Pupil, wave, q, shift, size: int, aperture, spots) -> np.ndarray:
    """Return the energy of every pixel around a point's image by a pupil, (size, size), of energy 1 in all the image.

    The field in the image is the Fourier integral of the pupil, here a product of three matrices (Soummer et al.,
    Optics Express 15, 15935 (2007)) with the nodes of a Gauss-Legendre rule in every pixel. Apertures that leave
    gaps, or overlap, share the light as if they tiled the image.

    Args:
        outline: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the pitch.
        shift: Displacement of the image, (rows, cols) [pixel].
        size: Side of the kernel [pixel], odd.
        aperture: Height and width over which each pixel is integrated [pixel].
        spots: Distances of a low-pass filter's spots from their middle, (rows, cols) [pixel].
    """
    points = next(count for least, count in QUADRATURE if q >= least * (1 - 1e-9))
    # cycles of the phase per radius: x / 2 q for the image at x, and the wavefront's own
    fastest = (size / 2 + max(map(abs, shift))) / (2 * q) + steepest_slope(wave)
    count = 8 * int(np.ceil(SAMPLES_PER_CYCLE * fastest / 4)) + 32
    u = (np.arange(count) + 0.5) / count * 2 - 1
    path = polygrid2d(u, u, wave).T  # [y, x]
    opening = (coverage(outline, count) * np.exp(2j * np.pi * path)).astype(np.complex64)
    (down, across), (height, width) = spots, aperture
    energies = []
    for a, b in product({-down, down}, {-across, across}):
        left = _waves_to(size, points, height, shift[0] + a, count, q)
        right = _waves_to(size, points, width, shift[1] + b, count, q)
        field_ = left @ opening @ right.T
        energies.append(field_.real**2 + field_.imag**2)
    energy = sum(energies).reshape(size, points, size, points)
    mass = leggauss(points)[1] / 2
    energy = np.einsum("iajb,a,b->ij", energy, mass, mass, optimize=True)
    inside, whole = energy.sum(), len(energies) * (q * count) ** 2 * np.abs(opening).sum()
    if q < 1 and (height, width) != (1, 1):
        # sums over apertures with gaps are not of all light: beyond the kernel they are in the mean
        whole = inside + whole * _energy_beyond(outline, q, wave, size)
    return energy / whole


def _energy_beyond(outline, q, wave, size):
    """Share of the light outside a kernel of this size, if that is beyond most rays.

    It is q tail / r^3, or if the rays from the rim land b away q tail (r^2 + b^2) / (r (r^2 -
    b^2)^2), outside of a square, over which 1 / r has the mean of a circle of 0.555 of its side.
    """
    radius, angle = 0.555 * size, np.linspace(0, 2 * np.pi, 64, endpoint=False)
    x, y = (polyval2d(np.cos(angle), np.sin(angle), slope) for slope in _derivatives(wave))
    near = min(np.mean(4 * q * q * (x**2 + y**2)) / radius**2, 0.8)
    return 2 * np.pi * edge_tail(outline) * q / radius / (1 - near)


@lru_cache(maxsize=32)
def _waves_to(size, points, aperture, shift, count, q):
    """Fourier factors from `count` cells of the pupil to the Gauss nodes of `size` pixels, complex64.

    A ray through u meets the image at -2 q grad W, at which the phase W + u x / 2 q is stationary.
    """
    u = (np.arange(count) + 0.5) / count * 2 - 1
    nodes = leggauss(points)[0] / 2
    pixels = ((np.arange(size) - size // 2)[:, None] + aperture * nodes).ravel() - shift
    return np.exp(2j * np.pi * np.outer(pixels, u) / (2 * q)).astype(np.complex64)


def steepest_slope(wave) -> float:
    """Return the largest slope of the wavefront in the pupil [waves per radius]."""
    u = np.linspace(-1, 1, 17)
    x, y = (polygrid2d(u, u, slope) for slope in _derivatives(wave))
    return float(np.hypot(x, y)[u[:, None] ** 2 + u**2 <= 1].max())


def _derivatives(wave):
    """Coefficients of the wavefront's derivatives along x and along y."""
    return polyder(wave, axis=0), polyder(wave, axis=1)


def mean_slopes(outline: Pupil, waves) -> np.ndarray:
    """Return the wavefronts' mean slopes over the open pupil along y and x [waves per radius], (L, 2)."""
    means = _mean_powers(outline, waves.shape[1])
    slopes = np.empty((len(waves), 2))
    for slope, wave in zip(slopes, waves, strict=True):
        along_x, along_y = _derivatives(wave)
        slope[:] = np.vdot(along_y, means[:, :-1]), np.vdot(along_x, means[:-1])
    return slopes


@lru_cache(maxsize=32)
def _mean_powers(pupil, count):
    """Means of x^i y^j over the open pupil, shape (count, count)."""
    u = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1
    powers, open_ = u ** np.arange(count)[:, None], coverage(pupil, CELLS)  # [y, x]
    return powers @ open_.T @ powers.T / open_.sum()


@lru_cache(maxsize=32)
def coverage(pupil, count):
    """Open part of every cell of the pupil's grid, [y, x]: linear across the edge."""
    u, step = (np.arange(count) + 0.5) / count * 2 - 1, 2 / count
    y, x = u[:, None], u
    radius = np.hypot(y, x)
    inside = 1 - radius
    for number, angle in enumerate(pupil.sides):
        side = pupil.inner_radius - x * np.cos(angle) - y * np.sin(angle)
        inside = np.minimum(inside, side) if number else side
    open_ = np.clip(inside / step + 0.5, 0, 1)
    if pupil.obscuration:
        open_ = open_ * np.clip((radius - pupil.obscuration) / step + 0.5, 0, 1)
    return open_


def psf_tables(
    spread: PointSpread,
    wavelengths,
    pitch,
    aperture,
    rows,
    cols,
    finest=0.0,
    place=(0.0, 0.0),
    whole=True,
    displacement=(0.0, 0.0),
):
    """Return transfer tables at `wavelengths` [nm], the point spread integrated over the pixel.

    Samples of the irradiance determine a function without frequencies beyond half their rate
    (sampling theorem, spacing <= lambda N / 2), so any ratio of pitch and spacing is exact: a
    pixel's share of each sample is the transform of the aperture up to that frequency, folded by
    the pixels, which separates into rows and columns. Between its wavelengths the spread is linear;
    beyond them it is refused.

    Args:
        spread: The point spreads.
        wavelengths: [nm], shape (L,).
        pitch: Of the pixels [m].
        aperture: Height and width of the pixel's aperture over the pitch, or one number for a
            square.
        rows: Rows of the transform's period.
        cols: Columns of the transform's period.
        finest: lambda N / 2 of the shortest wavelength [m] if known; samples of the irradiance
            that are further apart are refused.
        place: Field point, see `PointSpread.at`.
        whole: Refuse spreads that do not fit into this period. Without it the tables are the
            transfer function at these frequencies, to be looked at.
        displacement: Of the aperture's middle from the scene's sample, (rows, cols) [pixel].

    Returns:
        Half tables as `optics.blur` takes them, shape (L, rows, 2 (cols // 2 + 1)).

    Raises:
        OutOfRange: The samples are too coarse, the spread is larger than the period, or
            energies of pixels are displaced by parts of a pixel.
    """
    low, high, rest = _neighbours(spread, wavelengths)
    ratio = spread.spacing / pitch
    if whole and spread.integrated and abs(ratio - 1) > 1e-9:
        raise OutOfRange(
            "point spread spacing",
            f"{spread.spacing * 1e6:.6g} um",
            f"the pixel pitch, {pitch * 1e6:.6g} um: energies of other pixels cannot be resampled",
        )
    if spread.integrated and any(move % 1 for move in displacement):
        raise OutOfRange(
            "sensor.offset + sensor.centre",
            "{:.6g}, {:.6g} pixels".format(*displacement),
            "whole pixels: the point spread holds energies of pixels, which cannot be resampled; give "
            "samples of the irradiance",
        )
    if not spread.integrated and finest and spread.spacing > finest * (1 + 1e-9):
        raise OutOfRange(
            "point spread spacing",
            f"{spread.spacing * 1e6:.6g} um",
            f"up to {finest * 1e6:.6g} um, half of lambda N: coarser samples do not determine it",
        )
    values = spread.at(*place)
    for size, period, axis in zip(values.shape[1:], (rows, cols), ("rows", "columns"), strict=True):
        if whole and size * ratio > period:
            raise OutOfRange(
                f"point spread {axis}",
                f"{size} samples = {size * ratio:.4g} pixels",
                f"up to the {period} pixels of scene and surroundings",
            )
    (count_y, count_x), (height, width) = values.shape[1:], np.broadcast_to(aperture, 2)
    down, across = displacement
    fy, fx = np.fft.fftfreq(rows), np.arange(cols // 2 + 1) / cols
    left = _sample_transform(fy, count_y, ratio, height, spread.integrated, down)
    right = _sample_transform(fx, count_x, ratio, width, spread.integrated, across)
    own = np.stack([left @ one @ right.T for one in values])
    tables = own[low] * (1 - rest) + own[high] * rest
    for i in {0, rows // 2} if rows % 2 == 0 else {0}:  # what is its own opposite is real
        for j in {0, cols // 2} if cols % 2 == 0 else {0}:
            tables[:, i, j] = tables[:, i, j].real
    return np.ascontiguousarray(tables).view(np.float64)


def _sample_transform(frequencies, count, ratio, aperture, integrated, displacement):
    """Transform of the share of each of `count` samples `ratio` pixels apart in the pixels, (frequencies, count)."""
    places = (np.arange(count) - (count - 1) / 2) * ratio - displacement
    if integrated:
        return np.exp(-2j * np.pi * np.outer(frequencies, places))
    reach = int(np.ceil(0.5 / ratio + 0.5))
    total = np.zeros((len(frequencies), count), complex)
    for a in range(-reach, reach + 1):
        f = frequencies + a
        # at exactly half the rate a sample counts half for either sign
        beyond = np.abs(f) * ratio - 0.5
        share = np.where(beyond < -1e-12, 1.0, np.where(beyond < 1e-12, 0.5, 0.0))
        share = share * np.sinc(aperture * f)
        total += share[:, None] * np.exp(-2j * np.pi * np.outer(f, places))
    return total


def spread_at(spread: PointSpread, wavelengths, place=(0.0, 0.0)) -> np.ndarray:
    """Return point spreads at `wavelengths` [nm] and a field point, shape (L, rows, cols).

    Between its wavelengths the spread is linear. Raises OutOfRange beyond them.
    """
    low, high, rest = _neighbours(spread, wavelengths)
    values = spread.at(*place)
    return values[low] * (1 - rest) + values[high] * rest


def _neighbours(spread, wavelengths):
    """Indices of the known wavelengths on both sides of each one, and the share of the upper. Raises OutOfRange."""
    known, wavelengths = spread.wavelengths, np.asarray(wavelengths, np.float64)
    if wavelengths.min() < known[0] - 1e-9 or wavelengths.max() > known[-1] + 1e-9:
        raise OutOfRange(
            "wavelengths",
            f"{wavelengths.min():g} .. {wavelengths.max():g} nm",
            f"within the point spread's, {known[0]:g} .. {known[-1]:g} nm",
        )
    share = np.interp(wavelengths, known, np.arange(len(known)))
    low = np.minimum(share.astype(int), max(len(known) - 2, 0))
    high = np.minimum(low + 1, len(known) - 1)
    rest = (share - low)[:, None, None]
    return low, high, rest
