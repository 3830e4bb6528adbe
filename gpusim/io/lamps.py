"""Spectra of lamps and surfaces from files: tables (.csv) and IES TM-27-14 (.spdx, .xml)."""

import re
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile, one_line
from gpusim.domain.spectrum import RELATIVE, SHARE, Spectrum, energy_from_photons
from gpusim.io.files import name_in_errors, read_cells, read_text, reading

LONGEST = 2**23  # [byte] of a file
# TM-27's quantities: of light, and of surfaces and filters
LIGHT = ("flux", "intensity", "irradiance", "radiance", "exitance", "relative", "other")
SURFACE = ("reflectance", "transmittance", "r-values", "t-values", "relative", "other")
LEAST_PERCENT = 2.0  # reflectances above it, as a mean, are no shares
_PHOTONS = re.compile(r"photon|quant|[µμu]mol|einstein", re.I)


def read_lamp(path) -> Spectrum:
    """Return the relative power of a lamp [W nm-1, up to a factor].

    A .csv is a table of wavelengths and one column of power per nm, or of photons if its heading
    says so. Raises BadFile, DoesNotFit.
    """
    nm, values, words = _read(Path(path), LIGHT)
    if len(values) != 1:
        raise BadFile(path, f"{len(values)} spectra; wanted the one of a lamp")
    if (values < 0).any():
        raise BadFile(path, f"power from {values.min():.3g}; wanted none below 0")
    with name_in_errors(path):
        light = Spectrum(nm, values[0], Path(path).name)
        if _PHOTONS.search(words):
            light = energy_from_photons(light)
        return Spectrum(light.wavelengths, light.values, light.name, RELATIVE)


def read_surfaces(path) -> Spectrum:
    """Return the reflectances of a file [1], shape (N, L). Raises BadFile, DoesNotFit."""
    nm, values, _ = _read(Path(path), SURFACE)
    if not values.min() >= 0 or values.mean() > LEAST_PERCENT:
        raise BadFile(
            path,
            f"reflectances {values.min():.3g} .. {values.max():.3g}, wanted shares 0 .. 1, or a heading that "
            "says percent",
        )
    with name_in_errors(path):
        return Spectrum(nm, values, Path(path).name, SHARE)


def _read(path, quantities):
    """Return wavelengths (L,), spectra (N, L) and the words of the headings."""
    if path.suffix.lower() == ".csv":
        from gpusim.io.scene.spectra import read_spectra

        nm, values = read_spectra(path, is_density=quantities is LIGHT)
        heads = [cell for cell in read_cells(path, LONGEST)[0] if not _is_number(cell)]
        return nm, values, " ".join(heads)
    return _read_tm27(path, quantities)


def _is_number(cell):
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_tm27(path, quantities):
    """Read the XML of IES TM-27-14."""
    import xml.etree.ElementTree as ET

    text = read_text(path, "an IES TM-27 spectrum", LONGEST)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadFile(path, "declares entities; wanted plain XML of IES TM-27")
    with reading(path, "an IES TM-27 spectrum"):
        root = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
        found = {"data": [], "quantity": ""}
        for element in root.iter():
            name = element.tag.rpartition("}")[2]
            if name == "SpectralData":
                found["data"].append((float(element.attrib["wavelength"]), float(element.text)))
            elif name == "SpectralQuantity":
                found["quantity"] = (element.text or "").strip().lower()
    if len(found["data"]) < 2:
        raise BadFile(path, f"{len(found['data'])} SpectralData of IES TM-27; wanted two or more")
    if found["quantity"] and found["quantity"] not in quantities:
        raise BadFile(
            path,
            f"SpectralQuantity {one_line(found['quantity'], 40)!r}; wanted one of {', '.join(quantities)}",
        )
    nm, values = np.array(sorted(found["data"])).T
    return nm, values[None], ""
