"""Point spread functions as NumPy archives.

Keys: wavelengths_nm (L,), psf (L, rows, cols), spacing_um; integrated (optional). Over the field:
heights (H,) with psf (H, L, rows, cols), or grid_y (Y,), grid_x (X,) with psf (Y, X, L, rows,
cols). Over the distance of objects: distances_m (D,); D is then the first axis of psf. Rows go
down and columns to the right in the upright picture.
"""

from os import PathLike

from gpusim.domain.errors import BadFile
from gpusim.domain.psf import PointSpread
from gpusim.io.archive import NUMBERS, open_archive, write_archive
from gpusim.io.files import name_in_errors

SHAPES = {
    "wavelengths_nm": (None,),
    "psf": None,
    "spacing_um": (),
    "integrated": (),
    "heights": (None,),
    "grid_y": (None,),
    "grid_x": (None,),
    "distances_m": (None,),
}  # None: any
COPIES = 2.25  # of the numbers: as float64, scaled to sum 1, and whether each is finite


def read_psf(path: str | PathLike) -> PointSpread:
    """Read point spread functions, one per wavelength.

    Args:
        path: NumPy archive, see this module.

    Returns:
        The point spread functions.

    Raises:
        BadFile: if the file cannot be used, naming file and problem.
        DoesNotFit: if it does not fit into memory.
    """
    with open_archive(path) as archive, name_in_errors(path):
        archive.require(("wavelengths_nm", "psf", "spacing_um"))
        for key in SHAPES.keys() & archive.keys():
            archive.shape(key, NUMBERS + "b" * (key == "integrated"), wanted=SHAPES[key])
        axes = [key for key in ("grid_y", "grid_x") if key in archive]
        if len(axes) == 1:
            raise BadFile(path, f"has only {axes[0]}; wanted grid_y and grid_x")
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
            archive["distances_m"] if "distances_m" in archive else None,
            archive.notes(),  # of what was not read before
        )


def write_psf(path: str | PathLike, spread: PointSpread) -> None:
    """Write point spread functions for `read_psf`.

    Args:
        path: file to write.
        spread: the point spread functions.

    Raises:
        BadFile: if the file cannot be written.
    """
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
    if spread.distances is not None:
        arrays["distances_m"] = spread.distances
    write_archive(path, arrays)
