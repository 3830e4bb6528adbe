"""Transfer tables of a camera's lens, integrated over its pixels."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.pupil import Wavefront
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.near import near
from gpusim.kernels.optics.pupil import pupil
from gpusim.kernels.processor.sharpen import system_kernel
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.depth import DepthPlan
from gpusim.optics.lens import wavelength_nodes
from gpusim.optics.lenses import moved_apertures, open_lens
from gpusim.optics.psf import fastest_turn
from gpusim.optics.rays import AFFORDABLE
from gpusim.optics.tables import add_spectra, exact_tables, transfer_tables
from gpusim.planner.choices import Blur, Fusion, Sketch
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.plan import Plan

EVEN = 1e-7  # of a flat field's light, below float32's own error
SKETCH_NODES = 5  # wavelengths between which kernels of sketches are cubic
DRAFT_BANDS = 17  # wavelengths between which tables of drafts are cubic: they err by 5e-4 at most
MOST_TURN = 4.0  # [waves per radius] of the wavefront up to which they do
MOST_WRAPS = 4  # periods in a kernel, up to which kernels of planes are transformed
RADII, ANGLES = 65, 129  # of frequencies between which a transfer function in focus is linear


class _OnDevice:
    """Makes transfer tables on a device: see `gpusim.optics.lens.Stages`."""

    whole = True
    affordable = AFFORDABLE

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

    def add(self, tables, spectra, is_round):
        """See `Stages`."""
        return self.given(add_spectra(self._device.numpy(tables), spectra, is_round))


class LensTables:
    """Tables of a camera on a device, each stored until lens, pixels, wavelengths or period change."""

    def __init__(self, camera: Camera, device: Device, cache: Callable):
        self.camera, self.device, self._cache = camera, device, cache

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

    @staticmethod
    def kernel_of(*, plan: Plan, tables: "LensTables") -> np.ndarray | None:
        """Return the kernel of lens and pixels: see `kernel`."""
        return tables.kernel(plan)

    def transfer(self, plan: Plan):
        """Return the plan's transfer tables (groups, planes, ...), stored for the next frame of the same kind."""
        blur, fusion = plan.find(Blur), plan.find(Fusion)
        assert blur is not None  # a plan with blur
        made_of = self._made_of(plan), blur.period, fusion and fusion.transfers
        if (sketch := plan.find(Sketch)) is not None:
            return self._cache("sketched", sketch_tables, *made_of, sketch.radius, self.device)
        # tables of its wavelengths next to tables of a plan
        name = f"transfer {blur.mix.shape}"
        is_draft = plan.is_draft and fusion is not None
        return self._cache(name, make_tables, *made_of, plan.find(FarField), self.device, is_draft)

    def _made_of(self, plan) -> tuple:
        """Everything that tables of wavelengths depend on: lens, distance and size of samples, displacement, and q."""
        ratio = plan.scene.samples_per_pixel
        optics = self.camera.optics
        displacement = moved_apertures(optics, self.camera.sensor.displacement, ratio)
        return optics, *self.grid(ratio), displacement, plan.q

    def all_bands(self, plan: Plan, distance: float | None = None):
        """Return transfer tables of every wavelength of a plan, as the stages take them.

        Args:
            plan: A plan with blur.
            distance: Distance of the object [m]; None: the plane in focus.

        Returns:
            Quarters if the blur is round, else halves: see `gpusim.optics.lens.Lens.tables`.
        """
        return bands_of(self._made_of(plan), plan.period, self.device, distance)

    def at_distance(self, plan: Plan, kernel: int):
        """Return tables for objects at the distance of one of the plan's kernels: of its planes, and of white.

        Tables of planes are stored for the next frame; those for all wavelengths are too large.
        """
        blur = plan.find(Blur)
        assert blur is not None
        made_of = *self.made_at_distance(plan, kernel, blur.period), self.device
        if plan.find(Fusion) is None:
            return tables_at_distance(*made_of)
        return self._cache(f"transfer at {kernel}", tables_at_distance, *made_of)

    def made_at_distance(self, plan: Plan, kernel: int, period: tuple[int, int]) -> tuple:
        """Return the arguments of `tables_at_distance` for one of the plan's kernels, but for the device."""
        depth, fusion = plan.find(DepthPlan), plan.find(Fusion)
        assert depth is not None
        return (
            self._made_of(plan),
            period,
            fusion and fusion.transfers,
            depth.distances[kernel],
            plan.weights / np.maximum(plan.weights.sum(axis=1, keepdims=True), 1e-300),
            np.broadcast_to(plan.flat, plan.q.shape),
        )

    def in_focus(self, plan: Plan) -> tuple:
        """Return tables of white in the channels in focus, (C, 1, ...): with samples, and of diffraction only.

        Neither displaces.
        """
        blur = plan.find(Blur)
        assert blur is not None
        optics, *lens, _, q = self._made_of(plan)
        optics = replace(optics, wavefront=Wavefront(), defocus=0.0)  # rays know these
        made_of = (optics, *lens, (0.0, 0.0), q), blur.period, plan.weights, plan.flat, self.device
        return self._cache("transfer in focus", tables_in_focus, *made_of)

    def displacement(self, plan: Plan) -> tuple[float, float]:
        """Return how far tables displace samples, (rows, cols) [sample]."""
        return self._made_of(plan)[3]

    def deviation(self, plan: Plan) -> float:
        """Return the deviation [pixel] of the Gaussian that equals the lens on its axis at 1/4 cycle per pixel."""
        if plan.find(Blur) is None:
            return 0.0
        sensor, ratio = self.camera.sensor, plan.scene.samples_per_pixel
        aperture = tuple(side / sensor.pixel_pitch for side in sensor.aperture)
        light = plan.weights.sum(axis=0)
        made_of = self.camera.optics, sensor.pixel_pitch, aperture, plan.q / ratio, light
        return self._cache("deviation", fit_gaussian, *made_of)

    def kernel(self, plan: Plan) -> np.ndarray | None:
        """Return the kernel of lens and pixels on the axis, in focus, for `processor.sharpen`; None without blur.

        Pixels that are binned are one pixel of their area.
        """
        if plan.find(Blur) is None:
            return None
        sensor, width = self.camera.sensor, prod(self.camera.sensor.binning) ** 0.5
        aperture = tuple(side / sensor.pixel_pitch for side in sensor.aperture)
        q, light = plan.q / plan.scene.samples_per_pixel / width, plan.weights.sum(axis=0)
        made_of = self.camera.optics, width * sensor.pixel_pitch, aperture, q, light
        return self._cache("kernel", measure_kernel, *made_of)


