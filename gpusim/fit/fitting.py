"""A camera from its own raw files: dark frames, flats, charts, edges, grids, ramps."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, BadFile, format_value
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.short_repr import short_repr
from gpusim.fit.camera_text import camera_text, spread_path
from gpusim.fit.estimate import Estimate, Part
from gpusim.fit.noise import IsoFit
from gpusim.fit.noise_part import noise_part
from gpusim.fit.optics_parts import shared_results
from gpusim.fit.parts import part_functions
from gpusim.fit.shots import Known, Shot
from gpusim.fit.sorting import Summary, check_same_camera, name_kinds, summarise
from gpusim.fit.speeds import fit_isos
from gpusim.fit.steps import without_shift
from gpusim.io.atomic import atomic_path, check_output
from gpusim.io.camera.cameras import camera_of, camera_table, open_camera, override_keys
from gpusim.io.camera.psf import write_psf
from gpusim.io.raw.raw_arrays import ARRAYS
from gpusim.io.raw.raw_files import count_frames

Paths = str | os.PathLike | Iterable[str | os.PathLike]
FOLDERS = {  # names of folders whose frames are of one kind
    **{name: "dark" for name in ("dark", "darks", "bias")},
    **{name: "flat" for name in ("flat", "flats")},
    **{name: "pairs" for name in ("pair", "pairs")},
    **{name: "chart" for name in ("chart", "charts")},
    **{name: "edges" for name in ("edge", "edges")},
    **{name: "grid" for name in ("grid", "grids")},
    "shading": "shading",
    **{name: "ramp" for name in ("ramp", "ramps")},
}
ORDER = ("shading", "grid", "edges", "chart", "ramp")  # later ones use what earlier ones measured
RAW_SUFFIXES = frozenset(
    (
        *ARRAYS,
        *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".raf", ".rw2"),
        *(".orf", ".pef", ".srw", ".x3f", ".rwl", ".3fr", ".fff", ".iiq", ".mos", ".mrw", ".erf"),
        *(".kdc", ".dcr", ".raw", ".mef", ".gpr"),
    )
)


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera from its own raw files.

    Args:
        parts: Results of each kind of shots.
        base: Name or file of the camera whose values stand for unknown ones.
        name: Make and model that the files state, or None.
        lines: Lines about the shots: how many of each kind, and which were not used.
        noise: The noise by ISO speed; empty without dark frames and flats.
        failed: Lines: parts that could not be fitted, with the reason and the shots to take instead.
    """

    parts: tuple[Part, ...]
    base: str
    name: str | None = None
    lines: tuple[str, ...] = ()
    noise: tuple[IsoFit, ...] = field(default=(), repr=False)
    failed: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All estimates by camera key."""
        return {key: one for part in self.parts for key, one in part.estimates.items()}

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Lines: findings outside the model."""
        return tuple(chain.from_iterable(part.unexplained for part in self.parts))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Lines: numbers that the shots do not give, and shots that would."""
        return tuple(chain.from_iterable(part.unknown for part in self.parts))

    @property
    def settings(self) -> dict[str, dict[str, Any]]:
        """Values of the camera file by section and key."""
        found: dict[str, dict[str, Any]] = {}
        for part in self.parts:
            for section, keys in part.settings.items():
                found.setdefault(section, {}).update(keys)
        if "psf" in found.get("optics", {}):
            found["optics"].pop("lateral_color", None)  # the point spreads hold it
        return found

    @cached_property
    def camera(self) -> Camera:
        """The camera: measured values, and the base's for the rest."""
        path, table = camera_table(self.base)
        settings = self.settings
        optics = settings.get("optics", {})
        spread = optics.pop("psf", None)
        if spread is not None:
            optics.pop("model", None)
        merged = override_keys(table, {**settings, "name": self.name or "fitted"})
        camera = camera_of(path, merged)
        if spread is None:
            return camera
        plain: dict[str, Any] = {
            "pupil": Pupil(),
            "wavefront": Wavefront(),
            "defocus": 0.0,
            "lateral_color": 0.0,
        }
        plain |= {"birefringence": (0.0, 0.0), "diffuser": 0.0}
        measured = replace(camera.optics, model="measured", psf=spread, **plain)
        return replace(camera, optics=measured)

    def write(
        self, path: str | os.PathLike, page: str | os.PathLike | None = None, maps: bool = False
    ) -> list[Path]:
        """Write the camera file, its page, and maps.

        Args:
            path: Camera file, .toml.
            page: Page with fits and residuals, .html; None: next to the camera file.
            maps: Also write maps of DSNU and PRNU next to it, as .maps.npz.

        Returns:
            The files.

        Raises:
            BadFile: A file cannot be written.
            Missing: Matplotlib is not installed.
        """
        from gpusim.fit.page import fit_page

        path = Path(path)
        if path.suffix.lower() != ".toml":
            raise BadFile(path, "wanted the name of a camera file, .toml")
        page = Path(page) if page is not None else path.with_suffix(".html")
        check_output(path)
        check_output(page)
        files = [path, page]
        text, written = camera_text(self, path), fit_page(self, path.name)
        if maps:
            files.append(self._write_maps(path))
        spread = self.settings.get("optics", {}).get("psf")
        if spread is not None:
            files.append(spread_path(path))
            write_psf(files[-1], spread)
        for file, words in ((page, written), (path, text)):
            with atomic_path(file) as temporary:
                temporary.write_text(words, "utf-8")
        return files

    def _write_maps(self, path):
        """Write maps of the fixed patterns."""
        from gpusim.io.archive import write_archive

        if not self.noise:
            raise BadData("maps: no dark frames and flats; leave it out")
        arrays = {}
        for one in self.noise:
            end = f"_iso_{one.iso:g}" if len(self.noise) > 1 else ""
            arrays[f"good{end}"] = one.good.astype(np.uint8)
            if one.offsets is not None:
                arrays[f"dsnu_e{end}"] = one.offsets.values / np.float32(one.gain)
            if one.response is not None:
                arrays[f"prnu{end}"] = one.response.values
        file = path.with_suffix(".maps.npz")
        write_archive(file, arrays)
        return file


