"""Measured spectral curves of the package: quantum efficiencies and filters.

README-curves.md in this folder names their sources and contents.
"""

from gpusim.data.colorimetry import tables
from gpusim.domain.errors import UnknownName
from gpusim.domain.spectrum import Spectrum

# The functions of each table, one letter each; "" for a table of a single function.
CHANNELS = {
    "mt9v024": "RGBW",
    "iset-rgb": "RGB",
    "cmos-photodetector": "",
    "ir-cut-phone": "",
    "ir-cut-schott": "",
}


def curve(name: str) -> Spectrum:
    """Return the table `name`, 400 to 700 nm.

    Shape (C, L) in the order of CHANNELS[name], or (L,) for a single function. Efficiencies are in
    e-/photon, filters in transmitted fraction. Raises UnknownName.
    """
    if name not in CHANNELS:
        raise UnknownName("curve", name, CHANNELS)
    table = tables("curves")
    return Spectrum(table["wavelengths"], table[name], name)