def bands_of(made_of, period, device, distance=None) -> Any:
    """Return transfer tables of every wavelength: see `LensTables.all_bands`. made_of: see `LensTables._made_of`."""
    optics, pitch, aperture, displacement, q = made_of
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    rows, cols = period
    return lens.tables(q, rows, cols, _OnDevice(device), distance)


def combine_bands(bands, transfers, device) -> Any:
    """Return transfer tables of planes (groups, planes, ...) from tables of wavelengths.

    transfers: weight of each wavelength in each plane, (C, planes, L); None: each plane is one wavelength.
    """
    if transfers is None:
        return device.reshape(bands, (1, *bands.shape))
    channels, planes, count = transfers.shape
    weights = device.array(transfers.reshape(channels * planes, count))
    tables = integrate(bands, weights, device=device)
    return device.reshape(tables, (channels, planes, *bands.shape[1:]))


def make_tables(made_of, period, transfers, far, device, is_draft=False) -> Any:
    """Return transfer tables of planes, without the Gaussians of the endless world.

    far: these, or None. is_draft: whether tables of few wavelengths are interpolated.
    """
    own = transfers
    if is_draft:
        optics, *settings, q = made_of
        # q goes with the wavelength; few counts, as kernels are compiled for each
        shortest = q.min(keepdims=True) * settings[0] / optics.working_f_number * 1e9
        turn = fastest_turn(optics.waves(shortest, longest=np.inf)[0])
        nodes, between = wavelength_nodes(q, DRAFT_BANDS if turn < MOST_TURN else len(q))
        made_of, own = (optics, *settings, nodes), transfers @ between
    tables = None
    if own is not None:
        tables = _sum_of_parts(made_of, period, own, device)
    if tables is None:
        tables = combine_bands(bands_of(made_of, period, device), own, device)
    if far is None:
        return tables
    return near(tables, far.energies(transfers), far.sigmas, period, device=device)


