"""Measured reflectances of surfaces."""

from os import PathLike

from gpusim.data.colorimetry import tables
from gpusim.data.lights import FILES
from gpusim.domain.above import call_above
from gpusim.domain.errors import UnknownName
from gpusim.domain.spectrum import Spectrum


def reflectances(set_name: str | PathLike[str]) -> Spectrum:
    """Return all samples of a measured set at 400, 410 .. 700 nm, shape (N, 31); or of a file.

    Args:
        set_name: "macbeth" (24 patches), "munsell" (64 chips), "dupont" (120 paint chips),
            "objects" (170), "nature" (79 of these), "skin" (19), "colorchecker-sg" (140 patches),
            from ISETCam, see README.md in this folder; or "colorchecker": the 24 patches of ISO
            17321-1, shape (24, 81), at 380, 385 .. 780 nm. Or a file, .csv, .spdx or .xml (IES
            TM-27), at its own wavelengths.

    Returns:
        The reflectances [1].

    Raises:
        BadFile: The file holds no reflectances.
        UnknownName: The set is not known.
    """
    if isinstance(set_name, PathLike) or str(set_name).lower().endswith(FILES):
        found: Spectrum = call_above("io.lamps.read_surfaces", set_name)
        return found
    if set_name == "colorchecker":
        table = tables("cie")
        return Spectrum(table["colorchecker_wavelengths"], table["colorchecker"], set_name)
    table = tables("reflectances")
    if set_name not in table or set_name == "wavelengths":
        raise UnknownName(
            "set of reflectances", set_name, {*table, "colorchecker"} - {"wavelengths"}
        )
    return Spectrum(table["wavelengths"], table[set_name], set_name)
