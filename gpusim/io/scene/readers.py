"""Kinds of scene files: the reader of each suffix, and its options of `open_scene`."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.data.colorimetry import xyz
from gpusim.domain.content import Cube
from gpusim.domain.errors import (
    LONGEST_PATH,
    BadFile,
    OutOfRange,
    UnknownName,
    format_value,
    one_line,
)
from gpusim.domain.scene import PANORAMA, Scene, unit_light
from gpusim.domain.spectrum import Spectrum, energy_from_photons, energy_per_photon
from gpusim.io.exr import read_exr
from gpusim.io.files import name_in_errors
from gpusim.io.scene.bands import read_bands
from gpusim.io.scene.cubes import read_cube
from gpusim.io.scene.depth import axial_depth
from gpusim.io.scene.envi import read_envi
from gpusim.io.scene.hdf5 import SUFFIXES as HDF5
from gpusim.io.scene.hdf5 import open_hdf5
from gpusim.io.scene.iset import is_iset, read_iset
from gpusim.io.scene.mat import open_mat
from gpusim.io.scene.npy import read_npy
from gpusim.io.scene.npz import read_npz
from gpusim.io.scene.photo import lift, read_photo
from gpusim.io.scene.scene_exr import scene_parts
from gpusim.io.scene.scene_planes import scene_of_header, scene_of_tiff
from gpusim.io.scene.spectra import patches, read_spectra
from gpusim.io.scene.stacks import check_reflectances, checked_scale, cut_noise
from gpusim.io.scene.tiff import SUFFIXES as TIFF
from gpusim.io.scene.tiff import read_stack

KINDS = ("reflectance", "radiance")


@dataclass(frozen=True)
class Reader:
    """A kind of scene files.

    read: function (path, white, **options) that returns the Scene; `white` is the radiance of white
    [photon s-1 m-2 sr-1 nm-1] if the file has no light. It gets only the given options. options:
    names of the options of `open_scene` that it accepts; others are refused. `depth` is split into
    two: "ray", with the field of view as value [rad], and "no_depth", which files without depth
    ignore. in_folders: whether such files in a folder are scenes; tables of numbers next to
    pictures are not.
    """

    read: Callable[..., Scene]
    options: tuple[str, ...] = ()
    in_folders: bool = True


def select_options(name, options: tuple[str, ...], given: dict) -> dict:
    """Return the given options {name: value} that a chart or a kind of file accepts.

    name: name of the chart or file. options: names that it accepts. Raises OutOfRange for others.
    """
    for option, value in given.items():
        if option not in (*options, "no_depth"):
            takers = (["charts"] if option in CHARTS_TAKE else []) + [
                suffix for suffix, reader in READERS.items() if option in reader.options
            ]
            key, value = ("depth", '"ray"') if option == "ray" else (option, format_value(value))
            allowed = f"for {', '.join(takers)} only, not for {one_line(name, LONGEST_PATH)}"
            raise OutOfRange(key, value, allowed)
    return {option: value for option, value in given.items() if option in options}


def read_scene(path: Path, white, given: dict) -> Scene:
    """Return the scene of a file with a suffix in READERS; given: options {name: value}.

    Raises BadFile, UnknownName, OutOfRange, DoesNotFit.
    """
    reader = READERS[path.suffix.lower()]
    return reader.read(path, white, **select_options(path, reader.options, given))


def _exr(path, white, bands=None, ray=None, no_depth=False, **choices):
    held = read_exr(path, bands, depth=not no_depth, **choices)
    if ray and held.depth is None:
        raise BadFile(path, 'depth = "ray", but there is no channel of depth')
    is_picture = held.wavelengths is None
    content = lift(held.values) if is_picture else Cube(held.wavelengths, held.values)
    parts, notes = (
        {"name": path.stem, "illuminant": _at(white, held.white)} | scene_parts(path),
        held.notes,
    )
    if held.kind == "radiance":
        parts["illuminant"] = unit_light(held.wavelengths)
    if held.is_panorama:
        parts["projection"] = PANORAMA
    if held.depth is not None:
        parts["depth"] = axial_depth(
            path, held.depth_channel, held.depth, "ray" if ray else "axis", ray
        )
        how = "along each pixel's ray" if ray else "along the optical axis"
        notes = (*notes, f"depth: channel {held.depth_channel!r}, taken as metres {how}")
    with name_in_errors(path):
        return Scene(content, **parts, notes=notes, labels=held.labels)


def _npz(path, white, no_depth=False):
    scene = read_npz(path, white)
    return dataclasses.replace(scene, depth=None) if no_depth else scene


def _mat(path, white, key=None, ray=None, no_depth=False, **planes):
    with open_mat(path) as root:
        if not planes or (key is None and is_iset(path, root)):
            for name, value in planes.items():
                allowed = f"not for scenes of ISETCam such as {path}; or give key= of an array"
                raise OutOfRange(name, format_value(value), allowed)
            scene = read_iset(path, root, key, ray, no_depth)
            if scene is not None:
                return scene
        if ray is not None:
            raise OutOfRange("depth", '"ray"', f"for scenes of ISETCam only, not for {path}")
        return _cube(path, white, root, key, **planes)


def _hdf5(path, white, key=None, **planes):
    with open_hdf5(path) as root:
        return _cube(path, white, root, key, **planes)


def read_folder(path: Path, white, given: dict) -> Scene:
    """Return the scene of a folder of bands; given: options {name: value}.

    Raises BadFile, UnknownName, OutOfRange, DoesNotFit.
    """
    options = select_options(path, PLANES, given)
    nm, kind, scale = (options.get(name) for name in PLANES)
    nm = None if nm is None else checked_wavelengths(nm)
    kind, scale = checked_kind(kind), checked_scale(scale)
    nm, values, notes = read_bands(path, nm, scale)
    if kind == "reflectance" and scale is None:
        check_reflectances(path, values)
    return scene_of_planes(path, white, nm, values, kind, notes)


def _cube(path, white, root, key, wavelengths=None, kind=None, scale=None):
    wavelengths = None if wavelengths is None else checked_wavelengths(wavelengths)
    held = read_cube(
        path, root, key, wavelengths, kind and checked_kind(kind), checked_scale(scale)
    )
    return scene_of_planes(path, white, held.wavelengths, held.values, held.kind, held.notes)


def _photo(path, white, part=None):
    content, own, notes = read_photo(path, part)
    with name_in_errors(path):
        return Scene(content, _at(white, own), name=path.stem, notes=notes)


def _at(white: Spectrum, luminance: float | None) -> Spectrum:
    """Return the light of white at the luminance that a file says [cd/m2], if it does."""
    if luminance is None:
        return white
    return white.scale(luminance / xyz(energy_from_photons(white))[1])


def _tiff(path, white, wavelengths=None, kind=None, scale=None, part=None):
    is_asked = any(one is not None for one in (wavelengths, kind, scale, part))
    own = None if is_asked else scene_of_tiff(path)
    if own is not None:
        wavelengths, kind, parts = checked_wavelengths(own[0]), checked_kind(own[1]), own[2]
        values, notes = read_stack(path, len(wavelengths), 1.0)
        scene = scene_of_planes(path, white, wavelengths, values, kind, notes)
        return _with_parts(path, scene, parts)
    if wavelengths is not None:
        if part is not None:
            raise OutOfRange("part", part, "without wavelengths only: planes are all pages")
        wavelengths, kind, scale = (
            checked_wavelengths(wavelengths),
            checked_kind(kind),
            checked_scale(scale),
        )
        values, notes = read_stack(path, len(wavelengths), scale)
        if kind == "reflectance" and scale is None:
            check_reflectances(path, values)
        return scene_of_planes(path, white, wavelengths, values, kind, notes)
    if kind is not None or scale is not None:
        name, value = ("scale", scale) if kind is None else ("kind", kind)
        raise OutOfRange(name, value, "with wavelengths only")
    return _photo(path, white, part)


def _envi(path, white, wavelengths=None, kind=None, scale=None, size=None):
    wavelengths = None if wavelengths is None else checked_wavelengths(wavelengths)
    held = read_envi(path, wavelengths, kind and checked_kind(kind), checked_scale(scale))
    if held.values.ndim == 2:
        return scene_of_spectra(
            path, white, held.wavelengths, held.values.T, held.kind, size, held.notes
        )
    if size is not None:
        allowed = f"for charts and libraries of spectra; {path} has its own size"
        raise OutOfRange("size", format_value(size), allowed)
    scene = scene_of_planes(path, white, held.wavelengths, held.values, held.kind, held.notes)
    is_own = held.kind == "reflectance" or kind is None
    parts = scene_of_header(path, held.scene) if is_own else {}
    return _with_parts(path, scene, parts)


def _with_parts(path, scene, parts):
    """Return a scene with the fields that a file of gpusim's own has."""
    with name_in_errors(path):
        return dataclasses.replace(scene, **parts)


