"""Illuminants by name, and the radiance of white in them."""

import dataclasses
import re
from numbers import Real
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from gpusim.data.colorimetry import tables, xyz
from gpusim.domain.above import call_above
from gpusim.domain.errors import BadData, OutOfRange, UnknownName, one_line
from gpusim.domain.spectrum import (
    BOLTZMANN,
    ENERGY,
    LIGHT_SPEED,
    PHOTONS,
    PLANCK,
    RELATIVE,
    Spectrum,
    energy_from_photons,
    photons_from_energy,
)

BRIGHTEST = 1e12  # [cd m-2]; the sun has 1.6e9
FILES = (".csv", ".spdx", ".xml")  # ends of names of lamps' files
TEMPERATURE = re.compile(r"(daylight|blackbody)-(\d+(?:\.\d+)?)k")


def illuminant(name: str | PathLike[str], wavelengths: ArrayLike | None = None) -> Spectrum:
    """Return the relative spectral power of a light [W nm-1, up to a factor].

    CIE illuminants have the published scale, the others are 100 at 560 nm. A CIE illuminant is zero
    outside its table; a blackbody has no limits.

    Args:
        name: A lamp's file, .csv, .spdx or .xml (IES TM-27); or a CIE illuminant ("A", "C", "D65",
            "E", "FL2", "FL3.15", "HP1", "LED-B1", "ID65", ...), CIE daylight of a temperature
            ("daylight-5000K", 4000 .. 25000 K) or a blackbody ("blackbody-3200K"); upper or lower
            case.
        wavelengths: Wavelengths [nm], or None for its own table (CIE: 5 nm steps; daylight: 300 ..
            830 nm in 5 nm steps; blackbody: 300 .. 1100 nm in 1 nm steps).

    Returns:
        The spectrum.

    Raises:
        BadFile: The file is no lamp's.
        OutOfRange: The temperature is outside its range.
        UnknownName: The name is not known.
    """
    if not isinstance(name, str | PathLike):
        raise UnknownName("light", one_line(name), illuminant_names())
    if isinstance(name, PathLike) or name.lower().endswith(FILES):
        light: Spectrum = call_above("io.lamps.read_lamp", name)
        return light if wavelengths is None else _at(light, wavelengths)
    match = TEMPERATURE.fullmatch(name.lower())
    if match and match[1] == "blackbody":
        return blackbody(
            float(match[2]), np.arange(300.0, 1101.0) if wavelengths is None else wavelengths
        )
    light = daylight(float(match[2])) if match else _cie_illuminant(name)
    if wavelengths is None:
        return light
    return _at(light, wavelengths)


def _at(light, wavelengths):
    nodes = np.asarray(wavelengths, np.float64)
    return Spectrum(nodes, light.at(nodes), light.name, RELATIVE)


def light_of(light: str | PathLike[str] | Spectrum) -> Spectrum:
    """Return the relative power [W nm-1, up to a factor] of a light.

    Args:
        light: Name or file of an illuminant, or a Spectrum: of relative power, of energy, or of photons,
            which are converted if its quantity says so.

    Returns:
        The spectrum.

    Raises:
        BadData: The value is neither, has several functions, or is no light.
        UnknownName: The name is not known.
    """
    if isinstance(light, str | PathLike):
        return illuminant(light)
    if not isinstance(light, Spectrum) or light.values.ndim != 1:
        raise BadData(
            f"light of {type(light).__name__}: wanted a name, or a Spectrum of one function"
        )
    if light.quantity not in ("", RELATIVE, ENERGY, PHOTONS):
        raise BadData(
            f"light {light.name}: a Spectrum of quantity {light.quantity!r}, wanted a light's"
        )
    return energy_from_photons(light) if light.quantity == PHOTONS else light


def illuminant_names() -> list[str]:
    """Return the names that `illuminant` knows, temperatures as a pattern."""
    return [*tables("cie")["illuminant_names"].tolist(), "daylight-<T>K", "blackbody-<T>K"]


