"""The Bayer mosaic: where its colours are."""

from gpusim.domain.errors import BadData, OutOfRange, UnknownName

RED = {
    "RGGB": (0, 0),
    "GRBG": (0, 1),
    "GBRG": (1, 0),
    "BGGR": (1, 1),
}  # row and column of the first red pixel


def red_pixel(phase: str) -> tuple[int, int]:
    """Row and column of the first red pixel of a Bayer mosaic named by its first two rows. Raises UnknownName."""
    if phase not in RED:
        raise UnknownName("Bayer phase", phase, RED)
    return RED[phase]


def check_mosaic(raw, scale):
    """Refuse what is not a mosaic of digital numbers. Raises BadData, OutOfRange."""
    dtype = getattr(raw.dtype, "name", None) or raw.dtype.__name__  # of NumPy or of a device
    if len(raw.shape) != 2 or dtype != "uint16" or 0 in raw.shape:
        raise BadData(f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (rows, cols) of uint16")
    if not scale > 0:
        raise OutOfRange("scale", scale, "scale > 0")