def _npy(path, white, wavelengths=None, kind=None, scale=None):
    if wavelengths is None:
        why = "an array has no wavelengths; give them [nm], for example --wavelengths 400:700:10"
        raise BadFile(path, why)
    wavelengths = checked_wavelengths(wavelengths)
    kind = checked_kind(kind)
    scale = checked_scale(scale)
    values, notes = read_npy(path, len(wavelengths), scale)
    if kind == "reflectance" and scale is None:
        check_reflectances(path, values)
    return scene_of_planes(path, white, wavelengths, values, kind, notes)


def _csv(path, white, kind=None, scale=None, size=None):
    kind, scale = checked_kind(kind), checked_scale(scale)
    wavelengths, spectra = read_spectra(path, scale is not None, kind == "radiance")
    with np.errstate(over="ignore"):
        spectra = spectra / (scale or 1.0)
    notes = cut_noise(path, spectra)
    if kind == "reflectance" and scale is None:
        check_reflectances(path, spectra)
    return scene_of_spectra(path, white, wavelengths, spectra, kind, size, notes)


def checked_wavelengths(wavelengths) -> np.ndarray:
    """Return a user's wavelengths [nm] as float64 (L,). Raises OutOfRange."""
    try:
        wavelengths = np.asarray(wavelengths, np.float64)
    except (TypeError, ValueError):
        wavelengths = np.empty((0, 0))
    is_list = wavelengths.ndim == 1 and len(wavelengths) > 0
    rises = is_list and (np.diff(wavelengths, prepend=0) > 0).all()
    if not (rises and wavelengths[-1] < np.inf):
        allowed = "1 or more [nm], positive and strictly ascending"
        raise OutOfRange("wavelengths", wavelengths.tolist(), allowed)
    return wavelengths