def _cie_illuminant(name):
    table = tables("cie")
    folded = [known.lower() for known in table["illuminant_names"].tolist()]
    if name.lower() not in folded:
        raise UnknownName("light", name, illuminant_names())
    index = folded.index(name.lower())
    powers = table["illuminants"][index]
    inside = np.isfinite(powers)
    return Spectrum(
        table["illuminant_wavelengths"][inside],
        powers[inside],
        str(table["illuminant_names"][index]),
        RELATIVE,
    )


def daylight(temperature: float) -> Spectrum:
    """Return CIE daylight of a correlated colour temperature, 100 at 560 nm, at 300, 305 .. 830 nm.

    Args:
        temperature: Correlated colour temperature [K].

    Returns:
        The spectrum.

    Raises:
        OutOfRange: The temperature is outside 4000 .. 25000 K.

    Source:
        CIE 15:2018, equations 4.5 to 4.11. Factors M1 and M2 are rounded to three decimals as it
        says; 6503.6 K (6500 K on the scale of 1931) then is the published D65.
    """
    if not 4000 <= temperature <= 25000:
        raise OutOfRange(
            "daylight temperature", f"{temperature:g} K", "4000 .. 25000 K (below: blackbody-<T>K)"
        )
    k = 1e3 / temperature
    x = (
        0.244063 + 0.09911 * k + 2.9678 * k**2 - 4.6070 * k**3
        if temperature <= 7000
        else 0.237040 + 0.24748 * k + 1.9018 * k**2 - 2.0064 * k**3
    )
    y = -3.000 * x**2 + 2.870 * x - 0.275
    scale = 0.0241 + 0.2562 * x - 0.7341 * y
    m1 = round((-1.3515 - 1.7703 * x + 5.9114 * y) / scale, 3)
    m2 = round((0.0300 - 31.4424 * x + 30.0717 * y) / scale, 3)
    table = tables("cie")
    return Spectrum(
        table["daylight_wavelengths"],
        np.array([1, m1, m2]) @ table["daylight"],
        f"daylight-{temperature:g}K",
        RELATIVE,
    )


def blackbody(temperature: float, wavelengths) -> Spectrum:
    """Return Planck's law for a temperature, 100 at 560 nm.

    Args:
        temperature: Temperature [K].
        wavelengths: Wavelengths [nm].

    Returns:
        The spectrum.

    Raises:
        OutOfRange: The temperature is outside 300 .. 100000 K.
    """
    if not 300 <= temperature <= 100000:
        raise OutOfRange("blackbody temperature", f"{temperature:g} K", "300 .. 100000 K")
    wavelengths = np.asarray(wavelengths, np.float64)
    exponent = PLANCK * LIGHT_SPEED / (BOLTZMANN * temperature) * 1e9  # times 1 / nm
    ratio = np.expm1(exponent / 560) / np.expm1(exponent / wavelengths)
    return Spectrum(
        wavelengths,
        100 * (560 / wavelengths) ** 5 * ratio,
        f"blackbody-{temperature:g}K",
        RELATIVE,
    )


def white_radiance(light: Spectrum, luminance: float) -> Spectrum:
    """Return the radiance of a perfect white diffuser [photon s-1 m-2 sr-1 nm-1].

    Args:
        light: Relative power in energy units; or photons, if its quantity says so.
        luminance: Luminance of the diffuser [cd m-2].

    Returns:
        The radiance.

    Raises:
        OutOfRange: The luminance is not positive, or the light has no visible power.
    """
    if not (isinstance(luminance, Real) and 0 < luminance <= BRIGHTEST):
        raise OutOfRange(
            "luminance", f"{luminance} cd m-2", f"0 < luminance <= {BRIGHTEST:g} cd m-2"
        )
    light = light_of(light)
    brightness = xyz(light)[1]
    if not brightness > 0:
        raise OutOfRange(
            f"luminous power of {light.name or 'the light'}",
            f"{brightness:g}",
            "> 0 in 360 .. 830 nm",
        )
    radiance = photons_from_energy(light.scale(luminance / brightness))
    return dataclasses.replace(radiance, quantity=PHOTONS)
