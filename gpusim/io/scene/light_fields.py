"""Light fields as NumPy archives, and as folders of numbered OpenEXR files.

An archive has the keys of a scene's archive (`gpusim.io.scene.npz`), and

    views                  (2,) rows and columns of views
    radius_m, object_distance_m, light_field_name   as in LightField
    view_JJ_II.KEY         key of view (J, I), if it differs from the key without prefix
    view_JJ_II.layer_N.KEY samples, `alpha` and `depth_m` of layer N of the view, the nearest first

A folder has one file for each view, view_JJ_II.exr, with rows and columns from 0 or from 1, and may have
light_field.json with radius_m and object_distance_m, which `save_light_field` writes.
"""

import json
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, BadFile, Conflict, OutOfRange, UnknownName, checked_count
from gpusim.domain.light_field import LightField, name_missing
from gpusim.domain.memory import require_memory
from gpusim.domain.progress import announce_each
from gpusim.domain.scene import Layer
from gpusim.domain.spectrum import Spectrum
from gpusim.io.archive import ArchivePart, open_archive, write_archive
from gpusim.io.atomic import atomic_path
from gpusim.io.files import name_in_errors, open_file, reading
from gpusim.io.scene.npz import COPIES, FORMS, SceneArchive, check_whole, scene_arrays
from gpusim.io.scene.scene_exr import write_scene_exr
from gpusim.io.scene.scenes import open_scene

SIDECAR = "light_field.json"
PAIR = re.compile(r"(\d{1,6})[_,x-](\d{1,6})$")  # row and column at the end of a file's name
COUNT = re.compile(r"(\d{1,9})$")
NUMBERS = ("radius_m", "object_distance_m")


def open_light_field(
    path: str | os.PathLike,
    *,
    views: Sequence[int] | None = None,
    radius: float | None = None,
    object_distance: float | None = None,
    **options: Any,
) -> LightField:
    """Open a light field: an .npz, a folder of numbered .exr files, or a pattern with * of their names.

    Names of .exr files end with the row and the column of the view, such as view_03_05.exr, from 0 or
    from 1, or with one number, row by row, if `views` is given.

    Args:
        path: Path of the archive or the folder, or a pattern such as "renders/view_*.exr".
        views: Rows and columns of views, for files that have one number; for others a check.
        radius: Half the side of the grid in the entrance pupil [m], for .exr files without
            light_field.json.
        object_distance: Distance of things that coincide in all views [m], also for .exr files;
            None: infinity, cameras of one direction whose pictures are not displaced.
        options: Options of `open_scene` for each .exr file.

    Returns:
        The light field.

    Raises:
        BadFile: A file is missing, superfluous or damaged.
        BadData: Views differ in shape, wavelengths or light.
        Conflict: An option does not fit the kind of file.
        OutOfRange: A number is out of its range, or the radius of .exr files is not known.
        DoesNotFit: The views do not fit into memory.
    """
    if not isinstance(path, str | os.PathLike):
        kind = type(path).__name__
        raise BadData(f"light field: {kind}, wanted a path of an .npz or of .exr files")
    given = {"views": views, "radius": radius, "object_distance": object_distance, **options}
    if Path(path).suffix.lower() == ".npz":
        for name, value in given.items():
            if value is not None:
                reason = f"{path} has its own"
                raise Conflict(name, reason, "leave it out, or open a folder of .exr files")
        return _read_archive(path)
    folder, files = _find_files(path)
    numbered = _number(path, files, None if views is None else _checked_views(views))
    stored = _read_sidecar(folder / SIDECAR)
    if radius is None and "radius_m" not in stored:
        raise OutOfRange("radius", None, f"a length [m]: {folder} has no {SIDECAR}")
    radius = stored["radius_m"] if radius is None else radius
    if object_distance is None:
        object_distance = stored.get("object_distance_m", np.inf)
    opened = announce_each(
        (_open_view(file, len(files), options) for row in numbered for file in row),
        lambda done: f"view {done + 1} of {len(files)}",
    )
    width = len(numbered[0])
    scenes = list(opened)
    rows = tuple(tuple(scenes[j : j + width]) for j in range(0, len(scenes), width))
    name = str(stored.get("name", folder.absolute().name))
    return LightField(rows, radius, object_distance, name)


