"""Transfer tables of a camera's lens, integrated over its pixels."""

from collections.abc import Callable
from dataclasses import replace
from math import ceil

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.near import near
from gpusim.kernels.optics.pupil import pupil
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.lens import open_lens, wavelength_nodes
from gpusim.optics.tables import exact_tables, transfer_tables
from gpusim.planner.plan import Plan

EVEN = 1e-7  # of a flat field's light, below float32's own error
SHORT = 127  # [sample] at least, less one, of the period of a draft's tables


class _OnDevice:
    """Makes transfer tables on a device: see `gpusim.optics.lens.Stages`."""

    whole = True

    def __init__(self, device):
        self._device = device

    def airy(self, q, aperture, rows, cols):
        """See `Stages`."""
        return airy(self._device.array(q), aperture, rows, cols, device=self._device)

    def pupil(self, outline, waves, q, aperture, rows, cols, spots, diffuser, displacement):
        """See `Stages`."""
        return pupil(
            outline,
            waves,
            self._device.array(q),
            aperture,
            rows,
            cols,
            device=self._device,
            spots=spots,
            diffuser=diffuser,
            displacement=displacement,
        )

    def given(self, tables):
        """See `Stages`."""
        return tables if self._device.kind == "numpy" else self._device.array(tables)


class LensTables:
    """Tables of a camera on a device, each stored until lens, pixels, wavelengths or period change."""

    def __init__(self, camera: Camera, device: Device, kept: Callable):
        self.camera, self.device, self._kept = camera, device, kept
        sensor = camera.sensor
        self._made_of = camera.optics, sensor.pixel_pitch, sensor.aperture, sensor.displacement

    def grid(self, samples_per_pixel):
        """Return the distance of the samples that are blurred [m], and the size of their apertures [sample].

        Samples that are pixels are integrated over the pixel's aperture; others over the whole
        cell, and pixels share them.
        """
        sensor = self.camera.sensor
        (height, width), pitch = sensor.aperture, sensor.pixel_pitch
        aperture = (height / pitch, width / pitch) if samples_per_pixel == 1 else (1.0, 1.0)
        return pitch / samples_per_pixel, aperture

    @staticmethod
    def transfer_of(*, plan: Plan, tables: "LensTables"):
        """Return the transfer tables of a plan: see `transfer`."""
        return tables.transfer(plan)

    @staticmethod
    def deviation_of(*, plan: Plan, tables: "LensTables") -> float:
        """Return the lens's blur: see `deviation`."""
        return tables.deviation(plan)

    def transfer(self, plan: Plan):
        """Return the plan's transfer tables (groups, planes, ...), stored for the next frame of the same kind."""
        assert plan.mix is not None  # a plan with blur
        name = f"transfer {plan.mix.shape}"  # tables of its wavelengths next to tables of a plan
        if plan.is_draft and (short := self._short(plan)):
            return self._kept("drafted", (short, self._key(plan)), lambda: self._widen(plan, short))

        def make():
            tables, far = self.combine(plan, self.all_bands(plan)), plan.far
            if far is None:
                return tables
            # without the Gaussians of the endless world
            energies = far.energies(plan.transfers)
            return near(tables, energies, far.sigmas, plan.period, device=self.device)

        return self._kept(name, self._key(plan), make)

    def _short(self, plan):
        """A short period that holds most of the light of points, if a CPU would be slow at the plan's; or 0.

        The rest of the light falls as 1 / r^3, is about q / SHORT of all, and ends at other places
        of the period.
        """
        if (
            self.device.is_gpu
            or (lens := self._lens(plan)).symmetry.is_round
            or plan.far is not None
            or plan.transfers is None
        ):
            return 0
        wide = 4 * lens.spread(plan.scene.wavelengths)
        short = 1 << max(SHORT, ceil(wide) - 1).bit_length()
        return short if 2 * short <= min(plan.period) else 0

    def _widen(self, plan, short):
        """Tables of the plan's period from kernels of a short period and few wavelengths, padded with zeros."""
        rows, cols = plan.period
        nodes, between = wavelength_nodes(plan.q)  # q goes with the wavelength
        few = replace(plan, q=nodes, transfers=plan.transfers @ between, period=(short, short))
        tables = self.device.numpy(self.combine(few, self.all_bands(few)))
        kernels = scipy.fft.irfft2(np.ascontiguousarray(tables).view(np.complex64), (short, short))
        middle = short // 2
        wide = np.zeros((*kernels.shape[:-1], cols), np.float32)
        wide[..., :middle], wide[..., -middle:] = kernels[..., :middle], kernels[..., middle:]
        along = scipy.fft.rfft(wide, workers=-1)
        tables = np.zeros((*along.shape[:-2], rows, along.shape[-1]), np.complex64)
        tables[..., :middle, :], tables[..., -middle:, :] = (
            along[..., :middle, :],
            along[..., middle:, :],
        )
        tables = scipy.fft.fft(tables, axis=-2, overwrite_x=True, workers=-1)
        return self.device.array(tables.view(np.float32))

    def _key(self, plan):
        """Everything that the tables of a plan depend on."""
        far = () if plan.far is None else (plan.far.sigmas, plan.far.tails)
        return (
            *far,
            self._made_of,
            plan.q,
            self.grid(plan.scene.samples_per_pixel),
            plan.period,
            plan.mix.shape,
            plan.transfers,
        )

    def _lens(self, plan):
        """The lens in front of the samples that are blurred; apertures are displaced from samples that are pixels."""
        ratio = plan.scene.samples_per_pixel
        displacement = self.camera.sensor.displacement if ratio == 1 else (0.0, 0.0)
        pitch, aperture = self.grid(ratio)
        return open_lens(self.camera.optics, pitch, aperture, displacement=displacement)

    def all_bands(self, plan: Plan, distance: float | None = None):
        """Return transfer tables of every wavelength of a plan, as the stages take them.

        Args:
            plan: A plan with blur.
            distance: Distance of the object [m]; None: the plane in focus.

        Returns:
            Quarters if the blur is round, else halves: see `gpusim.optics.lens.Lens.tables`.
        """
        return self._lens(plan).tables(plan.q, *plan.period, _OnDevice(self.device), distance)

    def at_distance(self, plan: Plan, kernel: int):
        """Return tables for objects at the distance of one of the plan's kernels: of its planes, and of white.

        Tables of planes are stored for the next frame; those for all wavelengths are too large.
        """
        assert plan.depth is not None
        distance = plan.depth.distances[kernel]
        white = plan.weights / np.maximum(plan.weights.sum(axis=1, keepdims=True), 1e-300)
        flat = np.broadcast_to(plan.flat, plan.q.shape)

        def made():
            bands, own = self.all_bands(plan, distance), self._flat(plan, distance)
            if np.abs(own / flat - 1).max() > EVEN:  # flat fields are as bright at every distance
                bands = integrate(bands, self.device.array(np.diag(flat / own)), device=self.device)
            cover = integrate(bands, self.device.array(white / flat), device=self.device)
            return self.combine(plan, bands), self.device.reshape(
                cover, (len(white), 1, *bands.shape[1:])
            )

        if plan.transfers is None:
            return made()
        return self._kept(
            f"transfer at {kernel}", (distance, white, plan.flat, *self._key(plan)), made
        )

    def _flat(self, plan: Plan, distance: float) -> np.ndarray:
        """Response to a flat field of 1 at `distance`, if every sample is a unit point source, shape (L,)."""
        lens = self._lens(plan)
        if min(lens.aperture) == 1:
            return np.ones(len(plan.q))
        return exact_tables(lens, plan.q, 1, 1, distance)[:, 0, 0]

    def deviation(self, plan: Plan) -> float:
        """Return the deviation [pixel] of the Gaussian that equals the lens on its axis at 1/4 cycle per pixel."""
        if plan.mix is None:
            return 0.0
        sensor, q = self.camera.sensor, plan.q / plan.scene.samples_per_pixel
        aperture = tuple(side / sensor.pixel_pitch for side in sensor.aperture)

        def deviation():
            # four points along a pixel, to exclude frequencies that a grid of pixels folds onto this one
            pitch, sides = sensor.pixel_pitch / 4, tuple(4 * side for side in aperture)
            tables = transfer_tables(self.camera.optics, pitch, 4 * q, sides, 32, 32)
            if tables.shape[1] == 32:  # halves, as pairs of real and imaginary parts
                tables = np.ascontiguousarray(tables).view(complex)
            light = plan.weights.sum(axis=0)
            passed = [
                light @ tables[:, i, j].real / (light @ tables[:, 0, 0].real) / np.sinc(side / 4)
                for (i, j), side in zip(((2, 0), (0, 2)), aperture, strict=True)
            ]
            return float(np.sqrt(-2 * np.log(np.clip(np.mean(passed), 1e-6, 1))) / (2 * np.pi / 4))

        return self._kept("deviation", (self._made_of, q, plan.weights), deviation)

    def combine(self, plan, bands):
        """Return transfer tables of the plan's planes from tables of its wavelengths."""
        device = self.device
        if plan.transfers is None:
            return device.reshape(bands, (1, *bands.shape))
        channels, planes, count = plan.transfers.shape
        tables = integrate(
            bands, device.array(plan.transfers.reshape(channels * planes, count)), device=device
        )
        return device.reshape(tables, (channels, planes, *bands.shape[1:]))
