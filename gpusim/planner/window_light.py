"""The light in windows of a scene: transforms of its sums over wavelength, plain and as a lens shows it.

A device computes them where it has the samples. The host then reads a few sums in place of all wavelengths.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy

from gpusim.optics.fusion import SAMPLED_PERIOD

# of a window, and of its rim on each side, which does not count [sample]
SIDE = SAMPLED_PERIOD
RIM = 12
INNER = SIDE - 2 * RIM


class Taken(Protocol):
    """Windows of a content's samples on a device, see `gpusim.pipeline.reading.TakenOnDevice`."""

    def sum(self, weights) -> np.ndarray:
        """Sums over wavelength by `weights` (P, L): float32 (n, P, SIDE, SIDE), in host memory."""

    def blur(self, tables, mix) -> np.ndarray:
        """Sums by `mix` (C, L) of the wavelengths behind transfer functions: float32 (n, C, SIDE, SIDE), likewise.

        tables: (L, SIDE, SIDE // 2 + 1).
        """


class Light:
    """The light of windows, by wavelength.

    Args:
        spectra: Transforms of the wavelengths less their means in each window, complex64 (n, L, SIDE, SIDE // 2 + 1).
        means: The means over the windows' inner parts, (n, L).
    """

    def __init__(self, spectra: np.ndarray, means: np.ndarray):
        self._spectra, self._means = spectra, means

    @property
    def spectra(self) -> np.ndarray:
        """Transforms of the wavelengths less their means, complex64 (n, L, SIDE, SIDE // 2 + 1)."""
        return self._spectra

    @property
    def means(self) -> np.ndarray:
        """Means of the wavelengths over the windows' inner parts, (n, L)."""
        return self._means

    @classmethod
    def of(cls, planes: np.ndarray, entries: np.ndarray | None = None) -> "Light":
        """Return the light of planes in host memory, float32 (n, planes, SIDE, SIDE), which are written to.

        entries: spectra of which samples are mixed, if the planes are their amounts, (planes, L).
        """
        means = inner_means(planes)
        count, number = planes.shape[:2]
        spectra = np.empty(
            (count, number if entries is None else entries.shape[1], SIDE, SIDE // 2 + 1),
            np.complex64,
        )
        planes -= means[..., None, None]
        for n in range(count):  # each fits into a cache
            found = scipy.fft.rfft2(planes[n : n + 1])
            spectra[n] = (found if entries is None else mix(entries.T, found))[0]
        return cls(spectra, (means if entries is None else means @ entries).astype(np.float64))

    def sum(self, weights) -> tuple[np.ndarray, np.ndarray]:
        """Return transforms of sums by `weights` (P, L) less their means, and the means (n, P)."""
        return mix(weights, self.spectra), self.average(weights)

    def average(self, weights) -> np.ndarray:
        """Return the means of `sum` alone."""
        return self.means @ weights.T

    def blur(self, tables, weights) -> np.ndarray:
        """Return the transforms of sums by `weights` (C, L) of the wavelengths behind transfer functions.

        tables: (L, SIDE, SIDE // 2 + 1). The response to the means is left out.
        """
        tables = tables.astype(np.complex64 if np.iscomplexobj(tables) else np.float32)
        weights = weights.astype(np.float32)
        found = np.empty((len(self.spectra), len(weights), *tables.shape[1:]), np.complex64)
        behind = np.empty(self.spectra.shape[1:], np.complex64)
        for own, window in zip(found, self.spectra, strict=True):
            np.multiply(window, tables, out=behind)
            own[:] = mix(weights, behind[None])[0]
        return found

    def times(self, factor) -> "Light":
        """Return the light with its waves weakened by a factor (SIDE, SIDE // 2 + 1)."""
        return Light((self.spectra * factor).astype(np.complex64), self.means)


class LightOnDevice(Light):
    """The same of windows on a device. Wavelengths are read only if they are asked for.

    Args:
        taken: The windows.
        read: Returns their light by wavelength.
    """

    def __init__(self, taken: Taken, read: Callable[[], Light]):
        self._taken, self._read = taken, read
        # by weights, as the device has them
        self._sums: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._averages: dict[bytes, np.ndarray] = {}

    @cached_property
    def _whole(self):
        return self._read()

    @property
    def spectra(self) -> np.ndarray:
        """See `Light`."""
        return self._whole.spectra

    @property
    def means(self) -> np.ndarray:
        """See `Light`."""
        return self._whole.means

    def sum(self, weights) -> tuple[np.ndarray, np.ndarray]:
        """See `Light`."""
        key = np.asarray(weights, np.float32).tobytes()
        if key not in self._sums:
            planes = self._taken.sum(weights)
            means = inner_means(planes)
            spectra = scipy.fft.rfft2(planes - means[..., None, None])
            self._averages[key] = means.astype(np.float64)
            self._sums[key] = spectra, self._averages[key]
        return self._sums[key]

    def average(self, weights) -> np.ndarray:
        """See `Light`."""
        key = np.asarray(weights, np.float32).tobytes()
        if key not in self._averages:
            self._averages[key] = inner_means(self._taken.sum(weights)).astype(np.float64)
        return self._averages[key]

    def blur(self, tables, weights) -> np.ndarray:
        """See `Light`."""
        flat = self.average(weights * np.real(tables[:, 0, 0]))
        seen = self._taken.blur(tables, weights)
        return scipy.fft.rfft2(seen - flat.astype(np.float32)[..., None, None])


def inner_means(planes) -> np.ndarray:
    """Return the means over the inner parts of windows, (n, planes)."""
    return planes[:, :, RIM:-RIM, RIM:-RIM].mean(axis=(2, 3))


def mix(weights, spectra) -> np.ndarray:
    """Return sums of planes' transforms, complex64 (n, planes, SIDE, SIDE // 2 + 1), by real weights (sums, planes)."""
    numbers = spectra.reshape(*spectra.shape[:2], -1).view(np.float32)
    return (
        (weights.astype(np.float32) @ numbers)
        .view(np.complex64)
        .reshape(len(spectra), -1, *spectra.shape[2:])
    )