def fit_camera(
    files: Paths,
    more: Mapping[str, Paths],
    base: str | os.PathLike | None,
    cfa: str | Sequence[str] | None,
    options: Mapping[str, Any] | None,
) -> Fit:
    """Fit a camera to its own raw files, see `gpusim.fit`. more: files by kind of `KINDS`."""
    settings = {"cfa": cfa} if cfa is not None else {}
    given = {"": files, **more}
    shots = [shot for kind, paths in given.items() for shot in find_shots(paths, kind, settings)]
    if not shots:
        raise BadData("no raw files: wanted dark frames and flats, or shots of charts")
    plain = [shot for shot in shots if shot.kind != "ramp"]
    summaries, step = without_shift(_summaries(plain) if plain else [])
    summaries = name_kinds(summaries) if summaries else []
    shots = [replace(shot, step=step) if shot.kind != "ramp" else shot for shot in shots]
    by_kind: dict[str, list[Summary]] = {}
    for one in summaries:
        by_kind.setdefault(one.shot.kind, []).append(one)
    first = summaries[0].frame if summaries else None
    base = os.fspath(base) if base is not None else _base_for(first)
    camera = open_camera(base)
    _check_letters(camera, first)
    parts: list[Part] = []
    fits: list[IsoFit] = []
    failures: dict[str, Exception] = {}
    of_noise = [by_kind.get(kind, []) for kind in ("dark", "flat", "pairs")]
    if any(of_noise):
        with _kept(failures, "noise"):
            fits, missing = fit_isos(*of_noise)
            failures |= missing
            used = [*chain.from_iterable(of_noise)]
            parts.append(_fit_to_base(noise_part(fits, used), camera))
    else:
        parts.append(Part("noise", unknown=("noise: no dark frames and flats",)))
    known = _known(camera, first, fits, options or {})
    for kind in ORDER:
        chosen = [shot for shot in shots if shot.kind == kind]
        if chosen:
            with _kept(failures, kind):
                found = _other_parts(kind, chosen, known)
                parts += found
                more = shared_results(kind, chosen, found[0], known)
                known = replace(known, shared={**known.shared, **more})
    if failures and not any(part.settings or part.estimates for part in parts):
        raise next(iter(failures.values()))
    others = by_kind.get("other", []) + _spare_pairs(*of_noise)
    if others:
        parts.append(Part("other shots", unknown=(_other_line(others),)))
    counts = [f"{len(found)} of {kind}" for kind, found in by_kind.items()]
    lines = (f"frames: {', '.join(counts)}", *_notes(summaries))
    if step > 1:
        lines += (f"values are multiples of {step}: divided by {step}, as the converter gave them",)
    name = next((one.frame.camera for one in summaries if one.frame.camera), None)
    failed = tuple(f"{kind}: {error}" for kind, error in failures.items())
    return Fit(tuple(parts), base, name, lines, tuple(fits), failed)


@contextmanager
def _kept(failures, kind):
    """Keep the error of a part's frames in a dictionary, so that the other parts are fitted."""
    try:
        yield
    except (BadData, BadFile) as error:
        failures[kind] = error


