"""Tabulated functions of wavelength."""

import functools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, check_known
from gpusim.domain.short_repr import shorten_repr, span

PLANCK = 6.62607015e-34  # [J s], exact (SI 2019)
LIGHT_SPEED = 299792458.0  # [m s-1], exact
BOLTZMANN = 1.380649e-23  # [J K-1], exact (SI 2019)
LINE = 1.0  # [nm] bandwidth of a scene with a single wavelength
SHORTEST, LONGEST = 10.0, 1e5  # [nm] range of light: extreme ultraviolet to far infrared
# [nm] A wider gap between entries gets entries of STEP when photons and energy are converted. Up to
# it, the luminances of a table's photons and of its energy agree to 0.05 %, lamps with lines included.
COARSE, STEP = 10.0, 1.0

# Quantities of spectra, and their units
PHOTONS, ENERGY = "photon radiance", "energy radiance"
RELATIVE, SHARE = "relative power", "share"
UNITS = {
    "": "",
    PHOTONS: "photon s-1 m-2 sr-1 nm-1",
    ENERGY: "W m-2 sr-1 nm-1",
    RELATIVE: "W nm-1, up to a factor",
    SHARE: "1",
}


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One or more functions of wavelength in one table, linear between its entries.

    `np.asarray` returns the values.

    Args:
        wavelengths: Wavelengths [nm], strictly increasing, shape (L,), L >= 2.
        values: One function, shape (L,), or N functions, shape (N, L), in any unit.
        name: Name in messages and reports.
        quantity: One of UNITS: "photon radiance", "energy radiance", "relative power" (of a light,
            as from `illuminant`) or "share" (reflectance, transmission, efficiency); "" is not
            checked.

    Raises:
        UnknownName: The quantity is not known.
        BadData: Wavelengths are not sorted or outside the range of light, shapes do not match, or
            values are not finite.
    """

    wavelengths: np.ndarray
    values: np.ndarray
    name: str = ""
    quantity: str = field(default="", metadata={"digest": False})  # changes no value

    def __post_init__(self):
        check_known("quantity of a spectrum", self.quantity, UNITS)
        wavelengths = np.ascontiguousarray(self.wavelengths, np.float64)
        values = np.ascontiguousarray(self.values, np.float64)
        label = self.name or "spectrum"
        check_wavelengths(wavelengths, label, 2)
        if values.ndim not in (1, 2) or values.shape[-1] != len(wavelengths):
            raise BadData(
                f"{label}: values of shape {values.shape} do not match {len(wavelengths)} wavelengths"
            )
        if not np.isfinite(values).all():
            raise BadData(f"{label}: NaN or infinite entries")
        object.__setattr__(self, "wavelengths", wavelengths)
        object.__setattr__(self, "values", values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype, copy=copy)

    def __repr__(self):
        name, curves = f"{self.name!r}, " if self.name else "", len(np.atleast_2d(self.values))
        return shorten_repr(
            f"Spectrum({name}{f'{curves} curves, ' if curves > 1 else ''}{span(self.wavelengths)}, "
            f"values {self.values.min():.4g} .. {self.values.max():.4g})"
        )

    def at(self, wavelengths: ArrayLike, outside: float | None = 0.0) -> np.ndarray:
        """Interpolate the values.

        Args:
            wavelengths: Wavelengths [nm], shape (M,).
            outside: Value beyond the ends of the table; None: the end values continue.

        Returns:
            Values, shape (..., M).
        """
        edge = {} if outside is None else {"left": outside, "right": outside}
        nodes = np.asarray(wavelengths, np.float64)
        rows = [
            np.interp(nodes, self.wavelengths, row, **edge) for row in np.atleast_2d(self.values)
        ]
        return rows[0] if self.values.ndim == 1 else np.stack(rows)

    @property
    def unit(self) -> str:
        """Unit of the values, "" if the quantity is not known."""
        return UNITS[self.quantity]

    def scale(self, factor: float) -> "Spectrum":
        """Return the spectrum times a factor.

        Args:
            factor: Factor on the values [1].

        Returns:
            The new spectrum.
        """
        return replace(self, values=self.values * factor)


def check_quantity(label: str, value: Any):
    """Raise BadData if a spectrum that should be of shares, such as a transmission, says another quantity."""
    if isinstance(value, Spectrum) and value.quantity not in ("", SHARE):
        raise BadData(
            f"{label}: {value.name or 'a Spectrum'} is {value.quantity}, wanted shares 0 .. 1"
        )


def values_of(value: Spectrum | float) -> np.ndarray:
    """Return the values of a number or a Spectrum as an array."""
    return np.asarray(value, np.float64)


def tabulate(value: Spectrum | float, wavelengths: ArrayLike) -> np.ndarray:
    """Return a number or one function at wavelengths [nm], shape (L,); its end values continue."""
    if isinstance(value, Spectrum):
        return value.at(wavelengths, outside=None)
    return np.full(np.shape(wavelengths), float(value))


def is_increasing(values: np.ndarray) -> bool:
    """Return True if the values have one axis, are finite and increase strictly."""
    return values.ndim == 1 and bool(np.isfinite(values).all() and (np.diff(values) > 0).all())


def check_wavelengths(wavelengths, label: str, least: int = 1):
    """Raise BadData unless wavelengths (L,) are light, increase, and number at least `least`."""
    if wavelengths.ndim != 1 or len(wavelengths) < least:
        raise BadData(
            f"{label}: needs at least {least} wavelength{'s' if least > 1 else ''}, got shape "
            f"{wavelengths.shape}"
        )
    fault = _fault_of(wavelengths.tobytes(), wavelengths.dtype.str)
    if fault:
        raise BadData(f"{label}: {fault}")


@functools.lru_cache(maxsize=256)  # scenes of a stream have the same
def _fault_of(values: bytes, kind: str) -> str:
    """Return what is wrong with wavelengths, or ""."""
    wavelengths = np.frombuffer(values, kind)
    if not np.isfinite(wavelengths).all():
        return "NaN or infinite entries"
    if not (wavelengths[0] >= SHORTEST and wavelengths[-1] <= LONGEST):
        return (
            f"wavelengths {wavelengths[0]:g} .. {wavelengths[-1]:g} nm, allowed are "
            f"{SHORTEST:g} .. {LONGEST:g} nm"
        )
    if not (np.diff(wavelengths) > 0).all():
        return f"wavelengths must increase strictly, got {wavelengths[:4]} ... [nm]"
    return ""


def seen_band(wavelengths) -> tuple[float, float]:
    """Return the first and last wavelength of a scene [nm]; a single one has the width LINE."""
    first, last = float(wavelengths[0]), float(wavelengths[-1])
    return (first, last) if first < last else (first - LINE / 2, last + LINE / 2)


def energy_per_photon(wavelengths):
    """Return the energy of a photon [J] at these wavelengths [nm]."""
    return PLANCK * LIGHT_SPEED / (wavelengths * 1e-9)


def photons_from_energy(spectrum: Spectrum) -> Spectrum:
    """Convert energy [W ... nm-1] to photons [photon s-1 ... nm-1]: divide by h c / lambda.

    A spectrum is linear between its entries, and so is the result: gaps wider than COARSE get
    entries. Raises BadData if the quantity is no energy.
    """
    return _convert(spectrum, PHOTONS, {ENERGY: PHOTONS, RELATIVE: ""})


def energy_from_photons(spectrum: Spectrum) -> Spectrum:
    """Convert photons [photon s-1 ... nm-1] to energy [W ... nm-1]: multiply by h c / lambda.

    See `photons_from_energy`. Raises BadData if the quantity is no number of photons.
    """
    return _convert(spectrum, ENERGY, {PHOTONS: ENERGY})


def _convert(spectrum, to, quantities):
    """Return a spectrum as photons or energy; quantities: that it may have, and what they become."""
    own = spectrum.quantity
    if own and own not in quantities:
        raise BadData(
            f"{spectrum.name or 'spectrum'}: {own}, wanted {' or '.join(quantities)} to convert to {to}"
        )
    nodes = spectrum.wavelengths
    if np.diff(nodes).max() > COARSE:
        nodes = np.unique(np.concatenate([nodes, *map(_fill, nodes[:-1], nodes[1:])]))
    per_photon = energy_per_photon(nodes)
    values = spectrum.at(nodes) if nodes is not spectrum.wavelengths else spectrum.values
    values = values / per_photon if to == PHOTONS else values * per_photon
    return Spectrum(nodes, values, spectrum.name, quantities.get(own, ""))


def _fill(first, last):
    """Return the entries that a gap between two wavelengths [nm] gets."""
    if last - first <= COARSE:
        return np.empty(0)
    return np.linspace(first, last, int(np.ceil((last - first) / STEP)) + 1)[1:-1]
