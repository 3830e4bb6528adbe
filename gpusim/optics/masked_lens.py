"""A lens with a mask in its pupil."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.domain.stored import stored
from gpusim.optics.geometric import coarse_kernel, cusp
from gpusim.optics.lens import PupilLens, Symmetry, Tail, checked_frequencies, polar
from gpusim.optics.mask_edges import edge_strength, edges_of, mean_turn
from gpusim.optics.masked import (
    focus_error,
    masked_energies,
    masked_kernel,
    masked_moment,
    masked_tables,
    masked_transfer,
    window_of,
)
from gpusim.optics.opening import Opening


@dataclass(frozen=True, eq=False)
class MaskedLens(PupilLens):
    """A lens that diffracts at a pupil with a mask, with wavefronts.

    Arguments as of `PupilLens`.
    """

    has_point_kernels = False  # edges inside the pupil interfere far from a point

    @cached_property
    def symmetry(self) -> Symmetry:
        """See `Lens`."""
        own, mask = super().symmetry, self.optics.pupil.mask
        assert mask is not None
        values = mask.values
        is_mirrored = bool((values == values[::-1]).all() and (values == values[:, ::-1]).all())
        is_opposite = bool((values == values[::-1, ::-1]).all())
        return Symmetry(False, own.is_mirrored and is_mirrored, own.is_opposite and is_opposite)

    @cached_property
    def tail(self) -> Tail:
        """See `Lens`."""
        pupil = self.optics.pupil
        shares = edges_of(pupil).shares()
        return Tail(edge_strength(pupil), tuple(shares), float(sum(shares.values())))

    def tails(self, wavelengths) -> np.ndarray:
        """See `Lens`. Edges spread their light about the places where their rays land."""
        optics, q = self.optics, self.q(wavelengths)
        (height, width), (down, across) = self.aperture, self.spots
        soft = (optics.diffuser / self.pitch) ** 2
        variance = (height**2 + width**2) / 12 + down**2 + across**2 + 2 * soft
        strength = edge_strength(optics.pupil) * q
        squares = edges_of(optics.pupil).squares_of_rays(self.waves(wavelengths), q)
        # corners of a cell throw light as r^-4; a round pupil of its area has this r^-5
        third = 3 / (8 * np.pi**5) * (q / np.sqrt(optics.pupil.area)) ** 3
        fifth = strength * (3 * squares[:, 0] + 9 / 4 * variance) + third
        return np.stack([strength, fifth, 5 * strength * squares[:, 1]], axis=1)

    def spread(self, wavelengths, height=0.0, distance=None) -> float:
        """See `Lens`."""
        opening = Opening.of(self.optics.pupil)
        waves = self.waves(wavelengths, height, distance=distance)
        slopes = [opening.steepest(wave, is_scaled=False) for wave in waves]
        return float(2 * np.max(self.q(wavelengths) * slopes))

    def cutoff(self, wavelength) -> float:
        """See `Lens`."""
        widest = float(np.hypot(*Opening.of(self.optics.pupil).half))
        return min(widest, 1.0) * super().cutoff(wavelength)

    def tables(self, q, rows, cols, stages, distance=None):
        """See `Lens`."""
        waves = self.waves(self.nanometres(q), distance=distance)
        if self.counts_rays(waves):
            return self._ray_tables(waves, q, rows, cols, stages)
        first, *settings = self._sampling_of(waves, q)
        found = masked_tables(*first, rows, cols, *settings)
        return stages.given(found.view(np.float32))

    def table_parts(self, q, rows, cols, stages) -> tuple | None:
        """See `Lens`."""
        return None

    def table_error(self, wavelengths, distance=None) -> float:
        """See `Lens`."""
        pupil, q = self.optics.pupil, self.q(wavelengths)
        waves = self.waves(wavelengths, distance=distance)
        if self.counts_rays(waves):
            return min(cusp(pupil) * min(float(q.max()) / np.sqrt(2), 1.0), 1.0)
        scaled = [Opening.of(pupil).scaled(wave)[0] for wave in waves]
        return focus_error(pupil) + max(
            (window_of(pupil, one)[1] for one in scaled if one.any()), default=0.0
        )

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance=None) -> np.ndarray:
        """See `Lens`."""
        wavelengths, fy, fx = checked_frequencies(wavelengths, fy, fx)
        optics, found = self.optics, np.empty((len(wavelengths), fx.size), complex)
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        cut = wavelengths * 1e-9 * optics.working_f_number  # [m/cycle]
        for own, wave, one in zip(found, waves, cut, strict=True):
            own[:] = masked_transfer(optics.pupil, wave, fx * one, fy * one)
        down, across = optics.birefringence
        spots = np.cos(np.pi * down * fy) * np.cos(np.pi * across * fx)
        return found * (spots * np.exp(-2 * (np.pi * optics.diffuser) ** 2 * (fy**2 + fx**2)))

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`."""
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        settings = size, tuple(self.aperture), self.spots, self.optics.diffuser / self.pitch
        q, shifts = self.q(wavelengths), self.image_shifts(wavelengths, place)
        return _kernels(self.optics.pupil, waves, q, shifts, self.is_coarse, *settings)

    def sketches(self, wavelengths, radius) -> np.ndarray:
        """See `Lens`."""
        found = self.kernels(wavelengths, (0.0, 0.0), 2 * radius + 1)
        return (found / found.sum(axis=(1, 2), keepdims=True)).astype(np.float32)

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`. Steps of a mask's phase move light as slopes of the wavefront do."""
        steps = -2 * self.q(wavelengths)[:, None] * mean_turn(self.optics.pupil)
        return super().centroids(wavelengths, place, distance) + steps

    def moments(self, wavelengths, place, distance=None, size=1) -> np.ndarray:
        """See `Lens`."""
        if self.is_coarse:
            return super().moments(wavelengths, place, distance, size)
        light = self.centroids(wavelengths, place, distance)
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        settings = tuple(self.aperture), self.spots, self.optics.diffuser / self.pitch
        q, shifts = self.q(wavelengths), self.image_shifts(wavelengths, place)
        return _moments(self.optics.pupil, waves, q, shifts, *settings, light)

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """See `Lens`."""
        optics, place = self.optics, tuple(np.asarray(spot[:2]).tolist())
        waves = self.waves(wavelengths, *polar(place), distance=float(spot[4]) or None)
        q, shifts = self.q(wavelengths), self.image_shifts(wavelengths, place) + spot[2:4]
        settings = self.aperture, self.spots, optics.diffuser / self.pitch
        found = [
            masked_energies(optics.pupil, wave, one, shift, at, at, *settings)
            for wave, one, shift in zip(waves, q, shifts, strict=True)
        ]
        centres = edges_of(optics.pupil).mean_rays(waves, q) + shifts
        return np.array(found, np.float64), centres.mean(axis=0)


@stored
def _kernels(pupil, waves, q, shifts, is_coarse, *settings):
    """Kernels (L, size, size), float64: see `gpusim.optics.masked.masked_kernel`."""
    kernel = coarse_kernel if is_coarse else masked_kernel
    made = [
        kernel(pupil, wave, one, shift, *settings)
        for wave, one, shift in zip(waves, q, shifts, strict=True)
    ]
    return np.array(made, np.float64)


@stored
def _moments(pupil, waves, q, shifts, aperture, spots, soft, centroids):
    """First moments of all pixels' energies (L, 2): see `gpusim.optics.masked.masked_moment`."""
    every = zip(waves, q, shifts, centroids, strict=True)
    return np.array(
        [
            masked_moment(pupil, wave, float(one), shift, aperture, spots, soft, centroid)
            for wave, one, shift, centroid in every
        ]
    )
