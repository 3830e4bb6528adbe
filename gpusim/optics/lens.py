"""Kernels of a lens anywhere in the field: pixel-integrated point spreads, from its pupil or from measurements.

A field point is (y, x), 1 the distance of the frame's corner from the axis, in the direction of rows and columns.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.optics.psf import psf_tables

# Gauss-Legendre points per side of a pixel for a kernel to 1e-3 of its peak or better, from this q on
QUADRATURE = ((1.0, 4), (0.7, 5), (0.5, 7), (0.25, 10), (0.0, 16))
SAMPLES_PER_CYCLE = 6  # of the pupil's phase, at the edge of the kernel
CELLS = 128  # along the pupil, for mean slopes of the wavefront
NODES = 9  # wavelengths between which kernels are cubic: with 13 the image of a mild lens changes by 1e-5


@dataclass(frozen=True, eq=False)
class PupilLens:
    """Point spreads of a pupil and its wavefronts.

    optics: the lens. pitch: of the pixels [m]. aperture: height and width of the pixel's aperture over the pitch.
    corner: distance of the frame's corner from the axis [pixel], for lateral colour. displacement: of the apertures'
    middles from the points, (rows, cols) [pixel].
    """

    optics: Optics
    pitch: float
    aperture: tuple[float, float]
    corner: float
    displacement: tuple[float, float] = (0.0, 0.0)
    least_size = 1

    def kernels(self, wavelengths, place, size) -> np.ndarray:
        """Energy of every pixel around a point at `place`, float64 (L, size, size), size odd, of 1 in all the image.

        The field in the image is the Fourier integral of the pupil, here a product of three matrices (Soummer et al.,
        Optics Express 15, 15935 (2007)) with the nodes of a Gauss-Legendre rule in every pixel. Apertures that leave
        gaps, or lie on each other, share the light as if they tiled the image.
        """
        optics, (y, x) = self.optics, place
        wavelengths = np.asarray(wavelengths, np.float64)
        waves = optics.waves(wavelengths, float(np.hypot(y, x)), float(np.arctan2(y, x)))
        colour = (
            optics.lateral_color_at(wavelengths) * self.corner
        )  # shift per unit of field height [pixel]
        out = np.empty((len(wavelengths), size, size))
        for kernel, wavelength, wave, shift in zip(out, wavelengths, waves, colour, strict=True):
            kernel[:] = self._kernel(
                wavelength * 1e-9 * optics.working_f_number / self.pitch,
                wave,
                size,
                (shift * y - self.displacement[0], shift * x - self.displacement[1]),
            )
            if optics.diffuser:
                spectrum = scipy.ndimage.fourier_gaussian(
                    np.fft.fft2(kernel), optics.diffuser / self.pitch
                )
                kernel[:] = np.fft.ifft2(spectrum).real
        return out

    def centroids(self, wavelengths, place) -> np.ndarray:
        """Middle of all light of a point, from its place, (L, 2) (rows, cols) [pixel]: that of the rays.

        Kernels that end have less of it: light far from a point moves, too. A ray meets the image at -2 q grad W.
        """
        optics, (y, x) = self.optics, place
        wavelengths = np.asarray(wavelengths, np.float64)
        q = wavelengths * 1e-9 * optics.working_f_number / self.pitch
        waves = optics.waves(wavelengths, float(np.hypot(y, x)), float(np.arctan2(y, x)))
        means = _mean_powers(optics.pupil, waves.shape[1])
        slopes = [
            [
                np.vdot(slope, means[: slope.shape[0], : slope.shape[1]])
                for slope in (np.polynomial.polynomial.polyder(wave, axis=axis) for axis in (1, 0))
            ]
            for wave in waves
        ]
        colour = optics.lateral_color_at(wavelengths) * self.corner
        return (
            -2 * q[:, None] * np.array(slopes)
            + colour[:, None] * np.array([y, x])
            - np.array(self.displacement)
        )

    def _kernel(self, q, wave, size, shift):
        points = next(count for least, count in QUADRATURE if q >= least * (1 - 1e-9))
        # cycles of the phase per radius: x / 2 q for the image at x, and the wavefront's own
        fastest = (size / 2 + max(map(abs, shift))) / (2 * q) + _steepest(wave)
        count = 8 * int(np.ceil(SAMPLES_PER_CYCLE * fastest / 4)) + 32
        u = (np.arange(count) + 0.5) / count * 2 - 1
        path = np.polynomial.polynomial.polygrid2d(u, u, wave).T  # [y, x]
        aperture = (_coverage(self.optics.pupil, count) * np.exp(2j * np.pi * path)).astype(
            np.complex64
        )
        mass = np.polynomial.legendre.leggauss(points)[1] / 2
        energies = []
        spots = [self.optics.birefringence[axis] / self.pitch / 2 for axis in (0, 1)]
        for a in {-spots[0], spots[0]}:
            for b in {-spots[1], spots[1]}:
                left, right = (
                    _waves_to(size, points, width, move, count, q)
                    for width, move in zip(self.aperture, (shift[0] + a, shift[1] + b), strict=True)
                )
                field_ = left @ aperture @ right.T
                energies.append(field_.real**2 + field_.imag**2)
        energy = sum(energies).reshape(size, points, size, points)
        energy = np.einsum("iajb,a,b->ij", energy, mass, mass, optimize=True)
        inside, whole = energy.sum(), len(energies) * (q * count) ** 2 * np.abs(aperture).sum()
        if q < 1 and any(width != 1 for width in self.aperture):
            # sums over apertures with gaps are not of all light: beyond the kernel they are in the mean
            whole = inside + whole * _energy_beyond(self.optics, q, wave, size)
        return energy / whole


def _energy_beyond(optics, q, wave, size):
    """Share of the light that falls outside a kernel of this size, where that is beyond most rays.

    It is q tail / r^3, or where the rays from the rim land b away q tail (r^2 + b^2) / (r (r^2 - b^2)^2), outside of a
    square, which has the mean of 1 / r of a circle of 0.555 of its side.
    """
    radius, angle = 0.555 * size, np.linspace(0, 2 * np.pi, 64, endpoint=False)
    slopes = [
        np.polynomial.polynomial.polyval2d(
            np.cos(angle), np.sin(angle), np.polynomial.polynomial.polyder(wave, axis=axis)
        )
        for axis in (0, 1)
    ]
    near = min(np.mean(4 * q * q * (slopes[0] ** 2 + slopes[1] ** 2)) / radius**2, 0.8)
    return 2 * np.pi * tail_of(optics) * q / radius / (1 - near)


@lru_cache(maxsize=32)
def _waves_to(size, points, aperture, shift, count, q):
    """Fourier factors from `count` cells of the pupil to the Gauss nodes of `size` pixels, complex64.

    A ray through u meets the image at -2 q grad W: where the phase W + u x / 2 q is stationary.
    """
    u = (np.arange(count) + 0.5) / count * 2 - 1
    nodes = np.polynomial.legendre.leggauss(points)[0] / 2
    pixels = ((np.arange(size) - size // 2)[:, None] + aperture * nodes).ravel() - shift
    return np.exp(2j * np.pi * np.outer(pixels, u) / (2 * q)).astype(np.complex64)


@dataclass(frozen=True, eq=False)
class MeasuredLens:
    """Point spreads that are given: see `PupilLens` for pitch, aperture and displacement."""

    optics: Optics
    spread: PointSpread
    pitch: float
    aperture: tuple[float, float]
    corner: tuple[float, float]  # the frame's; places beyond take the spread of the frame's border
    displacement: tuple[float, float] = (0.0, 0.0)

    @property
    def least_size(self) -> int:
        """Least size of the kernels [pixel] that holds the spreads."""
        return (
            int(
                np.ceil(
                    max(self.spread.values.shape[-2:]) * self.spread.spacing / self.pitch
                    + 2 * max(map(abs, self.displacement))
                )
            )
            + 2
        )

    def kernels(self, wavelengths, place, size) -> np.ndarray:
        """As those of `PupilLens`; raises OutOfRange where the spread is larger than `size` pixels."""
        wavelengths = np.asarray(wavelengths, np.float64)
        place = tuple(
            float(np.clip(at, -most, most)) for at, most in zip(place, self.corner, strict=True)
        )
        tables = psf_tables(
            self.spread,
            wavelengths,
            self.pitch,
            self.aperture,
            size,
            size,
            place=place,
            displacement=self.displacement,
        )
        kernels = np.fft.fftshift(
            np.fft.irfft2(tables.view(np.complex128), (size, size)), axes=(1, 2)
        )
        return kernels / kernels.sum(axis=(1, 2), keepdims=True)


def open_lens(optics: Optics, pitch, aperture, shape, displacement=(0.0, 0.0)):
    """The lens that `optics` describes, before a frame of `shape` = (rows, cols) pixels of `pitch`.

    aperture: of a pixel over the pitch, height and width or one number for a square. displacement: see `PupilLens`.
    """
    height, width = np.broadcast_to(aperture, 2).tolist()
    corner = float(np.hypot(*shape)) / 2
    if optics.psf is not None:
        return MeasuredLens(
            optics,
            optics.psf,
            pitch,
            (height, width),
            tuple(n / 2 / corner for n in shape),
            displacement,
        )
    return PupilLens(optics, pitch, (height, width), corner, displacement)


def wavelength_nodes(wavelengths, count: int = NODES):
    """As many as `count` wavelengths whose kernels tell those of all, and their weights in each, shape (L, nodes)."""
    wavelengths = np.asarray(wavelengths, np.float64)
    if len(wavelengths) <= count:
        return wavelengths, np.eye(len(wavelengths))
    nodes = np.linspace(wavelengths[0], wavelengths[-1], count)
    return nodes, scipy.interpolate.CubicSpline(nodes, np.eye(count))(wavelengths)


def spread_radius(optics: Optics, wavelengths, pitch, height: float = 0.0) -> float:
    """Largest distance from a point's image at which rays meet the image, or given spreads end [pixel].

    height: of the field, 0 on the axis.
    """
    if optics.psf is not None:
        return max(optics.psf.values.shape[-2:]) * optics.psf.spacing / pitch / 2
    q = np.asarray(wavelengths) * 1e-9 * optics.working_f_number / pitch
    waves = zip(q, optics.waves(wavelengths, height), strict=True)
    return max((2 * one * _steepest(wave) for one, wave in waves if wave.any()), default=0.0)


def tail_of(optics: Optics) -> float:
    """Energy per square sample times r^3 / q, far from a point; 0 of point spreads that are given, which end."""
    if optics.psf is not None:
        return 0.0
    pupil = optics.pupil
    outline = 2 * pupil.blades * np.sin(np.pi / pupil.blades) if pupil.blades else 2 * np.pi
    return float((outline + 2 * np.pi * pupil.obscuration) / (np.pi * pupil.area) / (2 * np.pi**3))


def straight_tail(optics: Optics) -> tuple[tuple[float, ...], float]:
    """Angles of the lines through a point along which straight blades throw its light, from x on [rad], and how much.

    The second is their part of the tail, as `tail_of` has it; none of a round pupil.
    """
    pupil = optics.pupil
    if not pupil.blades or optics.psf is not None:
        return (), 0.0
    outline = 2 * pupil.blades * np.sin(np.pi / pupil.blades)
    angles = pupil.rotation + np.pi / pupil.blades * (2 * np.arange(pupil.blades) + 1)
    return tuple(angles.tolist()), float(outline / (outline + 2 * np.pi * pupil.obscuration))


def _steepest(wave):
    """Largest slope of the wavefront in the pupil [waves per radius]."""
    u = np.linspace(-1, 1, 17)
    slopes = [
        np.abs(
            np.polynomial.polynomial.polygrid2d(
                u, u, np.polynomial.polynomial.polyder(wave, axis=axis)
            )
        )
        for axis in (0, 1)
    ]
    return float(np.hypot(*slopes)[u[:, None] ** 2 + u**2 <= 1].max())


@lru_cache(maxsize=32)
def _mean_powers(pupil, count):
    """Means of x^i y^j over the open pupil, shape (count, count)."""
    u = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1
    powers, open_ = u ** np.arange(count)[:, None], _coverage(pupil, CELLS)  # [y, x]
    return powers @ open_.T @ powers.T / open_.sum()


@lru_cache(maxsize=32)
def _coverage(pupil, count):
    """Open part of every cell of the pupil's grid, [y, x]: linear across the edge."""
    u, step = (np.arange(count) + 0.5) / count * 2 - 1, 2 / count
    y, x = u[:, None], u
    radius = np.hypot(y, x)
    inside = 1 - radius
    if pupil.blades:
        normals = pupil.rotation + np.pi / pupil.blades * (2 * np.arange(pupil.blades) + 1)
        sides = [
            np.cos(np.pi / pupil.blades) - x * np.cos(angle) - y * np.sin(angle)
            for angle in normals
        ]
        inside = np.minimum.reduce(sides)
    open_ = np.clip(inside / step + 0.5, 0, 1)
    return (
        open_ * np.clip((radius - pupil.obscuration) / step + 0.5, 0, 1)
        if pupil.obscuration
        else open_
    )
