"""Planes of instruments: numbers of any type, converted to float32 light piece by piece."""

import numpy as np

from gpusim.domain.content import NEGATIVE
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.domain.memory import require_memory

PIECE = 2**22  # [byte] of stored numbers converted at once, at least one row of all planes
COPIES = 4  # of a piece: as stored, as float32, the ignored mask, and a temporary result
BRIGHTEST = 2.0  # largest plausible mean of reflectances
SAY_WAVELENGTHS = "give them [nm], for example --wavelengths 400:700:10"
SAY_SCALE = "give the number that stands for 1, for example scale=10000 or --scale 10000"


def checked_scale(scale) -> float | None:
    """Return a user's number that stands for 1, None if not given. Raises OutOfRange."""
    if scale is None:
        return None
    try:
        value = float(scale)
    except (TypeError, ValueError, OverflowError):
        value = np.nan
    if not 1e-30 <= value <= 1e30:
        raise OutOfRange("scale", scale, "the number that stands for 1, above 0")
    return value


def whole_scale(path, dtype, label: str = "") -> float:
    """Return the largest number of uint8 and uint16, which stands for 1; 1 for floats.

    label: name of the numbers in the file. Raises BadFile for other whole numbers.
    """
    if dtype.kind == "f":
        return 1.0
    if dtype.kind == "u" and dtype.itemsize <= 2:
        return float(np.iinfo(dtype).max)
    named = f"{label}: " if label else ""
    raise BadFile(path, f"{named}whole numbers of type {dtype}; {SAY_SCALE}")


def read_planes(
    path, view, *, scale: float, gains=None, offsets=None, ignored=None
) -> tuple[np.ndarray, list[str]]:
    """Return planes float32 (L, rows, cols), not negative, and notes on changes.

    view: numbers, (L, rows, cols) of any real type, for example of a mapped file. They become (gain
    number + offset) / scale. gains, offsets: of each plane, float64 (L,), or None. ignored: number
    for no data, which becomes 0. Small negative numbers, which are noise, become 0 too. Raises
    BadFile, naming the file, and DoesNotFit.
    """
    count, rows, cols = view.shape
    step = max(1, PIECE // (count * cols * view.dtype.itemsize))
    piece = count * min(step, rows) * cols * max(4, view.dtype.itemsize)
    what = f"{path}: {count} planes of {cols} x {rows} samples"
    require_memory(what, 4 * view.size + COPIES * piece)
    values, without = np.empty(view.shape, np.float32), 0
    with np.errstate(over="ignore", invalid="ignore"):  # infinite or NaN values are refused
        for start in range(0, rows, step):
            stored = np.asarray(view[:, start : start + step])
            planes = values[:, start : start + step]
            planes[:] = stored
            if gains is not None:
                planes *= gains[:, None, None].astype(np.float32)
            if offsets is not None:
                planes += offsets[:, None, None].astype(np.float32)
            if scale != 1:
                planes /= np.float32(scale)
            if ignored is not None:
                absent = np.isnan(stored) if ignored != ignored else stored == ignored
                planes[absent] = 0
                without += int(absent.any(0).sum())
    notes = []
    if without:
        notes.append(f"no data in {100 * without / (rows * cols):.2g} % of the samples: dark")
    return values, notes + cut_noise(path, values)


def cut_noise(path, values) -> list[str]:
    """Set noise below 0 to 0 in place; return notes. values: float32 (L, ...).

    Raises BadFile for values that cannot be light.
    """
    low, high = float(values.min()), float(values.max())
    if not np.isfinite([low, high]).all():
        raise BadFile(path, "NaN or infinite values, or more than float32 holds")
    if low < -NEGATIVE * max(high, 0):
        raise BadFile(
            path,
            f"negative values (lowest {low:.3g}, highest {high:.3g}), more than noise; wanted light, "
            "with samples without data left out or marked by the header",
        )
    if low >= 0:
        return []
    below = 0
    for plane in values:
        below += int(np.count_nonzero(plane < 0))
        np.maximum(plane, 0, out=plane)
    return [
        f"negative values, {100 * below / values.size:.2g} % of them, lowest {low:.3g}: taken as 0"
    ]


def check_reflectances(path, values):
    """Raise BadFile if the mean is far above the range of reflectances: the scale is wrong."""
    mean = float(values.mean(dtype=np.float64))
    if mean > BRIGHTEST:
        raise BadFile(path, f'reflectances of mean {mean:.3g}; {SAY_SCALE}, or kind = "radiance"')