def _summaries(shots):
    summaries = summarise(shots)
    if summaries:
        check_same_camera(summaries)
    return summaries


def find_shots(paths: Paths, kind: str, settings: Mapping[str, Any]) -> list[Shot]:
    """Return the shots of files and folders, in the order of their names.

    Args:
        paths: Files and folders.
        kind: Kind of all of them; "": the names of folders and files say it, or content does.
        settings: Arguments of the reader.

    Raises:
        BadData: These are no paths.
        BadFile: A folder has no raw files, or a file cannot be read.
    """
    found = []
    for path in [paths] if isinstance(paths, str | os.PathLike) else _listed(paths):
        if not isinstance(path, str | os.PathLike):
            raise BadFile(format_value(path), f"{type(path).__name__}, wanted a file's path")
        path = Path(path)
        if path.is_dir():
            inside = sorted(one for one in path.rglob("*") if one.is_file())
            inside = [one for one in inside if one.suffix.lower() in RAW_SUFFIXES]
            if not inside:
                raise BadFile(path, "no raw files in this folder")
            found += [(one, kind or _folder_kind(one)) for one in inside]
        else:
            found.append((path, kind or _folder_kind(path)))
    return [
        Shot(path, index, kind, settings)
        for path, kind in found
        for index in range(1 if kind == "ramp" else count_frames(path))
    ]


def _listed(paths):
    try:
        return list(paths)
    except TypeError:
        why = f"{format_value(paths)}: wanted paths of raw files"
        raise BadData(why) from None


def _folder_kind(path):
    """Return the kind of a file by its folder, or by its own name: edges.dng, grid_03.dng."""
    own = re.match("[a-z]*", path.stem.lower())
    names = path.absolute().parent.name.lower(), own.group() if own else ""
    return next((FOLDERS[name] for name in names if name in FOLDERS), "")


def _base_for(frame):
    return "mono" if frame is not None and len(frame.channels) == 1 else "phone"


def _check_letters(camera, frame):
    """Raise BadData unless the base has a curve for each filter of the mosaic."""
    if frame is None or len(frame.channels) == 1:
        return
    filters = camera.sensor.filters
    known = camera.sensor.channels
    missing = filters.missing(frame.channels) if filters else {*frame.channels} - {*known}
    if missing:
        raise BadData(
            f"base {camera.name!r} has no curve for the filters {', '.join(sorted(missing))} of the mosaic "
            f"{list(frame.cfa)}; give a base with them, --base my.toml"
        )


def _fit_to_base(part, camera):
    """Return the noise's part with the base's own letter for one channel."""
    sensor = dict(part.settings["sensor"])
    if len("".join(sensor["cfa"])) == 1 and camera.sensor.is_monochrome:
        sensor["cfa"] = list(camera.sensor.cfa)
    if tuple(sensor["cfa"]) == camera.sensor.cfa:
        del sensor["cfa"]
    return replace(part, settings={**part.settings, "sensor": sensor})


def _known(camera, frame, fits, options):
    """Return the known numbers for the other parts."""
    black, white = np.zeros((1, 1)), 65535.0
    cfa = frame.cfa if frame is not None else camera.sensor.cfa
    if frame is not None:
        black = frame.black_level if frame.black_level is not None else black
        white = frame.white_level or white
    if fits:
        black = np.full((1, 1), fits[0].black.value)
        white = fits[0].transfer.white or white
    gains = {fit.iso: fit.gain for fit in fits}
    return Known(camera, cfa, black, white, gains, options)


def _other_parts(kind, shots, known):
    functions = part_functions(kind)
    if not functions:
        line = f"{kind}: {len(shots)} shots are not used: nothing is fitted to them"
        return [Part(kind, unknown=(line,))]
    return [function(shots, known) for function in functions]


def _spare_pairs(darks, flats, pairs):
    """Return pairs of ISO speeds whose darks and flats give the same numbers, and more."""
    full = {one.frame.iso for one in darks} & {one.frame.iso for one in flats}
    return [one for one in pairs if one.frame.iso in full]


def _other_line(others):
    names = ", ".join(one.frame.name for one in others[:3])
    more = f" and {len(others) - 3} more" if len(others) > 3 else ""
    return (
        f"{names}{more}: neither dark nor evenly lit, not used; say what they show: --chart, --edges, --grid, "
        "--shading or --ramp; --pairs are for ISO speeds without darks or flats"
    )


def _notes(summaries):
    """Return each note of a reader once, with the number of its frames."""
    notes: dict[str, int] = {}
    for one in summaries:
        for note in one.frame.notes:
            notes[note] = notes.get(note, 0) + 1
    return tuple(f"{note} ({count} frames)" for note, count in notes.items())
