"""ENVI files: a text header, .hdr, next to a raw file of samples or a library of spectra.

Source: the list of header fields in ENVI's documentation ("ENVI Header Files").
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange, format_value, one_line
from gpusim.io.account import Fields
from gpusim.io.files import file_size, open_file, read_text, reading
from gpusim.io.scene.stacks import (
    SAY_SCALE,
    SAY_WAVELENGTHS,
    check_reflectances,
    read_planes,
)

WHAT = "an ENVI header"
TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
COMPLEX = (6, 9)
# axes of bands, rows and columns in a file
AXES = {"bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (2, 0, 1)}
# suffixes of data files next to a header
DATA = ("", ".raw", ".img", ".dat", ".bil", ".bip", ".bsq", ".bin", ".sli")
SCENE = "gpusim scene"  # gpusim's own field, see `gpusim.io.scene.scene_planes`
LIBRARY = "envi spectral library"
NANOMETRES: dict[str, float] = {
    **dict.fromkeys("nanometers nanometer nanometres nanometre nm".split(), 1),
    **dict.fromkeys("micrometers micrometer micrometres micrometre".split(), 1e3),
    **dict.fromkeys("microns micron um µm μm".split(), 1e3),
    **dict.fromkeys("angstroms angstrom".split(), 0.1),
}
UNSAID = ("", "unknown")
# fields that say nothing about light or geometry
PLAIN: tuple[str, ...] = (
    "description",
    "file type",
    "sensor type",
    "band names",
    "spectra names",
    "z plot *",
)
PLAIN += ("default *", "header offset", "file compression", "*frame offsets", "class*", "history")
LONGEST_UM = 100  # without a unit, numbers below are micrometres, others nanometres
SHORTEST, LONGEST = 100, 1e5  # [nm] plausible wavelengths
PER_NM = 1e3  # W m-2 sr-1 um-1, ENVI's unit of gains and offsets, in one W m-2 sr-1 nm-1


@dataclass(frozen=True, eq=False)
class Envi:
    """Content of a header and its data file.

    kind: "reflectance" [1] or "radiance" [W m-2 sr-1 nm-1]. wavelengths: [nm], (L,), ascending.
    values: float32, (L, rows, cols), or (L, spectra) of a library. notes: values that were changed
    or not read. scene: gpusim's own description of a scene, or None.
    """

    kind: str
    wavelengths: np.ndarray
    values: np.ndarray
    notes: tuple[str, ...]
    scene: str | None = None


def read_envi(path, wavelengths=None, kind: str | None = None, scale: float | None = None) -> Envi:
    """Read an ENVI file from its header: BSQ, BIL or BIP, of any real type and byte order.

    wavelengths: [nm], one per band, instead of the header's. kind: "reflectance" or "radiance";
    None is the kind for which the header has a factor or gains, else reflectance. scale: number
    that stands for 1, instead of `reflectance scale factor`; integers need one of them. Gains and
    offsets are applied, for radiance as W m-2 sr-1 um-1. Bands marked bad by `bbl` are left out;
    samples with the `data ignore value` become 0.

    Raises BadFile, DoesNotFit, OutOfRange.
    """
    path = Path(path)
    header = _Header(path)
    header.refuse_others()
    library = header.text("file type", "").lower() == LIBRARY
    rows = header.whole("lines")
    cols = header.whole("samples")
    bands = header.whole("bands", 1 if library else None)
    if library and bands != 1:
        why = f"a spectral library of {bands} bands; wanted 1, and a spectrum on each line"
        raise BadFile(path, why)
    planes = cols if library else bands
    wavelengths, good, notes = _wavelengths(header, wavelengths, planes)
    dtype, said = header.dtype()
    notes += said
    kind = kind or header.kind()
    gains, offsets = header.gains(kind, planes)
    factor = header.scale(kind, dtype, gains is not None) if scale is None else scale
    interleave = header.text("interleave").lower()
    if interleave not in AXES:
        raise BadFile(path, f"interleave = {format_value(interleave)}: wanted bsq, bil or bip")
    axes = AXES[interleave]
    shape = [0, 0, 0]
    for axis, length in zip(axes, (bands, rows, cols), strict=True):
        shape[axis] = length
    start, wanted = header.whole("header offset", 0, least=0), rows * cols * bands * dtype.itemsize
    data = _data_file(path, start + wanted)
    with open_file(data) as file:
        there = file_size(file) - start
        if there < wanted:
            size = f"{bands} bands, {rows} lines, {cols} samples of {dtype.itemsize} bytes"
            need = f"{path.name} needs {wanted} bytes from byte {start} on ({size})"
            raise BadFile(data, f"truncated: {need}, {max(there, 0)} are there")
        if there > wanted:
            notes.append(
                f"{data.name} has {there - wanted} bytes more than its header declares; check both"
            )
        with reading(data, "a file that can be mapped"):
            view = np.memmap(file, dtype, "r", start, tuple(shape)).transpose(axes)
        if library:
            view = view[0].T[:, :, None]
        order = np.flatnonzero(good)[np.argsort(wavelengths[good], kind="stable")]
        values, changes = read_planes(
            data,
            _SelectedPlanes(view, order),
            scale=factor,
            ignored=header.ignored_value(dtype),
            gains=None if gains is None else gains[order],
            offsets=None if offsets is None else offsets[order],
        )
    if kind == "reflectance" and scale is None and factor == 1 and gains is None:
        check_reflectances(data, values)
    scene = header.account.take(SCENE)
    notes += [*changes, *header.fields_left(library)]
    values = values[..., 0] if library else values
    return Envi(kind, wavelengths[order], values, tuple(notes), scene)


class _SelectedPlanes:
    """Selected planes of a mapped file in another order, read on access."""

    def __init__(self, view, order):
        self.view, self.order, self.dtype = view, order, view.dtype
        self.shape = (len(order), *view.shape[1:])
        self.size = len(order) * view[0].size

    def __getitem__(self, index):
        planes, rows = index
        return self.view[self.order[planes], rows]


class _Header:
    """Fields of a header by lower-case names, each checked when it is read."""

    def __init__(self, path):
        self.path = path
        self.fields: dict[str, str] = {}
        with open_file(path) as file, reading(path, WHAT):
            if file.read(2) == b"#?":
                raise BadFile(path, f"a Radiance picture (RGBE), not {WHAT}; convert it to .exr")
        lines = iter(read_text(path, WHAT, older=True).splitlines())
        if not next(lines, "").strip().startswith("ENVI"):
            raise BadFile(path, f"not {WHAT}: its first line is not ENVI")
        for line in lines:
            key, equals, value = line.partition("=")
            key, value = " ".join(key.lower().split()), value.strip()
            if line.startswith(";") or not equals:
                continue
            if value.startswith("{"):
                parts = [value]
                while "}" not in parts[-1]:
                    line_after = next(lines, None)
                    if line_after is None:
                        raise BadFile(
                            path,
                            f"{format_value(key)} has no end: a brace is not closed; is it truncated?",
                        )
                    if not line_after.startswith(";"):
                        parts.append(line_after)
                value = " ".join(parts)
            if self.fields.get(key, value) != value:
                raise BadFile(path, f"has two different values for {format_value(key)}")
            self.fields[key] = value
        self.account = Fields(self.fields, "fields of the header not used")
        self.account.ignore(*PLAIN)

    def fields_left(self, library) -> list[str]:
        """Return notes on the fields that were not used."""
        notes = []
        if "fwhm" in self.fields and not library:
            width = self.account.take("fwhm").strip("{} ").replace(" ", "").split(",")
            widths = width[0] if len(set(width)) == 1 else f"{width[0]} .. {width[-1]}"
            notes = [f"fwhm {one_line(widths, 40)} of the bands: their means are taken as samples"]
        return [*notes, *self.account.notes()]

    def refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def text(self, key, default=None) -> str:
        """Return a field as text."""
        value = self.account.take(key, default)
        if value is None:
            self.refuse(f"lacks {key!r}")
        return value

    def whole(self, key, default=None, least=1) -> int:
        """Return a field as a whole number."""
        text = self.text(key, None if default is None else str(default))
        if not re.fullmatch(r"\d{1,15}", text) or int(text) < least:
            self.refuse(f"{key} = {format_value(text)}: wanted a whole number, {least} or more")
        return int(text)

    def number(self, key) -> float:
        """Return a field as a number, possibly NaN."""
        try:
            return float(self.text(key))
        except ValueError:
            why = f"{key} = {format_value(self.text(key))}: wanted a number"
            raise BadFile(self.path, why) from None

    def numbers(self, key, count) -> np.ndarray:
        """Return a field as a list of finite numbers, float64 (count,)."""
        words = self.text(key).strip("{} \t,").split(",")
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            why = f"{key}: wanted numbers in braces, for example {{1, 2, 3}}"
            raise BadFile(self.path, why) from None
        if len(values) != count or not np.isfinite(values).all():
            why = f"{key}: {len(values)} numbers, wanted {count} finite ones, one for each band"
            self.refuse(why)
        return values

    def refuse_others(self):
        """Raise BadFile for files of an unsupported form."""
        if self.text("file compression", "0") != "0":
            why = "file compression: compressed data are not supported; write them uncompressed"
            self.refuse(why)
        for key in ("major frame offsets", "minor frame offsets"):
            if re.search("[1-9]", self.text(key, "")):
                self.refuse(f"{key}: bytes between lines are not supported; write the data without")
        if self.text("file type", "").lower() == "envi classification":
            self.refuse("file type = ENVI Classification: classes have no spectra")

    def dtype(self) -> tuple[np.dtype, list[str]]:
        """Return the type of the samples with their byte order, and notes."""
        code = self.whole("data type")
        if code in COMPLEX:
            self.refuse(f"data type = {code}: complex numbers; wanted real numbers")
        if code not in TYPES:
            self.refuse(f"data type = {code}: wanted one of {', '.join(map(str, TYPES))}")
        order = self.whole("byte order", 0, least=0)
        if order > 1:
            self.refuse(f"byte order = {order}: wanted 0 (the least significant byte first) or 1")
        dtype = np.dtype("<>"[order] + TYPES[code])
        is_said = "byte order" in self.fields or dtype.itemsize == 1
        notes = (
            [] if is_said else ["byte order is missing: taken as 0, least significant byte first"]
        )
        return dtype, notes

    def kind(self) -> str:
        """Return the kind of the samples according to the header."""
        of_reflectance = {"reflectance scale factor", "data reflectance gain values"}
        is_radiance = "data gain values" in self.fields and not of_reflectance & self.fields.keys()
        return "radiance" if is_radiance else "reflectance"

    def gains(self, kind, count):
        """Return gains and offsets of each band, or None."""
        quantity = "data" if kind == "radiance" else "data reflectance"
        keys = [f"{quantity} gain values", f"{quantity} offset values"]
        return [self.numbers(key, count) if key in self.fields else None for key in keys]

    def scale(self, kind, dtype, has_gains) -> float:
        """Return the number that stands for 1 after the gains; for radiance [W m-2 sr-1 nm-1]."""
        if kind == "reflectance" and "reflectance scale factor" in self.fields:
            scale = self.number("reflectance scale factor")
            if not 1e-30 <= scale <= 1e30:
                why = f"reflectance scale factor = {scale:g}: wanted the number that stands for 1"
                self.refuse(why)
            return scale
        if has_gains:
            return PER_NM if kind == "radiance" else 1.0
        if dtype.kind != "f":
            self.refuse(f"{kind} in whole numbers without a factor in the header; {SAY_SCALE}")
        return 1.0

    def ignored_value(self, dtype):
        """Return the stored number of samples without data, possibly NaN; None if there is none."""
        text = self.text("data ignore value", "")
        if not text:
            return None
        if dtype.kind == "f":
            with np.errstate(over="ignore"):
                return dtype.type(self.number("data ignore value"))
        is_whole = re.fullmatch(r"[+-]?\d{1,20}", text)
        value = int(text) if is_whole else self.number("data ignore value")
        limits = np.iinfo(dtype)
        if value == value and limits.min <= value <= limits.max and (value == int(value)):
            return dtype.type(int(value))
        return None


def _wavelengths(header, own, count):
    """Return wavelengths [nm] of all bands, a mask of good bands, and notes."""
    path, notes = header.path, []
    if own is not None:
        nm = own
        header.account.ignore("wavelength", "wavelength units")
        if len(nm) != count:
            allowed = f"{count}, one for each band of {path}"
            raise OutOfRange("wavelengths", f"{len(nm)} numbers", allowed)
    elif "wavelength" in header.fields:
        nm = header.numbers("wavelength", count)
        unit = header.text("wavelength units", "").lower()
        if unit in NANOMETRES:
            nm = np.round(nm * NANOMETRES[unit], 6)  # 0.57 um is not exact in binary
        elif unit not in UNSAID:
            raise BadFile(
                path,
                f"wavelength units = {format_value(unit)}: wanted Nanometers or Micrometers; or "
                f"{SAY_WAVELENGTHS}",
            )
        elif nm.max() < LONGEST_UM:
            nm, notes = np.round(nm * 1e3, 6), ["wavelength units are missing: taken as um"]
        else:
            notes = ["wavelength units are missing: taken as nm"]
    else:
        raise BadFile(path, f"the header has no wavelengths; {SAY_WAVELENGTHS}")
    good = np.ones(count, bool)
    if "bbl" in header.fields:
        good = header.numbers("bbl", count) != 0
        if not good.all():
            notes.append(f"bands marked bad by bbl are left out: {count - good.sum()} of {count}")
    used = np.sort(nm[good])
    if not len(used) or not (np.diff(used) > 0).all():
        raise BadFile(
            path,
            f"wavelengths of {len(used)} bands, only {len(np.unique(used))} different; wanted 1 or "
            "more, all different",
        )
    if not SHORTEST <= used[0] <= used[-1] <= LONGEST:
        why = f"wavelengths {used[0]:.6g} .. {used[-1]:.6g} nm are not plausible; {SAY_WAVELENGTHS}"
        raise BadFile(path, why)
    return nm, good, notes


def data_files(path) -> dict[Path, int]:
    """Return the files next to a header that could be its data, with their sizes [byte]."""
    base = path.with_suffix("")
    found: dict[tuple[int, int], tuple[Path, int]] = {}
    for ending in (*DATA, *map(str.upper, DATA)):
        other = base.with_name(base.name + ending)
        try:
            status = os.stat(other)
        except (OSError, ValueError):
            continue
        if not other.is_dir() and other != path:
            found.setdefault((status.st_dev, status.st_ino), (other, status.st_size))
    return dict(found.values())


def _data_file(path, wanted):
    """Return the data file next to a header: its name without .hdr, or with another suffix."""
    found = data_files(path)
    fitting = [file for file, size in found.items() if size == wanted] or list(found)
    if not fitting:
        others = ", ".join(DATA[1:])
        base = path.with_suffix("").name
        raise BadFile(
            path, f"no data file next to it: wanted {base}, or this name with one of {others}"
        )
    if len(fitting) > 1:
        names = ", ".join(file.name for file in fitting)
        raise BadFile(
            path,
            f"several data files next to it: {names}; keep one, or name the header "
            f"{fitting[0].name}.hdr",
        )
    return fitting[0]
