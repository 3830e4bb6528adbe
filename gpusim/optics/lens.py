"""Lenses: how each kind spreads a point's light, anywhere in the field, in front of a grid of samples.

`gpusim.optics.lenses.open_lens` makes the object for the settings of a camera's optics. Everything else calls its
methods (`Lens`) and does not ask which kind it is. `PupilLens` diffracts at a pupil with a wavefront, `MaskedLens`
(`gpusim.optics.masked_lens`) at one with a mask, `MeasuredLens` has point spreads that were measured or traced by a
ray tracer, and `PointLens` does not blur. `SplitLens` is what dual pixels see of a pupil.

A field point is (y, x), 1 the distance of the frame's corner from the axis, in the direction of rows and columns.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy
import scipy.special

from gpusim.domain.interpolation import spline_weights
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import LONGEST_WAVEFRONT, symmetric
from gpusim.domain.stored import stored
from gpusim.optics import farfield, points
from gpusim.optics.depth import circle_of_confusion
from gpusim.optics.geometric import coarse_kernel, ray_error, ray_tables
from gpusim.optics.otf import transfer
from gpusim.optics.psf import fastest_turn, mean_slopes, psf_tables, spread_at, steepest_slope
from gpusim.optics.rays import AFFORDABLE, is_too_costly
from gpusim.optics.sampled import (
    difference_tables,
    moment_of_pixels,
    sampled_kernel,
    sampled_transfer,
    sketched_kernel,
    stored_difference_kernels,
    window,
)
from gpusim.optics.series import points_at

# [nm] and its q, wavelength x f-number over the distance of samples, below which rays are counted: other tables are
# sums over thousands of replicas
MIDDLE, COARSE_Q = 550.0, 0.05
NODES = 9  # wavelengths between which kernels are cubic: with 13 the image of a mild lens changes by 1e-5


@dataclass(frozen=True)
class Symmetry:
    """Symmetries of a lens's blur.

    Attributes:
        is_round: On the axis the blur is the same at every angle.
        is_mirrored: The blur at a field point is the mirror image of the blur on the other side of the axis.
        is_opposite: The blur at a field point, turned by half a turn, is the blur at the opposite point.
    """

    is_round: bool
    is_mirrored: bool
    is_opposite: bool = False


@dataclass(frozen=True)
class Tail:
    """Decay of a point's light far from it, as r^-3.

    Attributes:
        strength: Energy per square sample times r^3 / q, q = wavelength x f-number / distance of samples.
        lines: Directions [rad], from x towards y, of lines through the point along which straight edges of the pupil
            throw light; empty for round pupils.
        line_share: Part of the strength that goes along the lines, 0 .. 1.
    """

    strength: float
    lines: tuple[float, ...] = ()
    line_share: float = 0.0


class Stages(Protocol):
    """Makes transfer tables, on a device or on the host, from the description that a lens gives.

    Attributes:
        whole: Whether frames are blurred with the tables. If so, spreads that do not fit into
            the period are refused.
        affordable: Points of integrals up to which these are worth their time; beyond, pupils are sampled.
    """

    whole: bool
    affordable: float

    def airy(self, q, aperture, rows: int, cols: int) -> Any:
        """Return tables of a clear circular pupil in focus: see the stage `optics.airy`."""

    def pupil(
        self, outline, waves, q, aperture, rows: int, cols: int, spots, diffuser, displacement
    ) -> Any:
        """Return tables of any pupil: see the stage `optics.pupil`."""

    def given(self, tables: np.ndarray) -> Any:
        """Return tables that are already computed."""

    def add(self, tables, spectra: np.ndarray, is_round: bool) -> Any:
        """Return the sum of tables and of half spectra, complex (bands, rows, cols // 2 + 1): quarters if round."""


class Lens(Protocol):
    """A lens in front of a grid of samples."""

    @property
    def optics(self) -> Optics:
        """The camera's settings."""

    @property
    def pitch(self) -> float:
        """Distance of the samples [m]."""

    @property
    def aperture(self) -> tuple[float, float]:
        """Height and width over which each sample is integrated [sample]."""

    @property
    def displacement(self) -> tuple[float, float]:
        """Displacement of the apertures from the samples, (rows, cols) [sample]."""

    @property
    def axis(self) -> tuple[float, float]:
        """Where the optical axis meets the frame, from the frame's middle, (rows, cols) [sample]."""

    @property
    def least_size(self) -> int:
        """Least side of kernels that hold a point's spread [sample]."""

    @property
    def wavelengths(self) -> tuple[float, float]:
        """Shortest and longest wavelength for which the blur is known [nm]."""

    @property
    def is_pointlike(self) -> bool:
        """Whether the lens does not blur."""

    @property
    def is_uniform(self) -> bool:
        """Whether the blur is the same all over the field."""

    @property
    def is_airy(self) -> bool:
        """Whether on the axis nothing blurs but diffraction at a clear circular pupil."""

    @property
    def is_adjustable(self) -> bool:
        """Whether f-number and focus may be changed."""

    @property
    def has_pixel_windows(self) -> bool:
        """Whether kernels are integrated over whole pixels, whatever the distance of the samples."""

    @property
    def fixed_distance(self) -> str:
        """Why the blur does not follow the distance of objects, in words; "" if it does."""

    @property
    def distances(self) -> np.ndarray | None:
        """Distances [m] for which the lens has kernels, increasing; None: any."""

    @property
    def distance_model(self) -> str:
        """How the blur follows the distance, in words, if that is a model whose error is not known; else ""."""

    @property
    def has_point_kernels(self) -> bool:
        """Whether the light of a point is known at any distance from it, for highlights."""

    @property
    def symmetry(self) -> Symmetry:
        """Symmetries of the blur."""

    @property
    def tail(self) -> Tail | None:
        """Decay of light far from a point; None if the kernels hold all of it."""

    @property
    def words(self) -> str:
        """Description of the blur; for a lens that does not blur, the effects it leaves out."""

    def kernels(self, wavelengths, place, size: int, distance: float | None = None) -> np.ndarray:
        """Return the energy of every pixel around a point's image.

        Args:
            wavelengths: [nm], shape (L,).
            place: Field point (y, x).
            size: Side of the kernels [sample], odd.
            distance: Distance of the object [m]; None: the plane in focus.

        Returns:
            Kernels, float64 (L, size, size), of energy 1 in all the image.
        """

    def sketches(self, wavelengths, radius: int) -> np.ndarray:
        """Return rough kernels on the axis, float32 (L, 2 radius + 1, 2 radius + 1) of sum 1, for drafts.

        wavelengths: [nm], shape (L,). radius: [sample].
        """

    def centroids(self, wavelengths, place, distance: float | None = None) -> np.ndarray:
        """Return the centroid of all light of a point, from its ideal image, (L, 2) (rows, cols) [sample]."""

    def moments(
        self, wavelengths, place, distance: float | None = None, size: int = 1
    ) -> np.ndarray:
        """Return the first moments of the energies of all pixels around a point's ideal image, (L, 2) [sample].

        They are the centroid, unless pixels are coarser than the light's finest waves.

        Args:
            wavelengths: [nm], shape (L,).
            place: Field point (y, x).
            distance: Distance of the object [m]; None: the plane in focus.
            size: Side of `kernels` that are also computed [sample]: both then share their work.
        """

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance: float | None = None):
        """Return the optical transfer function around a point's image, without the pixels, complex (L, F).

        Lateral colour, which moves the image as a whole, is left out.

        Args:
            wavelengths: [nm], shape (L,).
            fy: Frequencies down [cycle/m], shape (F,).
            fx: Frequencies across [cycle/m], shape (F,).
            place: Field point (y, x).
            distance: Distance of the object [m]; None: the plane in focus.
        """

    def tables(self, q, rows: int, cols: int, stages: Stages, distance: float | None = None):
        """Return transfer tables on the axis at all frequencies of a period, integrated over the samples.

        Args:
            q: Wavelength times working f-number over the pitch, shape (L,).
            rows: Rows of the transform's period.
            cols: Columns of the transform's period.
            stages: Makes the tables.
            distance: Distance of the object [m]; None: the plane in focus.

        Returns:
            Real quarters (L, rows // 2 + 1, cols // 2 + 1) if the blur is round and the apertures are not displaced,
            else halves (L, rows, 2 (cols // 2 + 1)) as `optics.blur` takes them.
        """

    def table_parts(self, q, rows: int, cols: int, stages: Stages) -> tuple | None:
        """Return tables of the lens in focus, and kernels that hold the rest, if `tables` are sums of these.

        Else None. The kernels are float32 (L, n, n), n odd.
        """

    def table_error(self, wavelengths, distance: float | None = None) -> float:
        """Return the error of the transfer tables that is not far below all others [1]; 0 if there is none."""

    def tails(self, wavelengths) -> np.ndarray:
        """Return the decay as powers r^-3, r^-5, r^-7, shape (L, 3): see `gpusim.optics.farfield.tail`."""

    def spread(self, wavelengths, height: float = 0.0, distance: float | None = None) -> float:
        """Return the radius within which the rays of a point meet the image, or its spread ends [sample].

        Args:
            wavelengths: [nm], shape (L,).
            height: Field height, 0 on the axis, 1 in the corner.
            distance: Distance of the object [m]; None: the plane in focus.
        """

    def cutoff(self, wavelength: float) -> float:
        """Return the frequency beyond which nothing is transferred at `wavelength` [nm], [cycle/m]."""

    def sampled_spread(self, wavelengths, place, reach: float, count: int):
        """Return a picture of the point spread without the pixels, and the distance of its samples [m].

        Args:
            wavelengths: [nm], shape (L,).
            place: Field point (y, x). Lateral colour is left out.
            reach: Half of the picture's side [m]; measured spreads have their own.
            count: Samples along a side, odd; measured spreads have their own.

        Returns:
            Energies (L, rows, cols) and the distance of their samples [m].
        """

    @property
    def spots(self) -> tuple[float, float]:
        """Distances of a low-pass filter's spots from their middle, (rows, cols) [sample]."""

    def q(self, wavelengths) -> np.ndarray:
        """Return the wavelengths [nm] times working f-number over the distance of samples, shape (L,)."""

    def waves(self, wavelengths, height=0.0, azimuth=0.0, distance=None) -> np.ndarray:
        """Return wavefronts in the pupil, flat ones of a lens without a pupil: see `Optics.waves`."""

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """Return the energies of pixels around a point, and the middle of the light far from it.

        Args:
            wavelengths: [nm], shape (L,).
            spot: Field point (y, x), the image's displacement (rows, cols) [sample], and the distance; 0: in focus [m].
            at: Rows, and columns, of the pixels from the point [sample], shape (n,); without a `tail` -k ... k.

        Returns:
            Energies (L, n, n), and rows and columns (2,) of the middle [sample].
        """

    def describe(self, by_depth: bool) -> tuple[str, str]:
        """Return the stage that makes the tables, and the blur in words.

        by_depth: if it follows the distance.
        """


