"""Baseline of every ratio: careful NumPy and SciPy code in float32, with one worker per core.

`Baseline` computes a frame from a cube to digital numbers. It uses transforms of fast lengths, one
transform per band, a sum over bands in the frequency domain, one inverse transform per channel, and
NumPy's noise. The functions are single steps.
"""

import os

import numpy as np
import scipy.fft
from scipy.signal import fftconvolve

from gpusim.domain.scene import Scene
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Blur


class Baseline:
    """The frame that `gpusim` computes from a cube without a tolerance, to float32 rounding."""

    def __init__(self, simulator: Simulator, scene: Scene):
        exact = Simulator(simulator.camera, device="numpy")
        self.plan, sensor = exact.plan(scene), simulator.camera.sensor
        tables = exact.imaging.tables.transfer(self.plan)[0]
        rows, cols = (n // 2 + 1 for n in self.plan.period)
        whole = np.concatenate([tables, tables[:, -2 + self.plan.period[0] % 2 : 0 : -1]], axis=1)
        self.tables = np.ascontiguousarray(whole[:, : self.plan.period[0], :cols], np.float32)
        assert tables.shape[1:] == (rows, cols)  # quarters
        blur = self.plan.find(Blur)
        assert blur is not None  # the camera has a lens
        self.mix = blur.mix.astype(np.float32)
        self.before = [
            (length - n) // 2 for length, n in zip(self.plan.period, scene.shape, strict=True)
        ]
        self.cfa, self.sensor = sensor.cfa_indices, sensor
        y, x = (np.arange(n) - (n - 1) / 2 for n in scene.shape)
        falloff = 1 / (1 + self.plan.slope**2 * (y[:, None] ** 2 + x**2)) ** 2
        self.falloff = falloff.astype(np.float32)
        self.random = np.random.default_rng(1)

    def forward(self, plane) -> np.ndarray:
        """Return the spectrum of a plane with the period's shape. It may overwrite the plane."""
        return scipy.fft.rfft2(plane, workers=os.cpu_count(), overwrite_x=True)

    def inverse(self, spectra) -> np.ndarray:
        """Return the planes of spectra (C, rows, cols // 2 + 1). It may overwrite the spectra."""
        return scipy.fft.irfft2(spectra, self.plan.period, workers=os.cpu_count(), overwrite_x=True)

    def mean(self, cube, seconds: float) -> np.ndarray:
        """Return mean electrons (rows, cols) float32 of a cube (L, rows, cols) float32."""
        rows, cols = cube.shape[1:]
        pads = [
            (before, length - n - before)
            for before, length, n in zip(self.before, self.plan.period, (rows, cols), strict=True)
        ]
        sums = np.zeros(
            (len(self.mix), self.plan.period[0], self.plan.period[1] // 2 + 1), np.complex64
        )
        for band, table, weights in zip(cube, self.tables, self.mix.T, strict=True):
            spectrum = self.forward(np.pad(band, pads, mode="edge"))
            spectrum *= table
            for one, weight in zip(sums, weights, strict=True):
                one += weight * spectrum
        channels = self.inverse(sums)
        top, left = self.before
        channels = channels[:, top : top + rows, left : left + cols]
        mosaic = np.empty((rows, cols), np.float32)
        for (dy, dx), channel in np.ndenumerate(self.cfa):
            period_y, period_x = self.cfa.shape
            mosaic[dy::period_y, dx::period_x] = channels[channel, dy::period_y, dx::period_x]
        return np.maximum(mosaic, 0) * (self.falloff * np.float32(seconds))

    def raw(self, cube, seconds: float) -> np.ndarray:
        """Return digital numbers (rows, cols) uint16 of a cube."""
        sensor = self.sensor
        electrons = np.minimum(
            self.random.poisson(self.mean(cube, seconds)), sensor.full_well
        ).astype(np.float32)
        electrons += np.float32(sensor.read_sigma) * self.random.standard_normal(
            electrons.shape, np.float32
        )
        values = electrons * np.float32(sensor.gain_dn_per_electron) + np.float32(sensor.dark_level)
        return np.rint(np.clip(values, 0, sensor.white_level)).astype(np.uint16)


def noise(random: np.random.Generator, mean, read: float) -> np.ndarray:
    """Return electrons (rows, cols) with photon noise and Gaussian read noise [e-]."""
    return random.poisson(mean) + random.normal(0.0, read, mean.shape)


def bilinear(raw, scale: float) -> np.ndarray:
    """Return RGB (3, rows, cols) float32 of an RGGB mosaic (rows, cols). scale: of its values."""
    rows, cols = raw.shape
    p = np.pad(raw.astype(np.float32), 1, mode="reflect")
    p *= np.float32(scale)
    here, cross = (
        p[1:-1, 1:-1],
        (p[:-2, 1:-1] + p[2:, 1:-1] + p[1:-1, :-2] + p[1:-1, 2:]) * np.float32(0.25),
    )
    diagonal = (p[:-2, :-2] + p[:-2, 2:] + p[2:, :-2] + p[2:, 2:]) * np.float32(0.25)
    across, along = (
        (p[1:-1, :-2] + p[1:-1, 2:]) * np.float32(0.5),
        (p[:-2, 1:-1] + p[2:, 1:-1]) * np.float32(0.5),
    )
    out = np.empty((3, rows, cols), np.float32)
    for (dy, dx), planes in {
        (0, 0): (here, cross, diagonal),
        (0, 1): (across, here, along),
        (1, 0): (along, here, across),
        (1, 1): (diagonal, cross, here),
    }.items():
        for target, source in zip(out, planes, strict=True):
            target[dy::2, dx::2] = source[dy::2, dx::2]
    return out


def overlap_add(plane, blur, dtype=np.float32) -> np.ndarray:
    """Blur a plane by the kernels of `gpusim.optics.field`, each on its window, and add them up."""
    half, grid = blur.kernels.shape[-1] // 2, [len(edge) for edge in blur.edges]
    edges = [np.clip(edge, 0, n) for edge, n in zip(blur.edges, plane.shape, strict=True)]
    weights, kernels = blur.coefficients.astype(dtype), blur.kernels.astype(dtype)
    out = np.zeros((plane.shape[0] + 2 * half, plane.shape[1] + 2 * half), dtype)
    for number, (i, j) in enumerate(np.ndindex(*grid)):
        y0, x0 = edges[0][max(i - 1, 0)], edges[1][max(j - 1, 0)]
        y1, x1 = (edge[min(n + 1, len(edge) - 1)] for edge, n in zip(edges, (i, j), strict=True))
        window = np.zeros((y1 - y0, x1 - x0), dtype)
        for term in range(4):
            a, b = i - term // 2, j - term % 2
            if 0 <= a < grid[0] - 1 and 0 <= b < grid[1] - 1:
                cell = np.s_[edges[0][a] : edges[0][a + 1], edges[1][b] : edges[1][b + 1]]
                window[
                    cell[0].start - y0 : cell[0].stop - y0, cell[1].start - x0 : cell[1].stop - x0
                ] = weights[term][cell] * plane[cell]
        out[y0 : y1 + 2 * half, x0 : x1 + 2 * half] += fftconvolve(window, kernels[number, 0])
    return out[half:-half, half:-half]
