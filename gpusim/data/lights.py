"""Illuminants by name, and the radiance of white in them."""

import re
from numbers import Real

import numpy as np

from gpusim.data.colorimetry import tables, xyz
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import BOLTZMANN, LIGHT_SPEED, PLANCK, Spectrum, photons_from_energy

BRIGHTEST = 1e12  # [cd m-2]; the sun has 1.6e9
TEMPERATURE = re.compile(r"(daylight|blackbody)-(\d+(?:\.\d+)?)k")


def illuminant(name: str, wavelengths=None) -> Spectrum:
    """Relative spectral power [W nm-1, up to a factor] of a light.

    name: a CIE illuminant ("A", "C", "D65", "E", "FL2", "FL3.15", "HP1", "LED-B1", "ID65", ...), CIE daylight of a
        temperature ("daylight-5000K", 4000 .. 25000 K) or a blackbody ("blackbody-3200K"); upper or lower case.
        CIE illuminants have the published scale, the others are 100 at 560 nm.
    wavelengths: [nm] where it is wanted, or None for its own table (CIE: 5 nm; daylight: 300 .. 830 nm by 5 nm;
        blackbody: 300 .. 1100 nm by 1 nm). Zero outside a CIE table; a blackbody has no limits.
    Raises UnknownName and OutOfRange.
    """
    if not isinstance(name, str):
        raise UnknownName("light", str(name), illuminant_names())
    match = TEMPERATURE.fullmatch(name.lower())
    if match and match[1] == "blackbody":
        return blackbody(
            float(match[2]), np.arange(300.0, 1101.0) if wavelengths is None else wavelengths
        )
    light = daylight(float(match[2])) if match else _cie_illuminant(name)
    return (
        light if wavelengths is None else Spectrum(wavelengths, light.at(wavelengths), light.name)
    )


def light_of(light: str | Spectrum) -> Spectrum:
    """Relative power [W nm-1, up to a factor] by an illuminant's name, or as given. Raises UnknownName, BadData."""
    if isinstance(light, str):
        return illuminant(light)
    if not isinstance(light, Spectrum) or light.values.ndim != 1:
        raise BadData(
            f"light of {type(light).__name__}: wanted a name, or a Spectrum of one function"
        )
    return light


def illuminant_names() -> list[str]:
    """Every name that `illuminant` knows, temperatures as a pattern."""
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
    )


def daylight(temperature: float) -> Spectrum:
    """CIE daylight of a correlated colour temperature [K], 100 at 560 nm, at 300, 305 .. 830 nm.

    Source: CIE 15:2018, equations 4.5 to 4.11, with the factors M1 and M2 rounded to three decimals as it says, so
    that 6503.6 K (6500 K on the scale of 1931) is the published D65. Raises OutOfRange outside 4000 .. 25000 K.
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
    )


def blackbody(temperature: float, wavelengths) -> Spectrum:
    """Planck's law at a temperature [K], 100 at 560 nm. Raises OutOfRange outside 300 .. 100000 K."""
    if not 300 <= temperature <= 100000:
        raise OutOfRange("blackbody temperature", f"{temperature:g} K", "300 .. 100000 K")
    wavelengths = np.asarray(wavelengths, np.float64)
    exponent = PLANCK * LIGHT_SPEED / (BOLTZMANN * temperature) * 1e9  # times 1 / nm
    ratio = np.expm1(exponent / 560) / np.expm1(exponent / wavelengths)
    return Spectrum(
        wavelengths, 100 * (560 / wavelengths) ** 5 * ratio, f"blackbody-{temperature:g}K"
    )


def white_radiance(light: Spectrum, luminance: float) -> Spectrum:
    """Radiance of a perfect white diffuser [photon s-1 m-2 sr-1 nm-1] of a given luminance [cd m-2].

    light: relative power in energy units. Raises OutOfRange for luminance <= 0 and for a light without visible power.
    """
    if not (isinstance(luminance, Real) and 0 < luminance <= BRIGHTEST):
        raise OutOfRange(
            "luminance", f"{luminance} cd m-2", f"0 < luminance <= {BRIGHTEST:g} cd m-2"
        )
    brightness = xyz(light)[1]
    if not brightness > 0:
        raise OutOfRange(
            f"luminous power of {light.name or 'the light'}",
            f"{brightness:g}",
            "> 0 in 360 .. 830 nm",
        )
    return photons_from_energy(light.scaled(luminance / brightness))