class _OnGrid:
    """Common to all lenses."""

    optics: Optics
    pitch: float

    is_pointlike = False
    is_adjustable = True
    has_point_kernels = True
    has_pixel_windows = False
    distances = None
    distance_model = ""

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`."""
        raise NotImplementedError

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`."""
        raise NotImplementedError

    def sketches(self, wavelengths, radius) -> np.ndarray:
        """See `Lens`."""
        found = self.kernels(wavelengths, (0.0, 0.0), 2 * radius + 1)
        return (found / found.sum(axis=(1, 2), keepdims=True)).astype(np.float32)

    def moments(self, wavelengths, place, distance=None, size=1) -> np.ndarray:
        """See `Lens`."""
        return self.centroids(wavelengths, place, distance)

    @property
    def is_uniform(self) -> bool:
        """See `Lens`."""
        return not self.optics.varies

    @property
    def words(self) -> str:
        """See `Lens`."""
        return self.optics.description

    def tails(self, wavelengths) -> np.ndarray:
        """See `Lens`."""
        return np.zeros((len(wavelengths), len(farfield.POWERS)))

    def table_parts(self, q, rows, cols, stages) -> tuple | None:
        """See `Lens`."""
        return None

    def table_error(self, wavelengths, distance=None) -> float:
        """See `Lens`."""
        return 0.0

    def cutoff(self, wavelength) -> float:
        """See `Lens`."""
        return np.inf

    def describe(self, by_depth) -> tuple[str, str]:
        """See `Lens`."""
        return "optics.pupil", self.words

    @property
    def spots(self) -> tuple[float, float]:
        """See `Lens`."""
        down, across = self.optics.birefringence
        return down / self.pitch / 2, across / self.pitch / 2

    def q(self, wavelengths) -> np.ndarray:
        """See `Lens`."""
        return np.asarray(wavelengths) * 1e-9 * self.optics.working_f_number / self.pitch

    def waves(self, wavelengths, height=0.0, azimuth=0.0, distance=None) -> np.ndarray:
        """See `Lens`."""
        return np.zeros((len(wavelengths), 1, 1))

    def nanometres(self, q) -> np.ndarray:
        """Return the wavelengths [nm] of q, shape (L,)."""
        return q * self.pitch / self.optics.working_f_number * 1e9


@dataclass(frozen=True, eq=False)
class PupilLens(_OnGrid):
    """A lens that diffracts at its pupil (circle, polygon or ring), with wavefronts (defocus, Zernike, Seidel).

    Args:
        optics: Settings of the lens.
        pitch: Distance of the samples [m].
        aperture: Height and width over which each sample is integrated [sample].
        corner: Distance of the frame's corner from the axis [sample], for lateral colour.
        displacement: Displacement of the apertures' middles from the samples, (rows, cols) [sample].
        axis: Where the optical axis meets the frame, from its middle, (rows, cols) [sample].
    """

    optics: Optics
    pitch: float
    aperture: tuple[float, float]
    corner: float
    displacement: tuple[float, float] = (0.0, 0.0)
    axis: tuple[float, float] = (0.0, 0.0)

    least_size = 1
    wavelengths = (0.0, np.inf)
    fixed_distance = ""

    @property
    def is_airy(self) -> bool:
        """See `Lens`."""
        return self.optics.is_ideal

    @cached_property
    def symmetry(self) -> Symmetry:
        """See `Lens`."""
        is_centred, sides = not any(self.displacement), len(self.optics.pupil.sides)
        is_mirrored = self.optics.has_mirror and is_centred
        return Symmetry(self.optics.is_symmetric, is_mirrored, is_centred and sides % 2 == 0)

    @cached_property
    def tail(self) -> Tail:
        """See `Lens`."""
        pupil = self.optics.pupil
        share = float(pupil.outline / (pupil.outline + 2 * np.pi * pupil.obscuration))
        lines = tuple(pupil.sides.tolist())
        return Tail(farfield.edge_tail(pupil), lines, share if lines else 0.0)

    def tails(self, wavelengths) -> np.ndarray:
        """See `Lens`."""
        optics, (down, across) = self.optics, self.optics.birefringence
        soft = (optics.diffuser / self.pitch) ** 2
        rows = self.aperture[0] ** 2 / 12 + (down / self.pitch / 2) ** 2 + soft
        cols = self.aperture[1] ** 2 / 12 + (across / self.pitch / 2) ** 2 + soft
        waves = self.waves(wavelengths)
        return farfield.tail(optics.pupil, self.q(wavelengths), waves, rows + cols)

    def spread(self, wavelengths, height=0.0, distance=None) -> float:
        """See `Lens`."""
        waves, radius = self.waves(wavelengths, height, distance=distance), 0.0
        for q, wave in zip(self.q(wavelengths), waves, strict=True):
            if wave.any():
                radius = max(radius, 2 * q * steepest_slope(wave))
        return radius

    def cutoff(self, wavelength) -> float:
        """See `Lens`."""
        return 1 / (wavelength * 1e-9 * self.optics.working_f_number)

    def describe(self, by_depth) -> tuple[str, str]:
        """See `Lens`."""
        if self.is_airy and not by_depth and not any(self.displacement):
            return "optics.airy", "diffraction-limited circular pupil"
        return "optics.pupil", self.words

    def tables(self, q, rows, cols, stages, distance=None):
        """See `Lens`."""
        waves = self.waves(self.nanometres(q), distance=distance)
        if self.counts_rays(waves):
            return self._ray_tables(waves, q, rows, cols, stages)
        if self.is_airy and distance is None and not any(self.displacement):
            return stages.airy(q, self.aperture, rows, cols)
        optics = self.optics
        if not is_too_costly(optics.pupil, waves, stages.affordable):
            return self._pupil_tables(waves, q, rows, cols, stages)
        focus = self._pupil_tables(np.zeros((len(q), 1, 1)), q, rows, cols, stages)
        first, *settings = self._sampling_of(waves, q)
        other = difference_tables(*first, rows, cols, *settings)
        is_round = symmetric(optics.pupil, waves) and not any(self.displacement)
        return stages.add(focus, other, is_round)

    def table_parts(self, q, rows, cols, stages) -> tuple | None:
        """See `Lens`."""
        waves = self.waves(self.nanometres(q))
        if self.counts_rays(waves) or not is_too_costly(
            self.optics.pupil, waves, stages.affordable
        ):
            return None
        focus = self._pupil_tables(np.zeros((len(q), 1, 1)), q, rows, cols, stages)
        first, *settings = self._sampling_of(waves, q)
        return focus, stored_difference_kernels(*first, *settings)

    def _sampling_of(self, waves, q):
        """Arguments of `difference_tables`: pupil, waves and q together, and those after the period."""
        soft, shift = self.optics.diffuser / self.pitch, tuple(-np.array(self.displacement))
        return (self.optics.pupil, waves, q), self.aperture, self.spots, soft, shift

    def _pupil_tables(self, waves, q, rows, cols, stages):
        """Tables of integrals over the pupil."""
        images, soft = tuple(2 * spot for spot in self.spots), self.optics.diffuser / self.pitch
        settings = self.aperture, rows, cols, images, soft, self.displacement
        return stages.pupil(self.optics.pupil, waves, q, *settings)

    def _ray_tables(self, waves, q, rows, cols, stages):
        """Tables of rays, see `gpusim.optics.geometric`."""
        move = -np.array(self.displacement)
        spots, soft = self.spots, self.optics.diffuser / self.pitch
        pupil, settings = self.optics.pupil, (self.aperture, spots, soft, move)
        tables = ray_tables(pupil, waves, q, rows, cols, *settings)
        if symmetric(pupil, waves) and not any(self.displacement):
            return stages.given(tables[:, : rows // 2 + 1].real.astype(np.float32))
        return stages.given(tables.astype(np.complex64).view(np.float32))

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance=None) -> np.ndarray:
        """See `Lens`."""
        wavelengths, fy, fx = checked_frequencies(wavelengths, fy, fx)
        optics = self.optics
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        cut = wavelengths * 1e-9 * optics.working_f_number  # [m/cycle]
        found = np.empty((len(waves), fx.size), complex)
        for own, wave, one in zip(found, waves, cut, strict=True):
            sx, sy = fx * one, fy * one
            if points_at(optics.pupil, wave[None], fx.size) > AFFORDABLE:
                own[:] = sampled_transfer(optics.pupil, wave, sx, sy)
            else:
                own[:] = transfer(optics.pupil, wave[None], sx, sy)[0]
        down, across = optics.birefringence
        spots = np.cos(np.pi * down * fy) * np.cos(np.pi * across * fx)
        return found * (spots * np.exp(-2 * (np.pi * optics.diffuser) ** 2 * (fy**2 + fx**2)))

    def sampled_spread(self, wavelengths, place, reach, count) -> tuple[np.ndarray, float]:
        """See `Lens`."""
        step = 2 * reach / count
        alone = type(self)(replace(self.optics, lateral_color=0.0), step, (1.0, 1.0), 0.0)
        return alone.kernels(wavelengths, place, count), step

    def table_error(self, wavelengths, distance=None) -> float:
        """See `Lens`."""
        waves = self.waves(wavelengths, distance=distance)
        if self.counts_rays(waves):
            return ray_error(self.optics.pupil, waves, self.q(wavelengths))
        if not is_too_costly(self.optics.pupil, waves):
            return 0.0
        return window(self.optics.pupil, waves)[1]

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """See `Lens`. The energies are exact integrals, without a diffuser."""
        optics, place = self.optics, tuple(np.asarray(spot[:2]).tolist())
        waves = self.waves(wavelengths, *polar(place), distance=float(spot[4]) or None)
        shifts = self.image_shifts(wavelengths, place) + spot[2:4]
        found, centres = np.empty((len(waves), len(at), len(at))), np.empty((len(waves), 2))
        for own, centre, q, wave, shift in zip(
            found, centres, self.q(wavelengths), waves, shifts, strict=True
        ):
            middle = (optics.pupil, wave, q)
            own[:] = points.near_energies(
                *middle, at - shift[0], at - shift[1], self.aperture, self.spots
            )
            centre[:] = points.rim_centre(*middle) + shift
        return found, centres.mean(axis=0)

    @property
    def is_coarse(self) -> bool:
        """Whether samples are so much coarser than lambda N that rays are counted."""
        return float(self.q(MIDDLE)) < COARSE_Q

    def counts_rays(self, waves) -> bool:
        """Whether tables are of rays: samples are coarse, or waves are more than are worth diffracting."""
        return self.is_coarse or max(map(fastest_turn, waves)) > 2 * LONGEST_WAVEFRONT

    def waves(self, wavelengths, height=0.0, azimuth=0.0, distance=None) -> np.ndarray:
        """Return wavefronts: see `Optics.waves`. Rays may be of any number of waves."""
        longest = np.inf if self.is_coarse or distance is None else LONGEST_WAVEFRONT
        return self.optics.waves(wavelengths, height, azimuth, distance, longest)

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`."""
        optics, q = self.optics, self.q(wavelengths)
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        shifts = self.image_shifts(wavelengths, place)
        spots, soft = self.spots, optics.diffuser / self.pitch
        settings = size, tuple(self.aperture), spots, soft
        return _kernels(optics.pupil, waves, q, shifts, self.is_coarse, *settings)

    def sketches(self, wavelengths, radius) -> np.ndarray:
        """See `Lens`."""
        waves, q = self.waves(wavelengths), self.q(wavelengths)
        draw = coarse_kernel if self.counts_rays(waves) else sketched_kernel
        shift, soft = tuple(-np.array(self.displacement)), self.optics.diffuser / self.pitch
        settings = shift, 2 * radius + 1, self.aperture, self.spots, soft
        # one after the other: starting threads takes longer
        made = [
            draw(self.optics.pupil, wave, one, *settings)
            for wave, one in zip(waves, q, strict=True)
        ]
        return np.array(made, np.float32)

    def image_shifts(self, wavelengths, place) -> np.ndarray:
        """Return displacements of images by lateral colour and by the apertures, (L, 2) (rows, cols) [sample]."""
        return self._colour_shifts(wavelengths, place) - np.array(self.displacement)

    def _colour_shifts(self, wavelengths, place):
        """Displacement of a point's image by lateral colour, (L, 2) [sample]."""
        colour = self.optics.lateral_color_at(np.asarray(wavelengths, np.float64)) * self.corner
        return colour[:, None] * np.array(place, np.float64)

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`. Kernels that end hold only part of the light. A ray meets the image at -2 q grad W."""
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        rays = -2 * self.q(wavelengths)[:, None] * mean_slopes(self.optics.pupil, waves)
        return rays + self.image_shifts(wavelengths, place)

    def moments(self, wavelengths, place, distance=None, size=1) -> np.ndarray:
        """See `Lens`."""
        q, light = self.q(wavelengths), self.centroids(wavelengths, place, distance)
        if q.min() >= 1:
            return light
        shifts = self.image_shifts(wavelengths, place)
        if self.is_coarse:  # the kernels hold all light
            rays = self.spread(wavelengths, float(np.hypot(*place)), distance)
            size = 2 * int(np.ceil(rays + np.abs(shifts).max())) + 3
            return _first_moments(self.kernels(wavelengths, place, size, distance))
        pupil, soft = self.optics.pupil, self.optics.diffuser / self.pitch
        waves = self.waves(wavelengths, *polar(place), distance=distance)
        settings = tuple(self.aperture), self.spots, soft
        return _moments(pupil, waves, q, shifts, *settings, light, size)


@stored
def _moments(pupil, waves, q, shifts, aperture, spots, soft, centroids, size):
    """First moments of all pixels' energies (L, 2): see `gpusim.optics.sampled.moment_of_pixels`."""
    return np.array(
        [
            moment_of_pixels(pupil, wave, float(one), shift, aperture, spots, soft, centroid, size)
            for wave, one, shift, centroid in zip(waves, q, shifts, centroids, strict=True)
        ]
    )


@stored
def _kernels(pupil, waves, q, shifts, is_coarse, *settings):
    """Kernels (L, size, size), float64: see `gpusim.optics.sampled.sampled_kernel`."""
    kernel = coarse_kernel if is_coarse else sampled_kernel
    return np.array(
        [
            kernel(pupil, wave, one, shift, *settings)
            for wave, one, shift in zip(waves, q, shifts, strict=True)
        ],
        np.float64,
    )


@dataclass(frozen=True, eq=False)
class MeasuredLens(_OnGrid):
    """A lens whose point spreads were measured, or computed by a ray tracer.

    Args:
        optics: Settings of the lens.
        spread_data: The point spreads.
        pitch: Distance of the samples [m].
        aperture: Height and width over which each sample is integrated [sample].
        corner: Field height of the frame's corner along rows and columns; places beyond take the border's spread.
        displacement: Displacement of the apertures' middles from the samples, (rows, cols) [sample].
        axis: Where the optical axis meets the frame, from its middle, (rows, cols) [sample].
    """

    optics: Optics
    spread_data: PointSpread
    pitch: float
    aperture: tuple[float, float]
    corner: tuple[float, float]
    displacement: tuple[float, float] = (0.0, 0.0)
    axis: tuple[float, float] = (0.0, 0.0)

    is_airy = is_adjustable = False
    tail = None
    fixed_distance = ""
    symmetry = Symmetry(False, False)

    @property
    def distances(self) -> np.ndarray | None:  # type: ignore[override]  # a setting of other lenses
        """See `Lens`."""
        return self.spread_data.distances

    @property
    def distance_model(self) -> str:  # type: ignore[override]
        """See `Lens`."""
        if self.distances is not None:
            return ""
        return (
            "point spreads that were measured at one distance are convolved with the disc by which a thin lens of "
            "their f-number is out of focus at another"
        )

    @property
    def wavelengths(self) -> tuple[float, float]:
        """See `Lens`."""
        known = self.spread_data.wavelengths
        return known[0], known[-1]

    @property
    def least_size(self) -> int:
        """Least size of the kernels [pixel] that holds the spreads."""
        return int(np.ceil(2 * self.spread(()) + 2 * max(map(abs, self.displacement)))) + 2

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`. Raises OutOfRange if the measured spread is larger than `size` samples."""
        place = tuple(np.clip(place, np.negative(self.corner), self.corner).tolist())
        tables = self._tables(wavelengths, size, size, distance, place=place)
        kernels = np.fft.irfft2(tables.view(np.complex128), (size, size))
        kernels = np.fft.fftshift(kernels, axes=(1, 2))
        return kernels / kernels.sum(axis=(1, 2), keepdims=True)

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`. The kernels hold all light."""
        size = max(self.least_size, 2 * int(np.ceil(self.spread((), 0.0, distance))) + 3) | 1
        return _first_moments(self.kernels(wavelengths, place, size, distance))

    def spread(self, wavelengths, height=0.0, distance=None) -> float:
        """See `Lens`."""
        data = self.spread_data
        own = max(data.values.shape[-2:]) * data.spacing / self.pitch / 2
        return own + abs(self._disc(distance)) / self.pitch / 2

    def tables(self, q, rows, cols, stages, distance=None):
        """See `Lens`."""
        finest = float(q.min()) * self.pitch / 2 if stages.whole else 0.0
        wavelengths = self.nanometres(q)
        tables = self._tables(wavelengths, rows, cols, distance, finest=finest, whole=stages.whole)
        return stages.given(tables)

    def _disc(self, distance) -> float:
        """Return the diameter of the disc with which the spreads are convolved at a distance [m]; 0 for None."""
        if distance is None or self.distances is not None:
            return 0.0
        return float(circle_of_confusion(self.optics, distance))

    def _own(self, distance) -> float:
        """Return a distance [m]; of None, the one in focus."""
        return self.optics.object_distance if distance is None else distance

    def _tables(self, wavelengths, rows, cols, distance, **options):
        """Transfer tables of the point spreads at a distance, see `psf_tables` for the options."""
        tables = psf_tables(
            self.spread_data,
            wavelengths,
            self.pitch,
            self.aperture,
            rows,
            cols,
            displacement=self.displacement,
            distance=self._own(distance),
            **options,
        )
        disc = self._disc(distance) / self.pitch
        if not disc:
            return tables
        fy, fx = np.fft.fftfreq(rows), np.arange(cols // 2 + 1) / cols
        passed = _disc_transfer(disc * np.hypot(fy[:, None], fx))
        whole = np.ascontiguousarray(tables, np.float64).view(np.complex128) * passed
        return whole.view(np.float64)

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance=None) -> np.ndarray:
        """See `Lens`. Between its wavelengths a measured point spread is linear."""
        wavelengths, fy, fx = checked_frequencies(wavelengths, fy, fx)
        values = spread_at(self.spread_data, wavelengths, place, self._own(distance))
        spacing, (rows, cols) = self.spread_data.spacing, values.shape[1:]
        left = np.exp(-2j * np.pi * spacing * np.outer(fy, np.arange(rows) - (rows - 1) / 2))
        right = np.exp(-2j * np.pi * spacing * np.outer(fx, np.arange(cols) - (cols - 1) / 2))
        found = np.einsum("fy,lyx,fx->lf", left, values, right, optimize=True)
        return found * _disc_transfer(self._disc(distance) * np.hypot(fy, fx))

    def sampled_spread(self, wavelengths, place, reach, count) -> tuple[np.ndarray, float]:
        """See `Lens`."""
        values = spread_at(self.spread_data, wavelengths, place, self.optics.object_distance)
        return values, self.spread_data.spacing

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """See `Lens`."""
        y, x, down, across, distance = np.asarray(spot).tolist()
        moved = self.displacement[0] - down, self.displacement[1] - across
        lens = replace(self, displacement=moved)
        return lens.kernels(wavelengths, (y, x), len(at), distance or None), np.zeros(2)