def _sum_of_parts(made_of, period, transfers, device) -> Any:
    """Return tables of planes from kernels of planes in place of many wavelengths; None if the lens has none."""
    optics, pitch, aperture, displacement, q = made_of
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    if device.kind == "numpy":
        return None
    parts = lens.table_parts(q, period[0], period[1], _OnDevice(device))
    if parts is None or parts[1].shape[-1] > MOST_WRAPS * max(period):
        return None
    focus = device.numpy(combine_bands(parts[0], transfers, device))
    rest = _spectra_of_kernels(
        np.tensordot(transfers.astype(np.float32), parts[1], 1), period, device
    )
    whole = device.numpy(rest).view(np.complex64)
    high = period[0] // 2 + 1
    if focus.shape == rest.shape:
        whole += focus.view(np.complex64)
    elif lens.symmetry.is_round and not any(displacement):
        return device.array(focus + whole[..., :high, :].real)
    else:
        whole.real[..., :high, :] += focus
        whole.real[..., high:, :] += focus[..., period[0] - high : 0 : -1, :]
    return _write_back(device, rest, whole)


def sketch_tables(made_of, period, transfers, radius, device) -> Any:
    """Return transfer tables of channels for drafts, halves (1, channels, ...), from kernels of few wavelengths.

    transfers: part of each wavelength in the light of each channel, (1, channels, L). radius: of the kernels [sample].
    """
    optics, pitch, aperture, displacement, q = made_of
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    nodes, between = wavelength_nodes(q, SKETCH_NODES)  # q goes with the wavelength
    bands = lens.sketches(nodes * pitch / optics.working_f_number * 1e9, radius)
    kernels = np.tensordot((transfers @ between).astype(np.float32), bands, 1)
    return _spectra_of_kernels(kernels, period, device)


def _spectra_of_kernels(kernels, period, device):
    """Return half tables (groups, planes, ...) of kernels (groups, planes, n, n), their middle at sample 0."""
    (rows, cols), size = period, kernels.shape[-1]
    at, half = np.arange(size) - size // 2, cols // 2 + 1
    lines = np.zeros((*kernels.shape[:-1], cols), np.float32)
    for part in _parts(size, cols):  # what is longer than the period is wrapped
        lines[..., at[part] % cols] += kernels[..., part]
    tables = device.empty((*kernels.shape[:2], rows, 2 * half))
    with device.host_work():
        whole, spectra = device.numpy(tables).view(np.complex64), scipy.fft.rfft(lines, workers=-1)
        whole[:] = 0
        for part in _parts(size, rows):
            whole[..., at[part] % rows, :] += spectra[..., part, :]
        found = scipy.fft.fft(whole, axis=-2, overwrite_x=True, workers=-1)
        if not np.may_share_memory(found, whole):
            whole[:] = found
    return _write_back(device, tables, whole)


def _write_back(device, array, values):
    """Return a device's array whose values were changed: in its own memory, if the host has that."""
    return array if device.on_host else device.array(values.view(np.float32))


def _parts(size, period):
    return [slice(start, start + period) for start in range(0, size, period)]


def tables_at_distance(made_of, period, transfers, distance, white, flat, device) -> tuple:
    """Return tables for objects at a distance [m]: of the planes, and of white in the channels.

    white: weight of each wavelength in each channel, (C, L). flat: response to a flat field in focus, if every sample
    is a unit point source, shape (L,).
    """
    optics, pitch, aperture, displacement, q = made_of
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    bands = bands_of(made_of, period, device, distance)
    own = np.ones(len(q))
    if min(lens.aperture) != 1:
        own = exact_tables(lens, q, 1, 1, distance)[:, 0, 0]
    if np.abs(own / flat - 1).max() > EVEN:  # flat fields are as bright at every distance
        bands = integrate(bands, device.array(np.diag(flat / own)), device=device)
    cover = integrate(bands, device.array(white / flat), device=device)
    cover = device.reshape(cover, (len(white), 1, *bands.shape[1:]))
    return combine_bands(bands, transfers, device), cover


