"""Surfaces in light that varies over the scene, the two kept apart: Farrell & Wandell, Figure 4."""

from dataclasses import dataclass
from math import prod
from typing import ClassVar

import numpy as np

from gpusim.domain.content import Basis, Content, is_seen
from gpusim.domain.errors import BadData


@dataclass(frozen=True, eq=False, repr=False)
class Illuminated(Content):
    """Surfaces in several lights: pixel spectrum = sum_k maps[k] lights[k] sum_j coefficients[j] basis[j].

    maps (K, rows, cols) float32: how strong each light is at each sample. coefficients (J, rows, cols) float32 or
    float16 and basis (J, L): the surfaces, as of a Basis. lights (K, L): spectra relative to the scene's illuminant.
    Its entries are all pairs of a light and a surface, light by light: a device makes and keeps K J planes.
    """

    maps: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray
    lights: np.ndarray
    form: ClassVar[str] = "illuminated"
    samples: ClassVar[tuple[str, ...]] = ("maps", "coefficients")
    shared: ClassVar[tuple[str, ...]] = ("basis", "lights")

    @property
    def surfaces(self):
        return Basis(self.wavelengths, self.coefficients, self.basis)

    @property
    def planes(self):
        products = np.asarray(self.maps, np.float32)[:, None] * self.coefficients
        return products.reshape(len(self.maps) * len(self.coefficients), *products.shape[2:])

    @property
    def shape(self):
        rows, cols = self.coefficients.shape[-2:]
        return rows, cols

    @property
    def entry_spectra(self):
        products = np.asarray(self.lights, np.float64)[:, None] * np.asarray(self.basis, np.float64)
        return products.reshape(-1, len(self.wavelengths))

    @property
    def nbytes(self):
        return super().nbytes + 4 * len(self.lights) * prod(
            self.coefficients.shape
        )  # and the products

    def stored_type(self, name):
        return super().stored_type(name) if name == "coefficients" else np.dtype(np.float32)

    def with_planes(self, planes):
        return Basis(self.wavelengths, planes, self.entry_spectra)

    def mixed(self, rates, rows=slice(None)):
        return self._sum(rates, (rows,))

    def weighted(self, weights, window=(slice(None), slice(None))):
        return self._sum(weights @ self.entry_spectra.T, window)

    def brightness(self, total):
        return self._sum((self.entry_spectra @ total).astype(np.float32)[None], ())[0]

    def points(self, rows, cols):
        spectra = self.take(rows, cols).planes.T.astype(np.float64) @ self.entry_spectra
        return spectra, np.arange(len(rows)), np.ones(len(rows))

    def _sum(self, rates, window):
        """What samples give where one unit of each entry gives `rates` (C, entries), light by light."""
        coefficients = self.coefficients[:, *window].astype(rates.dtype, copy=False)
        return sum(
            light[window] * np.tensordot(rate, coefficients, 1)
            for light, rate in zip(self.maps, np.split(rates, len(self.maps), axis=1), strict=True)
        )

    def check(self, name):
        self._check_arrays(name)
        self.surfaces.check(name)
        if not np.isfinite(
            self.lights
        ).all():  # splines of lines undershoot a little: they may be negative
            raise BadData(f"{name}: NaN or infinite lights")
        if is_seen(self.maps) and not (np.isfinite(self.maps).all() and self.maps.min() >= 0):
            raise BadData(
                f"{name}: maps from {self.maps.min():.3g} to {self.maps.max():.3g}, wanted finite light, not "
                "negative"
            )

    def _check_arrays(self, name):
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


def surfaces_of(content: Content) -> Basis:
    """The same surfaces as a Basis: of a cube its wavelengths, of materials as few spectra as span theirs.

    Raises BadData where samples that are elsewhere cannot be read.
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
    return Basis(content.wavelengths, content.mixed(table.T), right[:rank])


def spline(wavelengths, values, others) -> np.ndarray:
    """Values (N, L) at wavelengths [nm], at others, by the spline that spectra of surfaces are integrated with."""
    from scipy.interpolate import CubicSpline

    ends = "not-a-knot" if len(wavelengths) > 3 else "natural"
    return CubicSpline(wavelengths, values, axis=1, bc_type=ends)(others)
