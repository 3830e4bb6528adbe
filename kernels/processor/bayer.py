"""The Bayer mosaic: places of its colours."""

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.stage import dtype_name

# row and column of the first red pixel
RED = {"RGGB": (0, 0), "GRBG": (0, 1), "GBRG": (1, 0), "BGGR": (1, 1)}


def red_pixel(phase: str) -> tuple[int, int]:
    """Return row and column of a Bayer phase's first red pixel. Raise UnknownName."""
    if phase not in RED:
        raise UnknownName("Bayer phase", phase, RED)
    return RED[phase]


def check_mosaic(raw, scale):
    """Raise BadData or OutOfRange if this is no mosaic of digital numbers with a scale > 0."""
    dtype = dtype_name(raw)
    if len(raw.shape) != 2 or dtype != "uint16" or 0 in raw.shape:
        raise BadData(f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (rows, cols) of uint16")
    if not scale > 0:
        raise OutOfRange("scale", scale, "scale > 0")