def tables_in_focus(made_of, period, weights, flat, device) -> tuple:
    """Return tables of white in the channels: see `LensTables.in_focus`.

    The lens only, without samples, is at each channel's mean wavelength: it blurs light that is smooth. No frequency
    is folded, as in tables for samples, whose copies add up.
    """
    white = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    flat = np.broadcast_to(flat, white.shape[1:])
    bands = bands_of(made_of, period, device)
    cover = integrate(bands, device.array((white / flat).astype(np.float32)), device=device)
    optics, pitch, *_, q = made_of
    lens = open_lens(optics, pitch)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        only = np.stack(list(pool.map(lambda mean: _lens_only(lens, mean, period), white @ q)))
    return (
        device.reshape(cover, (len(white), 1, *bands.shape[1:])),
        device.array(only[:, None].astype(np.float32)),
    )


def _lens_only(lens, q, period):
    """Transfer function of a lens in focus, a quarter if it is round, else a half: see `optics.blur`."""
    rows, cols = period
    down, across = np.fft.fftfreq(rows)[:, None], np.arange(cols // 2 + 1) / cols
    if lens.is_airy:
        s = np.minimum(np.hypot(down[: rows // 2 + 1], across) * q, 1)
        return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    # smooth along each direction, but not at 0
    radii, angles = np.linspace(0, 0.5**0.5, RADII), np.linspace(-np.pi / 2, np.pi / 2, ANGLES)
    at = np.multiply.outer([np.sin(angles), np.cos(angles)], radii / lens.pitch)
    found = lens.transfer(lens.nanometres(np.array([q])), *at.reshape(2, -1))
    polar = scipy.interpolate.RegularGridInterpolator((angles, radii), found.reshape(ANGLES, RADII))
    places = np.broadcast_arrays(np.arctan2(down, across), np.hypot(down, across))
    within = np.minimum(places[1], radii[-1])
    return np.ascontiguousarray(polar(np.stack([places[0], within], axis=-1))).view(np.float64)


def measure_kernel(optics, pixel_pitch, aperture, q, light) -> np.ndarray:
    """Return the kernel of a lens and its pixels for `processor.sharpen`. Arguments as for `fit_gaussian`."""
    tables = np.tensordot(light, _fine_tables(optics, pixel_pitch, aperture, q, 64), 1)
    f = np.fft.fftfreq(16, 1 / 16).astype(int)  # up to half a cycle per pixel
    down, across = f[:, None], np.abs(f)
    if len(tables) < 64:  # a quarter
        found = tables[np.abs(down), across]
    else:  # the spectrum of a real kernel
        found = np.where(f < 0, tables[-down, across].conj(), tables[down, across])
    return system_kernel(found / tables[0, 0].real)


def _fine_tables(optics, pixel_pitch, aperture, q, size):
    """Return transfer tables of `size` quarters of pixels, which exclude frequencies that a grid of pixels folds."""
    sides = tuple(4 * side for side in aperture)
    tables = transfer_tables(optics, pixel_pitch / 4, 4 * q, sides, size, size)
    if tables.shape[1] == size:  # halves, as pairs of real and imaginary parts
        tables = np.ascontiguousarray(tables).view(complex)
    return tables


def fit_gaussian(optics, pixel_pitch, aperture, q, light) -> float:
    """Return the deviation [pixel] of the Gaussian that equals a lens at 1/4 cycle per pixel.

    aperture: height and width [pixel]. light: weight of each wavelength, shape (L,).
    """
    tables = _fine_tables(optics, pixel_pitch, aperture, q, 32)
    passed = [
        light @ tables[:, i, j].real / (light @ tables[:, 0, 0].real) / np.sinc(side / 4)
        for (i, j), side in zip(((2, 0), (0, 2)), aperture, strict=True)
    ]
    return float(np.sqrt(-2 * np.log(np.clip(np.mean(passed), 1e-6, 1))) / (2 * np.pi / 4))
