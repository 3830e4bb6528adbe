"""Transfer tables of a lens at few frequencies, float64: what plans are decided by."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from gpusim.domain.optics import Optics
from gpusim.optics.lens import wavelength_nodes
from gpusim.optics.tables import transfer_tables


class Kept(Protocol):
    """What the planner's caller keeps between plans, such as `gpusim.pipeline.cache.Kept`."""

    def __call__(self, name: str, key: Any, make: Callable[[], Any]) -> Any:
        """What `make()` gave before under this name for an equal key, or gives now; key: all that `make` depends on."""


def made_anew(name: str, key: Any, make: Callable[[], Any]) -> Any:
    """What `make()` gives: of a caller who keeps nothing."""
    return make()


class Tables:
    """Transfer tables of a lens in front of pixels of `pitch` [m]."""

    def __init__(self, optics: Optics, pitch: float, kept: Kept):
        self._optics, self._pitch, self._kept = optics, pitch, kept

    def of(self, q, aperture, rows, cols, finer, displacement=(0.0, 0.0)) -> np.ndarray:
        """Tables at all frequencies of a period, see `gpusim.optics.tables.transfer_tables`.

        q: of the wavelengths, shape (L,). aperture: height and width [sample], or one number for a square. finer:
        samples per pixel. displacement: of the apertures from the samples [sample]. Where the lens is not the same at
        every angle those of a few wavelengths tell the others.
        """
        optics, pitch = self._optics, self._pitch / finer

        def made():
            nodes, between = (
                wavelength_nodes(q) if not optics.is_symmetric else (q, None)
            )  # q goes with the wavelength
            tables = transfer_tables(optics, pitch, nodes, aperture, rows, cols, displacement)
            return tables if between is None else np.tensordot(between, tables, 1)

        return self._kept(
            f"sampled {rows}x{cols} {finer:g}", (optics, pitch, q, aperture, displacement), made
        )

    def even(self, q, aperture, period, finer, displacement) -> np.ndarray:
        """The same of a square period: real quarters, or complex halves (L, period, period // 2 + 1)."""
        tables = self.of(q, aperture, period, period, finer, displacement)
        return (
            tables
            if tables.shape[-1] == period // 2 + 1
            else np.ascontiguousarray(tables).view(complex)
        )


def field_tables(lens, wavelengths, places, period: int) -> np.ndarray:
    """Transfer tables of a lens at places of the field, as `Response.of` takes them, of a square period."""
    chosen, between = wavelength_nodes(wavelengths)
    size = max(period - 1, lens.least_size)
    kernels = np.stack(
        [np.tensordot(between, lens.kernels(chosen, place, size), 1) for place in places], axis=1
    )
    return _transforms(kernels / kernels.sum(axis=(2, 3), keepdims=True), period, period)


def _transforms(kernels, rows, cols):
    """Half spectra of centred kernels (..., m, m) wrapped into a period."""
    whole = np.zeros((*kernels.shape[:-2], rows, cols))
    y, x = (
        (np.arange(n) - n // 2) % period
        for n, period in zip(kernels.shape[-2:], (rows, cols), strict=True)
    )
    np.add.at(whole, (..., y[:, None], x), kernels)
    return np.fft.rfft2(whole)
