"""Point spreads as NumPy archives: wavelengths_nm (L,), psf (L, rows, cols), spacing_um; integrated (optional).

Over the field: heights (H,) with psf (H, L, rows, cols), or grid_y (Y,), grid_x (X,) with psf (Y, X, L, rows, cols).
Rows go down and columns to the right in the upright picture.
"""

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.psf import PointSpread
from gpusim.io.archive import NUMBERS, open_archive
from gpusim.io.atomic import atomic_path
from gpusim.io.files import named

SHAPES = {
    "wavelengths_nm": (None,),
    "psf": None,
    "spacing_um": (),
    "integrated": (),
    "heights": (None,),
    "grid_y": (None,),
    "grid_x": (None,),
}  # None: any
COPIES = 2.25  # of the numbers: as float64, scaled to sum 1, and whether each is finite


def read_psf(path) -> PointSpread:
    """Read a stack of point spreads, one per wavelength. Raises BadFile, naming file and problem, and DoesNotFit."""
    with open_archive(path) as archive, named(path):
        archive.require(("wavelengths_nm", "psf", "spacing_um"))
        for key in SHAPES.keys() & archive.keys():
            archive.shape(key, NUMBERS + "b" * (key == "integrated"), wanted=SHAPES[key])
        axes = [key for key in ("grid_y", "grid_x") if key in archive]
        if len(axes) == 1:
            raise BadFile(path, f"has {axes[0]} alone; wanted grid_y and grid_x")
        archive.require_memory(COPIES)
        integrated = bool(archive["integrated"]) if "integrated" in archive else False
        heights = archive["heights"] if "heights" in archive else None
        return PointSpread(
            archive["wavelengths_nm"],
            archive["psf"],
            float(archive["spacing_um"]) / 1e6,
            integrated,
            heights,
            tuple(archive[key] for key in axes) or None,
        )


def write_psf(path, spread: PointSpread) -> None:
    """Write point spreads; `read_psf` gives the same back. Raises BadFile."""
    arrays: dict = {
        "wavelengths_nm": spread.wavelengths,
        "psf": spread.values,
        "spacing_um": spread.spacing * 1e6,
        "integrated": spread.integrated,
    }
    if spread.heights is not None:
        arrays["heights"] = spread.heights
    if spread.grid is not None:
        arrays["grid_y"], arrays["grid_x"] = spread.grid
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)
