"""Kinds of scene files: who reads each, by its suffix, and the options of `open_scene` that it takes."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.domain.content import Cube
from gpusim.domain.errors import BadFile, OutOfRange, UnknownName, shown
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import LIGHT_SPEED, PLANCK
from gpusim.io.depth import axial
from gpusim.io.exr import read_exr
from gpusim.io.files import named
from gpusim.io.npz import read_npz
from gpusim.io.photo import lift, read_photo
from gpusim.io.scene_exr import scene_parts
from gpusim.io.tiff import SUFFIXES as TIFF
from gpusim.io.tiff import read_stack

KINDS = ("reflectance", "radiance")


@dataclass(frozen=True)
class Reader:
    """A kind of scene files.

    read: function (path, white, **options) that returns the Scene; `white` is the radiance of white [photon s-1 m-2
        sr-1 nm-1] where the file does not know its light. It gets the options that are given, no others.
    options: names of those of `open_scene` that it takes; others are refused. `depth` is two: "ray", of which the
        value is the field of view [rad], and "no_depth", which is not refused where files have no depth.
    """

    read: Callable[..., Scene]
    options: tuple[str, ...] = ()


def taken(name, options: tuple[str, ...], given: dict) -> dict:
    """What a chart, or a file of a kind, gets of the options {name: value} that are given.

    name: the chart's or the file's. options: those that it takes. Raises OutOfRange for another.
    """
    for option, value in given.items():
        if option not in (*options, "no_depth"):
            takers = (["charts"] if option in CHARTS_TAKE else []) + [
                suffix for suffix, reader in READERS.items() if option in reader.options]
            key, value = ("depth", '"ray"') if option == "ray" else (option, shown(value))
            raise OutOfRange(key, value, f"for {', '.join(takers)} only, not for {name}")
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


def _photo(path, white):
    content = read_photo(path)
    with named(path):
        return Scene(content, white, name=path.stem)


def _tiff(path, white, wavelengths=None, kind=None):
    if wavelengths is not None:
        wavelengths = checked_wavelengths(wavelengths)
        return of_planes(path, white, wavelengths, read_stack(path, len(wavelengths)), checked_kind(kind))
    if kind is not None:
        raise OutOfRange("kind", kind, "with wavelengths only")
    return _photo(path, white)


def checked_wavelengths(wavelengths) -> np.ndarray:
    """What a user says of planes [nm], as float64 (L,). Raises OutOfRange."""
    try:
        wavelengths = np.asarray(wavelengths, np.float64)
    except (TypeError, ValueError):
        wavelengths = np.empty((0, 0))
    if wavelengths.ndim != 1 or len(wavelengths) < 2 or not (np.diff(wavelengths, prepend=0) > 0).all() or not (
            wavelengths[-1] < np.inf):
        raise OutOfRange("wavelengths", wavelengths.tolist(), "2 or more [nm], positive and strictly ascending")
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
    illuminated = white
    if kind == "radiance":
        values *= (wavelengths * 1e-9 / (PLANCK * LIGHT_SPEED))[:, None, None].astype(np.float32)
        illuminated = unit_light(wavelengths)
    with named(path):
        return Scene(Cube(wavelengths, values), illuminated, name=path.stem, notes=tuple(notes))


CHARTS_TAKE = ("size",)
READERS = {".exr": Reader(_exr, ("bands", "ray", "no_depth")), ".npz": Reader(_npz, ("no_depth",)),
           **dict.fromkeys((".png", ".jpg", ".jpeg"), Reader(_photo)),
           **dict.fromkeys(TIFF, Reader(_tiff, ("wavelengths", "kind")))}
SUFFIXES = tuple(READERS)