def save_light_field(
    light_field: LightField,
    path: str | os.PathLike,
    *,
    radiance: bool = False,
    half: bool = False,
) -> None:
    """Write a light field for `open_light_field`.

    An .npz holds the complete light field. A path without suffix is a folder, new or without .exr
    files, for view_00_00.exr and so on, spectral OpenEXR files as `save_scene` writes them, and
    light_field.json with the radius and the object distance.

    Args:
        light_field: The light field.
        path: The archive or the folder.
        radiance: As for `save_scene`, folders only.
        half: As for `save_scene`, folders only.

    Raises:
        BadData: `light_field` is no LightField.
        BadFile: A file cannot be written, or cannot hold a view: layers in .exr files.
        OutOfRange: `radiance` or `half` is set for an .npz.
        UnknownName: The suffix is unknown.
        DoesNotFit: A cube does not fit into memory.
    """
    if not isinstance(light_field, LightField):
        raise BadData(f"light field: {type(light_field).__name__}, wanted a LightField")
    folder = Path(path)
    if folder.suffix.lower() == ".npz":
        for name, is_set in {"radiance": radiance, "half": half}.items():
            if is_set:
                raise OutOfRange(name, True, "not for .npz, which holds the complete light field")
        write_archive(path, _arrays(path, light_field))
        return
    if folder.suffix:
        raise UnknownName("format of a light field's file", folder.suffix, (".npz", "a folder"))
    if folder.is_dir() and any(folder.glob("*.exr")):
        raise BadFile(folder, "has .exr files already; wanted a new folder")
    views = [
        (folder / f"{_view_name(j, i)}.exr", view)
        for j, row in enumerate(light_field.views)
        for i, view in enumerate(row)
    ]
    for file, view in views:
        if view.layers:
            why = f"{len(view.layers)} layers, which an .exr cannot hold; save an .npz"
            raise BadFile(file, why)
    for file, view in announce_each(views, lambda done: f"view {done + 1} of {len(views)}"):
        write_scene_exr(file, view, radiance=radiance, half=half)
    with atomic_path(folder / SIDECAR) as temporary:
        distance = float(light_field.object_distance)
        stored = {"name": light_field.name, "radius_m": float(light_field.radius)}
        stored["object_distance_m"] = distance if np.isfinite(distance) else "inf"
        Path(temporary).write_text(json.dumps(stored))


def _view_name(j, i):
    """Return the name of a view in files."""
    return f"view_{j:02d}_{i:02d}"


def _arrays(path, light_field):
    """Return the arrays of an archive by name."""
    shared: dict = {}
    arrays: dict = {}
    for j, row in enumerate(light_field.views):
        for i, view in enumerate(row):
            check_whole(path, replace(view, layers=()))
            own, prefix = scene_arrays(view), f"{_view_name(j, i)}."
            if not shared:
                samples = (*view.content.on_host().samples, *FORMS, "depth_m")
                shared = {
                    key: value
                    for key, value in own.items()
                    if key not in samples and not key.startswith("label_")
                }
            arrays |= {
                prefix + key: value
                for key, value in own.items()
                if key not in shared or not np.array_equal(value, shared[key])
            }
            for number, layer in enumerate(view.layers):
                part = f"{prefix}layer_{number}."
                content = replace(view, content=layer.content, depth=None, layers=(), labels={})
                arrays |= {
                    part + key: value
                    for key, value in scene_arrays(content).items()
                    if key not in shared
                }
                arrays[f"{part}alpha"] = layer.alpha
                arrays[f"{part}depth_m"] = layer.depth
    return {
        **shared,
        "views": light_field.shape,
        "radius_m": light_field.radius,
        "object_distance_m": light_field.object_distance,
        "light_field_name": light_field.name,
        **arrays,
    }


def _read_archive(path):
    """Return the light field of an archive. Raises BadFile, DoesNotFit."""
    with open_archive(path) as stored, name_in_errors(path):
        stored.require(("views", *NUMBERS))
        stored.require_memory(COPIES)
        whole = SceneArchive(Path(path), stored)
        shape = _checked_views(whole.array("views", 2).tolist())
        names = {name.partition(".")[0] for name in stored if name.startswith("view_")}
        wanted = [(j, i) for j in range(shape[0]) for i in range(shape[1])]
        missing = [place for place in wanted if _view_name(*place) not in names]
        if missing:
            raise BadFile(path, name_missing(missing, shape))
        extra = sorted(names - {_view_name(*place) for place in wanted})
        if extra:
            raise BadFile(path, f"{extra[0]} is outside its {shape[0]} x {shape[1]} views")
        parts = announce_each(wanted, lambda done: f"view {done + 1} of {len(wanted)}")
        scenes = [_read_view(path, ArchivePart(stored, f"{_view_name(*one)}.")) for one in parts]
        name = whole.single("light_field_name", Path(path).stem)
        radius, distance = (whole.single(key, 0.0) for key in NUMBERS)
        notes = stored.notes()
        if notes:
            scenes = [replace(scene, notes=scene.notes + notes) for scene in scenes]
        rows = tuple(tuple(scenes[j * shape[1] : (j + 1) * shape[1]]) for j in range(shape[0]))
        return LightField(rows, radius, distance, name)


