"""The baseline of every ratio: a frame from a cube to digital numbers as a careful user of NumPy and SciPy writes it.

float32 throughout, as many workers as cores, transforms of the lengths that are fast, every band transformed once,
channels added up in the frequency domain, one inverse transform a channel, NumPy's own noise.
"""

import os

import numpy as np
import scipy.fft

from gpusim.domain.scene import Scene
from gpusim.simulator import Simulator


class Baseline:
    """What `gpusim` computes of a scene's cube without a tolerance, to within the rounding of float32."""

    def __init__(self, simulator: Simulator, scene: Scene):
        exact = Simulator(simulator.camera, device="numpy")
        self.plan, sensor = exact.plan(scene), simulator.camera.sensor
        tables = exact.imaging.tables.transfer(self.plan)[0]
        rows, cols = (n // 2 + 1 for n in self.plan.period)
        whole = np.concatenate([tables, tables[:, -2 + self.plan.period[0] % 2 : 0 : -1]], axis=1)
        self.tables = np.ascontiguousarray(whole[:, : self.plan.period[0], :cols], np.float32)
        assert tables.shape[1:] == (rows, cols)  # quarters
        self.gains = self.plan.gains.astype(np.float32)
        self.before = [(length - n) // 2 for length, n in zip(self.plan.period, scene.shape, strict=True)]
        self.cfa, self.sensor = sensor.cfa_indices, sensor
        y, x = (np.arange(n) - (n - 1) / 2 for n in scene.shape)
        falloff = 1 / (1 + self.plan.slope**2 * (y[:, None] ** 2 + x**2)) ** 2
        self.falloff = falloff.astype(np.float32)
        self.random = np.random.default_rng(1)

    def forward(self, plane) -> np.ndarray:
        """Spectrum of a plane of the period's shape, which may be written over."""
        return scipy.fft.rfft2(plane, workers=os.cpu_count(), overwrite_x=True)

    def inverse(self, spectra) -> np.ndarray:
        """Planes of spectra (C, rows, cols // 2 + 1), which may be written over."""
        return scipy.fft.irfft2(spectra, self.plan.period, workers=os.cpu_count(), overwrite_x=True)

    def mean(self, cube, seconds: float) -> np.ndarray:
        """Mean electrons (rows, cols) float32 of a cube (L, rows, cols) float32."""
        rows, cols = cube.shape[1:]
        pads = [(before, length - n - before) for before, length, n in zip(
            self.before, self.plan.period, (rows, cols), strict=True)]
        sums = np.zeros((len(self.gains), self.plan.period[0], self.plan.period[1] // 2 + 1), np.complex64)
        for band, table, gains in zip(cube, self.tables, self.gains.T, strict=True):
            spectrum = self.forward(np.pad(band, pads, mode="edge"))
            spectrum *= table
            for one, gain in zip(sums, gains, strict=True):
                one += gain * spectrum
        channels = self.inverse(sums)
        top, left = self.before
        channels = channels[:, top : top + rows, left : left + cols]
        mosaic = np.empty((rows, cols), np.float32)
        for (dy, dx), channel in np.ndenumerate(self.cfa):
            period_y, period_x = self.cfa.shape
            mosaic[dy::period_y, dx::period_x] = channels[channel, dy::period_y, dx::period_x]
        return np.maximum(mosaic, 0) * (self.falloff * np.float32(seconds))

    def raw(self, cube, seconds: float) -> np.ndarray:
        """Digital numbers (rows, cols) uint16 of a cube."""
        sensor = self.sensor
        electrons = np.minimum(self.random.poisson(self.mean(cube, seconds)), sensor.full_well).astype(np.float32)
        electrons += np.float32(sensor.read_sigma) * self.random.standard_normal(electrons.shape, np.float32)
        values = electrons * np.float32(sensor.gain_dn_per_electron) + np.float32(sensor.dark_level)
        return np.rint(np.clip(values, 0, sensor.white_level)).astype(np.uint16)
