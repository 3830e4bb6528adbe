"""Tables of spectra, .csv, and scenes of patches that show them."""

import math

import numpy as np

from gpusim.data.charts import checked_size
from gpusim.domain.content import Materials
from gpusim.domain.errors import BadData, BadFile, OutOfRange, one_line
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Scene
from gpusim.domain.units import AXIS, convert_to_nm, is_inverse, read_share_heading
from gpusim.io.files import name_in_errors, read_cells

LONGEST_TABLE = 2**23  # [byte] of text: 1000 spectra of 800 wavelengths
MOST = 2**16 - 1  # spectra, next to a dark one
SIZE = (768, 512)  # columns and rows, as for charts
BYTES_PER_SAMPLE = 24  # of ids and shading while drawing
SHORTEST, LONGEST = 100, 1e5  # [nm] plausible wavelengths
WANTED = (
    "wanted a table of numbers, wavelengths [nm] in the first column and a spectrum in each other one, or "
    "wavelengths in the first line and a spectrum in each other one"
)


def read_spectra(
    path, has_scale: bool = False, is_density: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Read a table of spectra: wavelengths [nm], float64 (L,), and spectra, float64 (spectra, L).

    The first column, or the first line, has the wavelengths, sorted ascending here, in the unit that
    their heading names, or nm; see `gpusim.domain.units`. Other headings, and names, are ignored,
    but percent, unless has_scale: then the caller knows the scale. is_density: the spectra are light
    per nm, whose numbers depend on the unit of the axis. Separators and comments: see `read_cells`.
    Raises BadFile, DoesNotFit.
    """
    cells = read_cells(path, LONGEST_TABLE)
    width = max(map(len, cells), default=0)
    if len(cells) < 2 or width < 2:
        raise BadFile(path, f"{len(cells)} lines of {width} cells; {WANTED}")
    if any(len(row) < width for row in cells):
        raise BadFile(path, f"lines of {min(map(len, cells))} to {width} cells; {WANTED}")
    numbers = np.array([[_number(cell) for cell in row] for row in cells])
    with name_in_errors(path):
        tables = (
            _spectra([row[0] for row in cells], numbers, is_density),
            _spectra(cells[0], numbers.T, is_density),
        )
    found = [table for table in tables if table]
    if not found or (len(found) > 1 and not AXIS.search(cells[0][0])):
        both = "both the first column and the first line could be wavelengths; "
        raise BadFile(path, both + WANTED if found else WANTED)
    nm, spectra = found[0]
    spectra = spectra if has_scale else spectra * _shares(cells)
    if not np.isfinite(spectra).all():
        spectrum, band = np.argwhere(~np.isfinite(spectra))[0]
        raise BadFile(path, f"spectrum {spectrum + 1} at {nm[band]:g} nm is not a number; {WANTED}")
    order = np.argsort(nm)
    return nm[order], spectra[:, order]


def _shares(cells):
    """Return the factor on the numbers: 0.01 if a heading of the first line or column says percent."""
    heads = [*cells[0], *(row[0] for row in cells)]
    return min(
        (read_share_heading(cell)[1] for cell in heads if "%" in cell or "perc" in cell.lower()),
        default=1.0,
    )


def _number(cell):
    try:
        return float(cell.removesuffix("nm"))
    except ValueError:
        return math.nan


def _spectra(words, numbers, is_density):
    """Return wavelengths [nm] and spectra below them; None if `words` are no wavelengths.

    words: the first column. It has wavelengths if they are in order and plausible, below any number
    of headings; only the first heading may have numbers next to it, else an unreadable wavelength
    would pass as a heading.
    """
    headings = int(np.argmax(np.append(np.isfinite(numbers[:, 0]), True)))
    if np.isfinite(numbers[1:headings, 1:]).any():
        return None
    nm = numbers[headings:, 0]
    steps = np.diff(nm)
    if not len(steps) or not ((steps > 0).all() or (steps < 0).all()):
        return None
    axis = next((word for word in words[:headings] if AXIS.search(word)), "")
    if axis and is_density and is_inverse(axis):
        raise BadData(
            f"heading {one_line(axis, 40)!r}: light over wave numbers or energy may be per nm or per their unit; "
            "wanted a column of wavelengths, and light per nm"
        )
    if axis:
        nm = convert_to_nm(nm, axis)
    if SHORTEST <= nm.min() <= nm.max() <= LONGEST:
        return (nm, numbers[headings:, 1:].T)
    return None


def patches(path, wavelengths, spectra, light, size=None, notes=()) -> Scene:
    """Return a scene of patches, one per spectrum, row by row from the top left.

    Spare cells are dark. spectra: (spectra, L), relative to `light`, a Spectrum. size: columns and
    rows of the frame [pixel]; None is the size of charts. Raises OutOfRange, BadFile, DoesNotFit.
    """
    cols, rows = checked_size(size or SIZE)
    count = len(spectra)
    across = min(count, max(1, round(math.sqrt(count * cols / rows))))
    down = -(-count // across)
    if count > MOST:
        raise BadFile(path, f"{count} spectra; at most {MOST} make a scene")
    if across > cols or down > rows:
        allowed = f"at least {across} x {down} pixels, one for each spectrum"
        raise OutOfRange("size", f"{cols} x {rows}", allowed)
    require_memory(f"{path}: a picture of {cols} x {rows} pixels", BYTES_PER_SAMPLE * cols * rows)
    ids = (np.arange(rows) * down // rows)[:, None] * across + np.arange(cols) * across // cols
    np.minimum(ids, count, out=ids)
    spectra = np.vstack([spectra, np.zeros((int(across * down > count), len(wavelengths)))])
    note = f"{count} spectra as patches, {across} x {down}, row by row"
    with name_in_errors(path):
        content = Materials(
            wavelengths,
            ids.astype(np.uint8 if len(spectra) < 257 else np.uint16),
            np.ones(ids.shape, np.float32),
            spectra,
        )
        return Scene(content, light, name=path.stem, notes=(note, *notes))