def _read_view(path, stored):
    """Return the scene of a part of an archive, with its layers."""
    scene = SceneArchive(path, stored).scene(Spectrum(np.array([400.0, 700.0]), np.ones(2)))
    layers = []
    while True:
        part = ArchivePart(stored, f"layer_{len(layers)}.")
        if not part.has_own("alpha"):
            return replace(scene, layers=tuple(layers)) if layers else scene
        held = SceneArchive(path, part)
        form = next(key for key in FORMS if key in part)
        if not (part.has_own(form) and part.has_own("depth_m")):
            raise BadFile(path, f"{stored.prefix}layer_{len(layers)} lacks {form} or depth_m")
        depth = part["depth_m"] if part.shape("depth_m") else held.single("depth_m", 0.0)
        alpha = held.planes("alpha", *scene.content.shape)
        layers.append(Layer(held.content(form, scene.wavelengths), alpha, depth))


def _checked_views(views):
    """Return rows and columns of views. Raises BadData, OutOfRange."""
    if not isinstance(views, Sequence) or len(views) != 2:
        raise BadData(f"views = {views!r}: wanted two numbers, rows and columns of views")
    rows, cols = (checked_count("views", one, most=10_000) for one in views)
    return rows, cols


def _find_files(path):
    """Return the folder and the .exr files of a folder or pattern. Raises BadFile."""
    path = Path(path)
    if "*" in path.name:
        folder, pattern = path.parent, path.name
    else:
        folder, pattern = path, "*"
    if not folder.is_dir():
        raise BadFile(path, "no such folder; wanted an .npz, or a folder or pattern of .exr files")
    found = (file for file in folder.glob(pattern) if file.suffix.lower() == ".exr")
    files = sorted(file for file in found if not file.name.startswith("."))
    if not files:
        raise BadFile(path, "no .exr files")
    return folder, files


def _number(path, files, views):
    """Return rows of files in the order of their numbers. Raises BadFile for missing and extra ones."""
    found: dict[tuple[int, int], Path] = {}
    rule = PAIR if any(PAIR.search(file.stem) for file in files) else COUNT
    if rule is COUNT and views is None:
        why = "its name has no row and column as view_03_05.exr has; give views=(rows, columns)"
        raise BadFile(files[0], why)
    places = []
    for file in files:
        match = rule.search(file.stem)
        if match is None:
            raise BadFile(file, "no view: its name does not end with numbers as others do")
        places.append(tuple(int(number) for number in match.groups()))
    first = [min(1, *axis) for axis in zip(*places, strict=True)]
    for file, numbers in zip(files, places, strict=True):
        place = tuple(number - low for number, low in zip(numbers, first, strict=True))
        if rule is COUNT:
            place = divmod(place[0], views[1])
        if place in found:
            raise BadFile(file, f"the same view as {found[place].name}")
        found[place] = file
    shape = views or tuple(1 + max(axis) for axis in zip(*found, strict=True))
    missing = [(j, i) for j in range(shape[0]) for i in range(shape[1]) if (j, i) not in found]
    extra = [
        found[place] for place in sorted(found) if place[0] >= shape[0] or place[1] >= shape[1]
    ]
    if extra:
        raise BadFile(extra[0], f"outside the {shape[0]} x {shape[1]} views")
    if missing:
        raise BadFile(path, name_missing(missing, shape))
    return [[found[j, i] for i in range(shape[1])] for j in range(shape[0])]


def _open_view(file, count, options):
    """Return the scene of one of `count` files."""
    scene = open_scene(file, **options)
    if options.get("luminance") is not None and not scene.light_is_known:
        reason = "each view would be scaled to this mean luminance"
        raise Conflict("luminance", reason, "leave it out, and use LightField's scenes as they are")
    require_memory(f"{count} views like {file}", (count - 1) * scene.content.nbytes)
    return scene


def _read_sidecar(path):
    """Return the numbers of a folder's description, {} if there is none. Raises BadFile."""
    if not path.exists():
        return {}
    with open_file(path) as file, reading(path, "a light field's description"):
        stored = json.loads(file.read(2**16))
        return {"name": str(stored["name"])} | {key: float(stored[key]) for key in NUMBERS}