@dataclass(frozen=True, eq=False)
class PointLens(_OnGrid):
    """A lens that does not blur: a point's image is a point.

    Args:
        optics: Settings of the lens.
        pitch: Distance of the samples [m].
        aperture: Height and width over which each sample is integrated [sample].
        axis: Where the optical axis meets the frame, from its middle, (rows, cols) [sample].
    """

    optics: Optics
    pitch: float
    aperture: tuple[float, float]
    axis: tuple[float, float] = (0.0, 0.0)

    least_size = 1
    wavelengths = (0.0, np.inf)
    displacement = (0.0, 0.0)
    is_pointlike = True
    is_airy = False
    tail = None
    fixed_distance = "there is no blur"
    symmetry = Symmetry(True, True)

    @property
    def words(self) -> str:
        """See `Lens`."""
        return f'{self.optics.ignored_settings}: optics.model is "none"'

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`."""
        out = np.zeros((len(wavelengths), size, size))
        out[:, size // 2, size // 2] = 1
        return out

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`."""
        return np.zeros((len(wavelengths), 2))

    def spread(self, wavelengths, height=0.0, distance=None) -> float:
        """See `Lens`."""
        return 0.0

    def tables(self, q, rows, cols, stages, distance=None):
        """See `Lens`."""
        return stages.given(np.ones((len(q), rows // 2 + 1, cols // 2 + 1)))

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance=None) -> np.ndarray:
        """See `Lens`."""
        wavelengths, fy, fx = checked_frequencies(wavelengths, fy, fx)
        return np.ones((len(wavelengths), fx.size), complex)

    def sampled_spread(self, wavelengths, place, reach, count) -> tuple[np.ndarray, float]:
        """See `Lens`."""
        return self.kernels(wavelengths, place, count), 2 * reach / count

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """See `Lens`."""
        return self.kernels(wavelengths, spot[:2], len(at)), np.zeros(2)


def kernels_at(lens: Lens, wavelengths, points, size: int) -> np.ndarray:
    """Return kernels at many field points and distances, by all cores, (points, L, size, size).

    Args:
        lens: The lens.
        wavelengths: [nm], shape (L,).
        points: Pairs of a field point (y, x) and a distance [m], or None for the plane in focus.
        size: Side of the kernels [sample], odd.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        made = pool.map(lambda point: lens.kernels(wavelengths, point[0], size, point[1]), points)
        return np.array(list(made))


