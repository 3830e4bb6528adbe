"""Kinds of scene files: who reads each, by its suffix, and the options of `open_scene` that it takes."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.domain.content import Cube
from gpusim.domain.errors import LONGEST_PATH, BadFile, OutOfRange, UnknownName, one_line, shown
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.exr import read_exr
from gpusim.io.files import named
from gpusim.io.scene.depth import axial
from gpusim.io.scene.envi import read_envi
from gpusim.io.scene.iset import read_iset
from gpusim.io.scene.npy import read_npy
from gpusim.io.scene.npz import read_npz
from gpusim.io.scene.photo import damage, lift, read_photo
from gpusim.io.scene.scene_exr import scene_parts
from gpusim.io.scene.spectra import patches, read_spectra
from gpusim.io.scene.stacks import check_reflectances, checked_scale, cut_noise
from gpusim.io.scene.tiff import SUFFIXES as TIFF
from gpusim.io.scene.tiff import read_stack

KINDS = ("reflectance", "radiance")


@dataclass(frozen=True)
class Reader:
    """A kind of scene files.

    read: function (path, white, **options) that returns the Scene; `white` is the radiance of white [photon s-1 m-2
        sr-1 nm-1] where the file does not know its light. It gets the options that are given, no others.
    options: names of those of `open_scene` that it takes; others are refused. `depth` is two: "ray", of which the
        value is the field of view [rad], and "no_depth", which is not refused where files have no depth.
    in_folders: whether such files of a folder are scenes; tables of numbers beside pictures are not.
    """

    read: Callable[..., Scene]
    options: tuple[str, ...] = ()
    in_folders: bool = True


def taken(name, options: tuple[str, ...], given: dict) -> dict:
    """What a chart, or a file of a kind, gets of the options {name: value} that are given.

    name: the chart's or the file's. options: those that it takes. Raises OutOfRange for another.
    """
    for option, value in given.items():
        if option not in (*options, "no_depth"):
            takers = (["charts"] if option in CHARTS_TAKE else []) + [
                suffix for suffix, reader in READERS.items() if option in reader.options
            ]
            key, value = ("depth", '"ray"') if option == "ray" else (option, shown(value))
            raise OutOfRange(
                key, value, f"for {', '.join(takers)} only, not for {one_line(name, LONGEST_PATH)}"
            )
    return {option: value for option, value in given.items() if option in options}


def read_scene(path: Path, white, given: dict) -> Scene:
    """The scene of a file whose suffix is in READERS, with the options {name: value} that are given.

    Raises BadFile, UnknownName, OutOfRange, DoesNotFit.
    """
    reader = READERS[path.suffix.lower()]
    return reader.read(path, white, **taken(path, reader.options, given))


def _exr(path, white, bands=None, ray=None, no_depth=False):
    held = read_exr(path, bands, depth=not no_depth)
    if ray and held.depth is None:
        raise BadFile(path, 'no channel of depth, which is asked for by depth = "ray"')
    content = lift(held.values) if held.kind == "rgb" else Cube(held.wavelengths, held.values)
    parts, notes = {"name": path.stem, "illuminant": white} | scene_parts(path), held.notes
    if held.kind == "radiance":
        parts["illuminant"] = unit_light(held.wavelengths)
    if held.depth is not None:
        parts["depth"] = axial(path, held.depth_channel, held.depth, "ray" if ray else "axis", ray)
        how = "along each pixel's ray" if ray else "along the optical axis"
        notes = (*notes, f"depth: channel {held.depth_channel!r}, taken as metres {how}")
    with named(path):
        return Scene(content, **parts, notes=notes)


def _npz(path, white, no_depth=False):
    scene = read_npz(path, white)
    return dataclasses.replace(scene, depth=None) if no_depth else scene


def _iset(path, white, **options):
    return read_iset(path, **options)


def _photo(path, white):
    content = read_photo(path)
    with named(path):
        return Scene(content, white, name=path.stem, notes=damage(path))


def _tiff(path, white, wavelengths=None, kind=None, scale=None):
    if wavelengths is not None:
        wavelengths = checked_wavelengths(wavelengths)
        values = read_stack(path, len(wavelengths), checked_scale(scale))
        return of_planes(path, white, wavelengths, values, checked_kind(kind))
    if kind is not None or scale is not None:
        raise OutOfRange(
            *(("scale", scale) if kind is None else ("kind", kind)), "with wavelengths only"
        )
    return _photo(path, white)


def _envi(path, white, wavelengths=None, kind=None, scale=None, size=None):
    wavelengths = None if wavelengths is None else checked_wavelengths(wavelengths)
    held = read_envi(path, wavelengths, kind and checked_kind(kind), checked_scale(scale))
    if held.values.ndim == 2:
        return of_spectra(path, white, held.wavelengths, held.values.T, held.kind, size, held.notes)
    if size is not None:
        raise OutOfRange(
            "size", shown(size), f"for charts and libraries of spectra; {path} has its own size"
        )
    return of_planes(path, white, held.wavelengths, held.values, held.kind, held.notes)


def _npy(path, white, wavelengths=None, kind=None, scale=None):
    if wavelengths is None:
        raise BadFile(
            path,
            "an array does not say its wavelengths; say them [nm], such as --wavelengths 400:700:10",
        )
    wavelengths, kind, scale = (
        checked_wavelengths(wavelengths),
        checked_kind(kind),
        checked_scale(scale),
    )
    values, notes = read_npy(path, len(wavelengths), scale)
    if kind == "reflectance" and scale is None:
        check_reflectances(path, values)
    return of_planes(path, white, wavelengths, values, kind, notes)


def _csv(path, white, kind=None, scale=None, size=None):
    kind, scale = checked_kind(kind), checked_scale(scale)
    wavelengths, spectra = read_spectra(path)
    with np.errstate(over="ignore"):
        spectra = spectra / (scale or 1.0)
    notes = cut_noise(path, spectra)
    if kind == "reflectance" and scale is None:
        check_reflectances(path, spectra)
    return of_spectra(path, white, wavelengths, spectra, kind, size, notes)


def checked_wavelengths(wavelengths) -> np.ndarray:
    """What a user says of planes [nm], as float64 (L,). Raises OutOfRange."""
    try:
        wavelengths = np.asarray(wavelengths, np.float64)
    except (TypeError, ValueError):
        wavelengths = np.empty((0, 0))
    if (
        wavelengths.ndim != 1
        or not len(wavelengths)
        or not (np.diff(wavelengths, prepend=0) > 0).all()
        or not (wavelengths[-1] < np.inf)
    ):
        raise OutOfRange(
            "wavelengths", wavelengths.tolist(), "1 or more [nm], positive and strictly ascending"
        )
    return wavelengths


def checked_kind(kind: str | None) -> str:
    """What planes hold, one of KINDS; reflectances where a user does not say. Raises UnknownName."""
    if kind not in (None, *KINDS):
        raise UnknownName("kind of planes", str(kind), KINDS)
    return kind or KINDS[0]


def of_planes(path, white, wavelengths, values, kind, notes=()) -> Scene:
    """A scene of planes, float32 (L, rows, cols), which may be written over.

    kind: reflectances [1] in the light of `white`, or radiance [W m-2 sr-1 nm-1]. Raises BadFile, naming the file.
    """
    if kind == "radiance":
        values *= (1 / energy_per_photon(wavelengths))[:, None, None].astype(np.float32)
        white = unit_light(wavelengths)
    with named(path):
        return Scene(Cube(wavelengths, values), white, name=path.stem, notes=tuple(notes))


def of_spectra(path, white, wavelengths, spectra, kind, size, notes=()) -> Scene:
    """A scene of patches that show spectra, (spectra, L). kind, errors: as of `of_planes`; size: as of `patches`."""
    if kind == "radiance":
        spectra, white = spectra / energy_per_photon(wavelengths), unit_light(wavelengths)
    return patches(path, wavelengths, np.asarray(spectra, np.float64), white, size, notes)


CHARTS_TAKE = ("size",)
PLANES = ("wavelengths", "kind", "scale")
READERS = {
    ".exr": Reader(_exr, ("bands", "ray", "no_depth")),
    ".npz": Reader(_npz, ("no_depth",)),
    ".mat": Reader(_iset, ("ray", "no_depth")),
    **dict.fromkeys((".png", ".jpg", ".jpeg"), Reader(_photo)),
    **dict.fromkeys(TIFF, Reader(_tiff, PLANES)),
    ".hdr": Reader(_envi, (*PLANES, "size")),
    ".npy": Reader(_npy, PLANES),
    ".csv": Reader(_csv, ("kind", "scale", "size"), in_folders=False),
}
SUFFIXES = tuple(READERS)
IN_FOLDERS = tuple(suffix for suffix, reader in READERS.items() if reader.in_folders)


def scene_files(folder: Path) -> list[Path]:
    """Return a folder's scene files in the order of their names; hidden ones, such as temporary files, are none."""
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IN_FOLDERS and not path.name.startswith(".") and path.is_file()
    )
