"""Folders of band pictures: a grey picture for each wavelength, such as the data base CAVE's."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.domain.memory import require_memory
from gpusim.io.account import note_of
from gpusim.io.scene.cubes import LONGEST, SHORTEST
from gpusim.io.scene.photo import ALPHA, open_photo
from gpusim.io.scene.stacks import SAY_WAVELENGTHS, whole_scale
from gpusim.io.scene.tiff import SUFFIXES as TIFF
from gpusim.io.scene.tiff import read_stack

SUFFIXES = (".png", *TIFF)
MOST_FILES = 4096
NUMBER = re.compile(r"\d+(?:[.,]\d+)?")
WITH_UNIT = re.compile(r"(?<![\d.,])(\d+(?:[.,]\d+)?)[ _-]?(nm|um|µm|μm)(?![a-z])", re.I)
CAVE = "_ms_#"  # end of names in the data base CAVE: 31 files, 400 .. 700 nm


@dataclass(frozen=True)
class Bands:
    """Files of bands by rising number; wavelengths: [nm], or None if their names have none."""

    files: tuple[Path, ...]
    wavelengths: np.ndarray | None
    notes: tuple[str, ...]


def find_bands(folder: Path) -> Bands:
    """Return the bands in a folder: the files whose names differ only by a number.

    If the folder has no files but one folder, its bands. Raises BadFile.
    """
    try:
        inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
        if len(inside) == 1 and inside[0].is_dir():
            return find_bands(inside[0])
        inside = [path for path in inside if path.is_file() or path.is_dir()]
    except OSError as error:
        raise BadFile(folder, f"cannot be read: {error.strerror or error}") from error
    if len(inside) > MOST_FILES:
        raise BadFile(folder, f"more than {MOST_FILES} files")
    pictures = [path for path in inside if path.suffix.lower() in SUFFIXES and path.is_file()]
    groups = _groups(pictures, WITH_UNIT) or _groups(pictures, NUMBER)
    largest = max(map(len, groups.values()), default=0)
    best = {name: found for name, found in groups.items() if len(found) == largest}
    if len(best) != 1:
        what = f"bands of {len(best)} scenes: {', '.join(sorted(best)[:4])}" if best else "no bands"
        raise BadFile(
            folder,
            f"{what}; wanted grey pictures {', '.join(SUFFIXES)} whose names differ by the wavelength, "
            "such as scene_450nm.png",
        )
    name, found = best.popitem()
    numbers = np.array(sorted(found))
    files = tuple(found[number] for number in numbers)
    notes = note_of("files that are no bands", (path.name for path in inside if path not in files))
    nm = _wavelengths(name, numbers, files)
    if nm is not None:
        source = "the data base CAVE" if name.endswith(CAVE) else "the names of the files"
        notes = (f"wavelengths from {source}: {len(nm)} of {nm[0]:g} .. {nm[-1]:g} nm", *notes)
    return Bands(files, nm, notes)


def _groups(pictures, number):
    """Return {name without a number: {number: path}} of names that differ only there.

    Numbers with a unit are in nm.
    """
    groups: dict[str, dict[float, Path]] = {}
    for path in pictures:
        for match in number.finditer(path.stem):
            text = match[1] if number is WITH_UNIT else match[0]
            value = float(text.replace(",", "."))
            if number is WITH_UNIT and match[2].lower() != "nm":
                value = round(value * 1e3, 6)
            end = match.end(1) if number is WITH_UNIT else match.end()
            name = f"{path.stem[: match.start()]}#{path.stem[end:]}"
            groups.setdefault(name, {}).setdefault(value, path)
    if number is NUMBER:  # one number is none that changes
        groups = {name: found for name, found in groups.items() if len(found) > 1}
    return groups


def _wavelengths(name, numbers, files):
    """Return the wavelengths [nm] that names have, or None."""
    if name.endswith(CAVE) and np.array_equal(numbers, np.arange(1, 32)):
        return np.arange(400, 701, 10.0)
    # 0450 is the number of a frame
    is_padded = any(re.search(r"(?<!\d)0\d", path.stem) for path in files)
    with_unit = WITH_UNIT.search(files[0].stem) is not None
    is_plausible = SHORTEST <= numbers[0] and numbers[-1] <= LONGEST
    return numbers if is_plausible and (with_unit or not is_padded) else None


def read_bands(folder: Path, wavelengths=None, scale: float | None = None):
    """Return wavelengths [nm], planes float32 (L, rows, cols) and notes of a folder of bands.

    Codes are proportional to light. wavelengths: [nm], of the bands by rising number; None: by their
    names. scale: number that stands for 1; None is the largest of uint8 and uint16, and 1 of floats.
    Raises BadFile, OutOfRange, DoesNotFit.
    """
    held = find_bands(folder)
    nm, count = held.wavelengths if wavelengths is None else wavelengths, len(held.files)
    if nm is None:
        names = f"{held.files[0].name} .. {held.files[-1].name}"
        raise BadFile(folder, f"{count} bands {names} without wavelengths; {SAY_WAVELENGTHS}")
    if len(nm) != count:
        allowed = f"{count}, one for each of {held.files[0].name} .. {held.files[-1].name}"
        raise OutOfRange("wavelengths", f"{len(nm)} numbers", allowed)
    values, first = None, None
    more: dict[str, None] = {}
    for number, path in enumerate(held.files):
        plane, kind, own = _read_band(path, scale)
        more |= dict.fromkeys(own)
        if values is None:
            require_memory(f"{folder}: {count} bands of {plane.shape}", 4 * count * plane.size)
            values, first = np.empty((count, *plane.shape), np.float32), kind
        if plane.shape != values.shape[1:] or kind != first:
            raise BadFile(
                path,
                f"{plane.shape[1]} x {plane.shape[0]} {kind}, after {values.shape[2]} x "
                f"{values.shape[1]} {first} of {held.files[0].name}; bands have one size and type",
            )
        values[number] = plane
    notes = held.notes if wavelengths is None else tuple(held.notes[held.wavelengths is not None :])
    return np.asarray(nm, np.float64), values, (*notes, *more)


def _read_band(path, scale):
    """Return a grey picture as float32 (rows, cols), 1 for `scale`, the type of its numbers, and notes."""
    if path.suffix.lower() in TIFF:
        values, notes = read_stack(path, 1, scale)
        return values[0], "TIFF", notes
    photograph = open_photo(path)
    samples = photograph.samples
    if samples.shape[-1] in ALPHA:
        alpha = samples[..., -1]
        if (alpha != np.iinfo(samples.dtype).max).any():
            raise BadFile(path, "transparent pixels; a band is a grey picture without them")
        samples = samples[..., :-1]
    if any((samples[..., 0] != samples[..., one]).any() for one in range(1, samples.shape[-1])):
        raise BadFile(path, "a picture in colour; a band is a grey picture")
    plane = samples[..., 0].astype(np.float32)
    plane /= np.float32(whole_scale(path, samples.dtype) if scale is None else scale)
    return plane, str(samples.dtype), photograph.notes