def _first_moments(kernels) -> np.ndarray:
    """Return the first moments of kernels (L, size, size), (rows, cols) [sample], shape (L, 2)."""
    at = np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2
    return np.stack([kernels.sum(axis=2) @ at, kernels.sum(axis=1) @ at], axis=1)


def _disc_transfer(cycles) -> np.ndarray:
    """Return the transfer of an even disc at frequencies in cycles per diameter."""
    v = np.pi * np.maximum(np.abs(cycles), 1e-9)
    return 2 * scipy.special.j1(v) / v


def polar(place) -> tuple[float, float]:
    """Return height and azimuth [rad] of a field point (y, x)."""
    y, x = place
    return float(np.hypot(y, x)), float(np.arctan2(y, x))


def checked_frequencies(wavelengths, fy, fx):
    """Return wavelengths (L,) and frequencies (F,), (F,) as arrays."""
    fy, fx = np.broadcast_arrays(*np.atleast_1d(fy, fx))
    return np.atleast_1d(np.asarray(wavelengths, np.float64)), fy.astype(float), fx.astype(float)


def wavelength_nodes(wavelengths, count: int = NODES):
    """Return interpolation nodes (at most `count` wavelengths) and the interpolation matrix (L, nodes)."""
    wavelengths = np.asarray(wavelengths, np.float64)
    if len(wavelengths) <= count:
        return wavelengths, np.eye(len(wavelengths))
    nodes = np.linspace(wavelengths[0], wavelengths[-1], count)
    return nodes, spline_weights(nodes, wavelengths)
