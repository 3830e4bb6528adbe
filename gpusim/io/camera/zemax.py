"""Point spread functions from text listings of Zemax OpticStudio: Huygens PSF and FFT PSF."""

import re
from collections.abc import Iterable
from os import PathLike

import numpy as np

from gpusim.domain.errors import BadData, format_value
from gpusim.domain.psf import PointSpread
from gpusim.io.camera.traced import Traced, spread_of
from gpusim.io.files import name_in_errors, read_text, reading

WHAT = "a text listing of Zemax's Huygens PSF or FFT PSF"
LONGEST = 2**26  # [byte]: a grid of 2048 x 2048
COST = 12  # [byte] memory per byte of text: letters, words, numbers
UNITS = {
    **dict.fromkeys(("µm", "μm", "um", "micrometers"), 1e-6),
    "nm": 1e-9,
    **dict.fromkeys(("mm", "millimeters"), 1e-3),
    **dict.fromkeys(("cm", "centimeters"), 1e-2),
    **dict.fromkeys(("in", "inches"), 0.0254),
    **dict.fromkeys(("m", "meters"), 1.0),
}
NUMBER = r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
UNIT = r"([^\s\d.,()]+)"
SPACING = re.compile(rf"Data spacing is {NUMBER} {UNIT}\.", re.M)
LIGHT = re.compile(rf"^{NUMBER}(?: to {NUMBER})? {UNIT} at (.+)$", re.M)
GRID = re.compile(r"^Image grid size *: (\d{1,5}) by (\d{1,5})", re.M)
MIDDLE = re.compile(r"^Center point is *: (?:row )?(\d{1,5}), (?:column )?(\d{1,5})", re.M)
CENTRE = re.compile(
    rf"^(?:Center|Reference) coordinates *: *{NUMBER}, *{NUMBER}(?:[ \t]+{UNIT})?", re.M | re.I
)
VALUES = re.compile(r"^Values are .*$", re.M)
WAVELENGTHS, SPACINGS, PLACES = (1e-7, 1e-4), (1e-10, 1e-2), (-10.0, 10.0)  # [m] plausible limits
FINEST = 1e-9  # relative precision of printed wavelengths


def read_zemax_psf(
    paths: str | PathLike | Iterable[str | PathLike],
    corner: float | None = None,
    reference: float | None = None,
) -> PointSpread:
    """Read the text listings of one lens, one per wavelength and field point.

    The first line of a listing's grid is the top one, of the largest y, as OpticStudio draws it.
    Energies are scaled to 1: light beyond the grid is lost, so use a wide grid.

    Args:
        paths: one file or several. Each is of a single wavelength, linear, on axis or at a field
            point along x or y.
        corner: distance of the frame's corner from the axis [m], required for several field points.
            The lens is taken as round; heights are distances of the image points (the listings'
            coordinates, in mm unless they have a unit).
        reference: see `gpusim.io.camera.traced.spread_of`.

    Returns:
        The camera's point spread functions.

    Raises:
        BadFile: if a file cannot be used, naming it.
        BadData: if the files do not fit together.
        OutOfRange: if the reference or the field points are out of range.
    """
    several = isinstance(paths, Iterable) and not isinstance(paths, str)
    files: Iterable = paths if several else [paths]  # type: ignore[assignment]
    return spread_of([_read_listing(path) for path in files], corner, reference)


def _read_listing(path) -> Traced:
    text = read_text(path, WHAT, LONGEST, older=True, cost=COST).replace("\r\n", "\n")
    with name_in_errors(path):
        if not re.search(r"(?:Huygens|FFT) PSF", text[:2000], re.I):
            raise BadData(f"not {WHAT}")
        start = VALUES.search(text)
        if start is None:
            raise BadData(f'not {WHAT}: no line "Values are ..." before the values')
        head = text[: start.start()]
        rows, cols = map(int, _match(GRID, head, "Image grid size").groups())
        values = _parse_values(path, text[start.end() :], rows, cols)
        first, last, unit, field = _match(LIGHT, head, "wavelength and field").groups()
        if last is not None and abs(float(last) / max(float(first), 1e-30) - 1) > FINEST:
            why = f"of {first} to {last} {unit}: wanted a listing of a single wavelength each"
            raise BadData(why)
        wavelength = _parse_length("wavelength", first, unit, WAVELENGTHS)
        size, spacing_unit = _match(SPACING, head, "Data spacing").groups()
        spacing = _parse_length("Data spacing", size, spacing_unit, SPACINGS)
        middle = MIDDLE.search(head)
        row, col = (int(item) - 1 for item in middle.groups()) if middle else (rows // 2, cols // 2)
        if not (0 <= row < rows and 0 <= col < cols):
            raise BadData(f"Center point is row {row + 1}, column {col + 1} of {rows} x {cols}")
        x, y, length = centre.groups() if (centre := CENTRE.search(head)) else (0, 0, None)
        x, y = (
            _parse_length("Center coordinates", item, length or "mm", PLACES) for item in (x, y)
        )
        nanometres = round(wavelength * 1e9, 6)
        # the first line is the top one
        place = (rows - 1 - row, col)
        return Traced(nanometres, values[::-1], spacing, place, (x, y), field.strip())


def _match(pattern, head, what):
    found = pattern.search(head)
    if found is None:
        raise BadData(f"not {WHAT}: no {what} in it")
    return found


def _parse_length(what, number, unit, limits):
    """Return a length [m] within plausible limits."""
    if unit.lower().rstrip(".") not in UNITS:
        raise BadData(f"unit {format_value(unit)}: wanted one of {', '.join(UNITS)}")
    length, (low, high) = float(number) * UNITS[unit.lower().rstrip(".")], limits
    if not low <= length <= high:
        raise BadData(f"{what}: {number} {unit}, wanted {low:g} .. {high:g} m")
    return length


def _parse_values(path, text, rows, cols):
    if not rows * cols:
        raise BadData(f"Image grid size of {rows} by {cols}: wanted a point spread")
    words = text.split()
    if len(words) != rows * cols:
        raise BadData(f"{len(words)} values instead of {rows} x {cols}; is it truncated?")
    # all numbers of OpticStudio have the same length
    if not text[-1].isspace() and len(set(map(len, words))) > 1:
        why = f"no line ends after the last value, {format_value(words[-1])}; is it truncated?"
        raise BadData(why)
    with reading(path, f"{WHAT} in numbers"):
        values = np.array(words, np.float64).reshape(rows, cols)
    if not ((values >= 0) & (values < np.inf)).all():
        raise BadData(
            "has values that are negative or not finite: wanted a linear listing, not a logarithmic "
            "one"
        )
    return values
