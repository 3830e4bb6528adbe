"""Surfaces in light that varies over the scene, stored separately: Farrell & Wandell, Figure 4."""

from dataclasses import dataclass
from math import prod
from typing import Any, ClassVar

import numpy as np

from gpusim.domain.content import Basis, Content, check_not_negative, is_seen
from gpusim.domain.errors import BadData
from gpusim.domain.interpolation import is_regular


@dataclass(frozen=True, eq=False, repr=False)
class Illuminated(Content):
    """Surfaces in several lights, each with a map of its strength.

    Spectrum of a pixel = sum_k maps[k] lights[k] sum_j coefficients[j] basis[j]. The entries are
    all pairs of a light and a surface, light by light. A device computes and stores K J planes.

    Args:
        wavelengths: Wavelengths [nm], shape (L,).
        maps: Strength of each light at each sample, float32, shape (K, rows, cols).
        coefficients: Weights of the surface basis, float32 or float16, shape (J, rows, cols).
        basis: Reflectance basis, shape (J, L).
        lights: Spectra relative to the illuminant of the scene, shape (K, L).
    """

    maps: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray
    lights: np.ndarray
    form: ClassVar[str] = "illuminated"
    samples: ClassVar[tuple[str, ...]] = ("maps", "coefficients")
    shared: ClassVar[tuple[str, ...]] = ("basis", "lights")

    @property
    def surfaces(self) -> Basis:
        """The surfaces without the light."""
        return Basis(self.wavelengths, self.coefficients, self.basis)

    @property
    def planes(self) -> np.ndarray:
        """Products of maps and coefficients, shape (K J, rows, cols)."""
        products = np.asarray(self.maps, np.float32)[:, None] * self.coefficients
        return products.reshape(len(self.maps) * len(self.coefficients), *products.shape[2:])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.coefficients.shape[-2:]
        return rows, cols

    @property
    def entry_spectra(self) -> np.ndarray:
        """Products of light and basis spectra, float64, shape (K J, L)."""
        products = np.asarray(self.lights, np.float64)[:, None] * np.asarray(self.basis, np.float64)
        return products.reshape(-1, len(self.wavelengths))

    @property
    def nbytes(self) -> int:
        """Memory of the samples and their products on a device [byte]."""
        return super().nbytes + 4 * len(self.lights) * prod(self.coefficients.shape)

    def stored_type(self, name: str) -> np.dtype:
        return super().stored_type(name) if name == "coefficients" else np.dtype(np.float32)

    def with_planes(self, planes: Any) -> Basis:
        return Basis(self.wavelengths, planes, self.entry_spectra)

    def mix(self, rates: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
        return self._sum(rates, (rows,))

    def weigh(
        self, weights: np.ndarray, window: tuple[slice, slice] = (slice(None), slice(None))
    ) -> np.ndarray:
        return self._sum(weights @ self.entry_spectra.T, window)

    def brightness(self, total: np.ndarray) -> np.ndarray:
        return self._sum((self.entry_spectra @ total).astype(np.float32)[None], ())[0]

    def _sum(self, rates, window):
        """Return channel values of the samples, summed over lights.

        rates: response to one unit of each entry, shape (C, entries).
        """
        coefficients = self.coefficients[:, *window].astype(rates.dtype, copy=False)
        return sum(
            light[window] * np.tensordot(rate, coefficients, 1)
            for light, rate in zip(self.maps, np.split(rates, len(self.maps), axis=1), strict=True)
        )

    def check(self, name: str) -> None:
        shape, count = tuple(self.coefficients.shape), len(self.lights)
        if tuple(self.maps.shape) != (count, *shape[1:]) or not count:
            raise BadData(
                f"{name}: maps {tuple(self.maps.shape)}, wanted one (rows, cols) of {shape[1:]} for each of "
                f"{count} lights"
            )
        if self.lights.shape != (count, len(self.wavelengths)):
            raise BadData(
                f"{name}: lights {self.lights.shape} do not match {len(self.wavelengths)} wavelengths"
            )
        self.surfaces.check(name)
        # splines of spectral lines undershoot slightly: negative values are accepted
        if not np.isfinite(self.lights).all():
            raise BadData(f"{name}: NaN or infinite lights")
        if is_seen(self.maps):
            check_not_negative(f"{name}: maps", self.maps, "light")


def surfaces_of(content: Content) -> Basis:
    """Return the surfaces of any content as a Basis.

    For a cube the basis is its wavelengths; for materials it is the smallest basis that spans them.

    Args:
        content: Content of any form.

    Returns:
        The surfaces.

    Raises:
        BadData: Samples in other memory cannot be read.
    """
    content = content.on_host()
    if isinstance(content, Illuminated):
        return content.surfaces
    if isinstance(content, Basis):
        return content
    if content.labels is None:
        return Basis(content.wavelengths, content.planes, content.entry_spectra)
    left, values, right = np.linalg.svd(content.entry_spectra, full_matrices=False)
    rank = max(int((values > len(left) * np.finfo(float).eps * values[:1].max(initial=0)).sum()), 1)
    table = (left[:, :rank] * values[:rank]).astype(np.float32)
    return Basis(content.wavelengths, content.mix(table.T), right[:rank])


def spline(wavelengths, values, others) -> np.ndarray:
    """Interpolate with the spline that also integrates spectra of surfaces.

    Args:
        wavelengths: Nodes [nm], shape (L,).
        values: Values at the nodes, shape (N, L).
        others: Wavelengths to interpolate at [nm], shape (M,).

    Returns:
        Interpolated values, shape (N, M).
    """
    from scipy.interpolate import CubicSpline

    if not is_regular(wavelengths):
        return np.stack([np.interp(others, wavelengths, row) for row in values])
    ends = "not-a-knot" if len(wavelengths) > 3 else "natural"
    return CubicSpline(wavelengths, values, axis=1, bc_type=ends)(others)
