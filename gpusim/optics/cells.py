"""A pupil that is cut into cells: how far their pictures, added, differ from the whole pupil's."""

from math import ceil, lcm

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from gpusim.domain.optics import Optics
from gpusim.optics.psf import coverage, fastest_turn

LEAST = 192  # samples along the pupil
PER_TURN = 8  # of them for each cycle of the fastest phase per radius


def transfer_of_parts(
    optics: Optics, shape: tuple[int, int], wave: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the transfer functions of a pupil, and of its cells together, without interference between cells.

    Args:
        optics: The lens.
        shape: Rows and columns of cells over the pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].

    Returns:
        Two complex arrays (2 n, 2 n) at frequencies of k / n of the cut-off, zero at index 0, as `numpy.fft` orders.
    """
    step = lcm(*shape)
    count = step * ceil(max(LEAST, PER_TURN * fastest_turn(wave)) / step)
    u = (np.arange(count) + 0.5) * (2 / count) - 1
    opening = np.sqrt(coverage(optics.pupil, count)) * _amplitude(optics, u)
    field = opening * np.exp(2j * np.pi * np.polynomial.polynomial.polygrid2d(u, u, wave).T)
    whole = scipy.fft.ifft2(np.abs(scipy.fft.fft2(field, (2 * count,) * 2)) ** 2)
    high, wide = (count // n for n in shape)
    blocks = field.reshape(shape[0], high, shape[1], wide).swapaxes(1, 2)
    spectra = scipy.fft.fft2(blocks, (2 * high, 2 * wide))
    small = scipy.fft.ifft2((np.abs(spectra) ** 2).sum(axis=(0, 1)))
    parts = np.zeros_like(whole)
    rows, cols = (np.fft.fftfreq(2 * n, 1 / (2 * n)).astype(int) for n in (high, wide))
    parts[np.ix_(rows, cols)] = small
    return whole / whole[0, 0].real, parts / parts[0, 0].real


def _amplitude(optics, u):
    """Return the mask's amplitude at places u along rows and columns; 1 without a mask."""
    mask = optics.pupil.mask
    if mask is None:
        return 1.0
    at = [((u + 1) / 2 * n).astype(int) for n in mask.values.shape]
    return mask.values[np.ix_(*at)]


def relative_difference(
    optics: Optics,
    shape: tuple[int, int],
    light: np.ndarray,
    spectra: np.ndarray,
    wavelengths: np.ndarray,
    pitch: float,
    aperture: tuple[float, float],
    distances: list[tuple[float | None, float]],
) -> float:
    """Return the RMS difference between the added pictures of cells and the whole pupil's, relative to the picture.

    Args:
        optics: The lens.
        shape: Rows and columns of cells over the pupil.
        light: Light of each channel (C, rows, cols), before the lens.
        spectra: Share of the wavelengths in each channel (C, L), of sum 1.
        wavelengths: [nm], shape (L,).
        pitch: Distance of the samples [m].
        aperture: Height and width over which samples are integrated [sample].
        distances: Distances of objects [m], None the plane in focus, each with its share of the picture.
    """
    rows, cols = light.shape[1:]
    power = np.square(
        scipy.fft.dctn(light, axes=(1, 2), norm="ortho")
    )  # of the picture and its mirror images
    fy, fx = (np.arange(n) / (2 * n) for n in (rows, cols))  # [cycle/sample]
    power = power * (np.sinc(aperture[0] * fy[:, None]) * np.sinc(aperture[1] * fx)) ** 2
    missed = total = 0.0
    for distance, share in distances:
        waves = optics.waves(wavelengths, distance=distance, longest=np.inf)
        found = np.zeros(
            (2, 2, len(light), rows, cols), complex
        )  # difference and whole, at (fy, fx) and (fy, -fx)
        for wavelength, wave, own in zip(wavelengths, waves, spectra.T, strict=True):
            q = wavelength * 1e-9 * optics.working_f_number / pitch
            whole, parts = transfer_of_parts(optics, shape, wave)
            for sums, table in zip(found, (parts - whole, whole), strict=True):
                for side, sign in zip(sums, (1, -1), strict=True):
                    side += own[:, None, None] * _at(table, q * fy, sign * q * fx)
        missed += share * float((power * np.abs(found[0]) ** 2).sum())
        total += share * float((power * np.abs(found[1]) ** 2).sum())
    return float(np.sqrt(missed / max(total, 1e-300)))


def _at(table, sy, sx):
    """Return a table at frequencies (sy, sx) of the cut-off, linear between its own, 0 beyond it."""
    n = len(table) // 2
    table = np.roll(table, (n, n), (0, 1))
    places = np.meshgrid(n + sy * n, n + sx * n, indexing="ij")
    parts = [map_coordinates(part, places, order=1) for part in (table.real, table.imag)]
    return parts[0] + 1j * parts[1]
