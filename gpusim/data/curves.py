"""The measured spectral curves that come with gpusim: quantum efficiencies and filters.

Where each comes from, and what it does and does not include, is in README-curves.md beside this file.
"""

from functools import cache
from pathlib import Path

import numpy as np

from gpusim.domain.errors import UnknownName
from gpusim.domain.spectrum import Spectrum

# The functions of each table, one letter each; "" marks a table of a single, unnamed function.
CHANNELS = {
    "mt9v024": "RGBW",
    "iset-rgb": "RGB",
    "cmos-photodetector": "",
    "ir-cut-phone": "",
    "ir-cut-schott": "",
}


@cache
def _tables():
    with np.load(Path(__file__).with_name("curves.npz")) as file:
        return dict(file)


def curve_names() -> list[str]:
    """Names that `curve` knows, sorted."""
    return sorted(CHANNELS)


def curve(name: str) -> Spectrum:
    """Return the table `name`: shape (C, L) in the order of CHANNELS[name], (L,) for a single function.

    Efficiencies are in e-/photon, filters in transmitted fraction; 400 to 700 nm. Raises UnknownName.
    """
    if name not in CHANNELS:
        raise UnknownName("curve", name, CHANNELS)
    return Spectrum(_tables()["wavelengths"], _tables()[name], name)