def checked_kind(kind: str | None) -> str:
    """Return a user's kind of planes, one of KINDS; reflectance if None. Raises UnknownName."""
    if kind not in (None, *KINDS):
        raise UnknownName("kind of planes", one_line(kind), KINDS)
    return kind or KINDS[0]


def scene_of_planes(path, white, wavelengths, values, kind, notes=()) -> Scene:
    """Return a scene of planes, float32 (L, rows, cols), which may be overwritten.

    kind: reflectances [1] in the light of `white`, or radiance [W m-2 sr-1 nm-1]. Raises BadFile,
    naming the file.
    """
    if kind == "radiance":
        values *= (1 / energy_per_photon(wavelengths))[:, None, None].astype(np.float32)
        white = unit_light(wavelengths)
    with name_in_errors(path):
        return Scene(Cube(wavelengths, values), white, name=path.stem, notes=tuple(notes))


def scene_of_spectra(path, white, wavelengths, spectra, kind, size, notes=()) -> Scene:
    """Return a scene of patches that show spectra, shape (spectra, L).

    kind and errors: see `scene_of_planes`; size: see `patches`.
    """
    if kind == "radiance":
        spectra, white = spectra / energy_per_photon(wavelengths), unit_light(wavelengths)
    return patches(path, wavelengths, np.asarray(spectra, np.float64), white, size, notes)


CHARTS_TAKE = ("size",)
PLANES = ("wavelengths", "kind", "scale")
READERS = {
    ".exr": Reader(_exr, ("bands", "ray", "no_depth", "part", "layer", "view")),
    ".npz": Reader(_npz, ("no_depth",)),
    ".mat": Reader(_mat, ("ray", "no_depth", "key", *PLANES)),
    **dict.fromkeys(HDF5, Reader(_hdf5, ("key", *PLANES))),
    **dict.fromkeys((".png", ".jpg", ".jpeg"), Reader(_photo)),
    **dict.fromkeys(TIFF, Reader(_tiff, (*PLANES, "part"))),
    ".hdr": Reader(_envi, (*PLANES, "size")),
    ".npy": Reader(_npy, PLANES),
    ".csv": Reader(_csv, ("kind", "scale", "size"), in_folders=False),
}
SUFFIXES = tuple(READERS)
IN_FOLDERS = tuple(suffix for suffix, reader in READERS.items() if reader.in_folders)


def scene_files(folder: Path) -> list[Path]:
    """Return a folder's scene files in the order of their names, without hidden files."""
    found = (path for path in folder.iterdir() if path.suffix.lower() in IN_FOLDERS)
    return sorted(path for path in found if not path.name.startswith(".") and path.is_file())
