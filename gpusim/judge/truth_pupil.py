"""Kernels of a pupil for the truth, float64: sums over its chords, shared with no frame.

A chord is a line of the pupil at a height v. Chords change smoothly between the corners of the
outline, the ends of the obstruction and the edges of a mask's cells, but for square roots at the
ends of an interval, which v = middle + half sin(t) removes. The field is Gauss's sum over chords
and along each of them. The irradiance is sampled as finely as its band limit asks for, and
integrated over the pixels by the transform of a box.
"""

from itertools import pairwise, product
from math import ceil

import numpy as np
import scipy

from gpusim.domain.optics import Optics

AROUND = 12  # [sample] beyond a kernel, over which its transform repeats
MORE = 24  # nodes of each sum beyond half a cycle each


class PupilKernels:
    """Kernels of a lens at one wavelength, at any place of the field.

    Args:
        optics: The lens.
        wavelength: [nm].
        pitch: Distance of the samples [m].
        aperture: Height and width of the pixels' apertures [sample].
        displacement: Displacement of their middles, (rows, cols) [sample].
        corner: Distance of the frame's corner from its middle [sample].
        half: Half size of a kernel [sample].
    """

    def __init__(self, optics: Optics, wavelength, pitch, aperture, displacement, corner, half):
        self.optics, self.wavelength, self.pitch = optics, wavelength, pitch
        self.displacement, self.corner, self.half = displacement, corner, half
        self.q = wavelength * 1e-9 * optics.working_f_number / pitch
        self.fine = max(1, ceil(2.02 / self.q))
        count = scipy.fft.next_fast_len(2 * (half + AROUND) * self.fine)
        self.at = (np.arange(count) - count // 2) / self.fine
        steepest = max(_steepest(self._waves(height)) for height in (0.0, 0.7, 1.0))
        shift = np.hypot(*displacement) + abs(self._colour()) * 1.5 * corner
        cycles = (np.abs(self.at).max() + shift) / (2 * self.q) + steepest
        self.v, mass, self.u, self.along, self.area = _chords(optics.pupil, cycles)
        down = np.exp(1j * np.pi / self.q * np.outer(self.at, self.v)) * mass
        self.down = down.astype(np.complex64)
        # rounded to 1e-7 of the field; nodes in double precision would take twice the memory
        self.across = np.empty((*self.u.shape, len(self.at)), np.complex64)
        for own, one in zip(self.across, np.pi / self.q * self.u, strict=True):
            own[:] = np.exp(1j * np.outer(one, self.at))
        self.box = self._box(aperture)

    def at_places(self, places) -> np.ndarray:
        """Return the energy of the pixels around points, (P, 2 half + 1, 2 half + 1).

        Args:
            places: Field points (y, x), 1 the frame's corner.
        """
        v = np.broadcast_to(self.v[:, None], self.u.shape)
        pupil = np.empty((len(self.v), len(places), self.u.shape[1]), np.complex64)
        for number, (y, x) in enumerate(places):
            waves = self._waves(np.hypot(y, x), np.arctan2(y, x))
            down, across = (
                self._colour() * self.corner * at - move
                for at, move in zip((y, x), self.displacement, strict=True)
            )
            phase = np.polynomial.polynomial.polyval2d(self.u, v, waves)
            phase = phase - (down * v + across * self.u) / (2 * self.q)
            pupil[:, number] = self.along * np.exp(2j * np.pi * phase)
        lines = np.matmul(pupil, self.across)  # (K, P, n)
        whole = self.fine * np.arange(-self.half, self.half + 1)
        found = []
        for number in range(len(places)):
            light = np.abs((self.down @ lines[:, number]).astype(complex)) ** 2
            light /= self.area * 4 * self.q**2
            spectrum = scipy.fft.fft2(scipy.fft.ifftshift(light)) * self.box
            found.append(scipy.fft.ifft2(spectrum).real[np.ix_(whole, whole)])
        return np.stack(found)

    def _waves(self, height, azimuth=0.0):
        return self.optics.waves(np.array([self.wavelength]), float(height), float(azimuth))[0]

    def _colour(self):
        return float(self.optics.lateral_color_at(np.array([self.wavelength]))[0])

    def _box(self, aperture):
        """Return the transfer function of apertures and low-pass, at the frequencies of a period."""
        f = np.fft.fftfreq(len(self.at), 1 / self.fine)
        down, across = (
            np.sinc(side * f)
            * np.cos(np.pi * spot / self.pitch * f)
            * np.exp(-2 * (np.pi * self.optics.diffuser / self.pitch * f) ** 2)
            for side, spot in zip(aperture, self.optics.birefringence, strict=True)
        )
        return down[:, None] * across


def _steepest(waves):
    """Return the largest slope of a wavefront over the disc [wave per radius]."""
    y, x = np.meshgrid(*[np.linspace(-1, 1, 33)] * 2, indexing="ij")
    slopes = np.gradient(np.polynomial.polynomial.polyval2d(x, y, waves), x[0, 1] - x[0, 0])
    return float(np.hypot(*slopes)[np.hypot(y, x) <= 1.05].max())


def _chords(pupil, cycles):
    """Return heights and weights of chords (K,), nodes and weights along them (K, J), and the area.

    cycles: most cycles of a phase per radius.
    """
    turn = pupil.rotation + 2 * np.pi * np.arange(pupil.blades) / max(pupil.blades, 1)
    corners = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    ends = {-1.0, 1.0} if not pupil.blades else set(corners[:, 0].round(12).tolist())
    hole = pupil.obscuration
    ends |= {-hole, hole} if hole else set()
    rows, cols, values = _cells(pupil)
    ends = sorted(_with_cells(ends, corners, hole, rows, cols))
    t, share = np.polynomial.legendre.leggauss(ceil(1.1 * np.pi * cycles) + MORE)
    found = []
    for low, high in pairwise(ends):
        if high - low < 1e-9:
            continue
        count = ceil(1.1 * np.pi**2 / 4 * cycles * (high - low)) + MORE
        s, weight = np.polynomial.legendre.leggauss(count)
        v = (low + high) / 2 + (high - low) / 2 * np.sin(np.pi / 2 * s)
        weight = weight * np.pi / 4 * (high - low) * np.cos(np.pi / 2 * s)
        left, right = _outline(corners, v, (low + high) / 2)
        parts = [(left, right)]
        if hole and abs(low + high) / 2 < hole:
            inner = np.sqrt(np.maximum(hole**2 - v * v, 0))
            parts = [(left, -inner), (inner, right)]
        own = values[np.searchsorted(rows, (low + high) / 2) - 1]
        for (first, last), (left, right, amplitude) in product(
            parts, zip(cols, cols[1:], own, strict=False)
        ):
            start, end = np.maximum(first, left), np.minimum(last, right)
            if not amplitude or (end - start).max() < 1e-9:
                continue
            middle, long = (start + end) / 2, np.maximum(end - start, 0) / 2
            nodes = middle[:, None] + long[:, None] * t
            light = weight @ long * 2 * abs(amplitude) ** 2
            found.append((v, weight, nodes, amplitude * long[:, None] * share, light))
    *every, light = zip(*found, strict=True)
    return *(np.concatenate(part) for part in every), float(np.sum(light))


def _cells(pupil):
    """Return edges of a mask's rows and columns, and its amplitudes."""
    if pupil.mask is None:
        return [-1.0, 1.0], [-1.0, 1.0], np.ones((1, 1))
    values = pupil.mask.values
    rows, cols = ([2 * k / n - 1 for k in range(n + 1)] for n in values.shape)
    return rows, cols, values


def _with_cells(ends, corners, hole, rows, cols):
    """Return the heights between which chords change smoothly, also those at which cells begin and are cut."""
    found, inner = set(ends), (min(ends), max(ends))
    for x in cols[1:-1]:
        for radius in (1.0, hole):
            if abs(x) < radius and not (len(corners) and radius == 1.0):
                found |= {(radius**2 - x * x) ** 0.5, -((radius**2 - x * x) ** 0.5)}
        for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if min(x0, x1) < x < max(x0, x1):
                found.add(float(y0 + (y1 - y0) * (x - x0) / (x1 - x0)))
    found |= set(rows[1:-1])
    return {round(y, 12) for y in found if inner[0] <= y <= inner[1]}


def _outline(corners, v, middle):
    """Return the ends of the chords at v, all between the same two corners."""
    if not len(corners):
        half = np.sqrt(1 - v * v)
        return -half, half
    ends = [
        x0 + (x1 - x0) * (v - y0) / (y1 - y0)
        for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        if min(y0, y1) < middle < max(y0, y1)
    ]
    return np.minimum(*ends), np.maximum(*ends)
