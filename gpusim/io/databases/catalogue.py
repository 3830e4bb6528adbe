"""All cameras and lenses that the installed data bases know, under one name each."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gpusim.domain.errors import BadData, format_value
from gpusim.domain.progress import announced
from gpusim.domain.short_repr import short_repr
from gpusim.io.databases.camconst import Constants, read_camconst
from gpusim.io.databases.lensfun import Body, Lens, Lensfun, read_lensfun
from gpusim.io.databases.libcamera import Tuning, read_tuning
from gpusim.io.databases.noise_profiles import CameraNoise, read_noise_profiles
from gpusim.io.databases.places import KINDS, Place, find_places
from gpusim.io.databases.words import key_of, nearest, parts_of, search

_FOCAL, _ZOOM = re.compile(r"\d\s*mm", re.I), re.compile(r"\d\s*-\s*\d")  # in a lens's name


@dataclass(frozen=True)
class CameraEntry:
    """A camera, and the data bases' entries on it.

    Attributes:
        name: Maker and model.
        aliases: Further names.
        body: Lensfun's entry: crop factor, aspect ratio, mount.
        noise: Darktable's noise by ISO.
        constants: RawTherapee's levels.
        profile: File of a DNG camera profile.
        tuning: Libcamera's tuning.
    """

    name: str
    aliases: tuple[str, ...] = ()
    body: Body | None = field(default=None, repr=False)
    noise: CameraNoise | None = field(default=None, repr=False)
    constants: Constants | None = field(default=None, repr=False)
    profile: Path | None = field(default=None, repr=False)
    tuning: Tuning | None = field(default=None, repr=False)

    __repr__ = short_repr

    @property
    def names(self) -> tuple[str, ...]:
        """All names, the main one first."""
        return self.name, *self.aliases


@dataclass(frozen=True)
class Catalogue:
    """Cameras and lenses of all data bases.

    Attributes:
        places: Data bases that are found, by kind.
        cameras: By name.
        lenses: Lensfun's.
        fits: Mount of a camera -> mounts of lenses that fit.
    """

    places: dict[str, Place]
    cameras: tuple[CameraEntry, ...]
    lenses: tuple[Lens, ...]
    fits: dict[str, frozenset[str]]

    def find(self, words: str) -> list[CameraEntry]:
        """Return the cameras that have all words in their names, best first."""
        return search(_text(words, "camera"), self.cameras, lambda one: one.names)

    def find_lenses(self, words: str, camera: CameraEntry | None = None) -> list[Lens]:
        """Return the lenses that have all words in their names, best first.

        With a camera: lenses that fit its mount and were calibrated on a frame at least as large.
        Its maker's lenses come first, then those with more kinds of calibrations.
        """
        lenses: Sequence[Lens] = self.lenses
        body = camera.body if camera else None
        if body is not None:
            mounts = self.fits.get(body.mount, frozenset({body.mount})) | {body.mount}
            lenses = [one for one in lenses if mounts & set(one.mounts)]
        found = search(_text(words, "lens"), lenses, lambda one: one.names)
        order = {id(one): number for number, one in enumerate(found)}
        is_prime = bool(_FOCAL.search(words)) and not _ZOOM.search(words)
        return sorted(
            found,
            key=lambda one: (
                is_prime and one.focal[0] != one.focal[1],
                _misfit(one, body),
                order[id(one)],
            ),
        )

    def camera(self, words: str) -> CameraEntry:
        """Return the one camera of a name. Raises BadData with near names."""
        found = self.find(words)
        wanted = "".join(parts_of(words))
        exact = [one for one in found if any(wanted in _squeeze(name) for name in one.names)]
        main = [one for one in exact if wanted in _squeeze(one.name)]
        own = set(parts_of(words))
        whole = [one for one in found if own <= set(parts_of(" ".join(one.names)))]
        for some in (main, exact, whole, found):
            if len(some) == 1:
                return some[0]
        if found:
            names = [one.name for one in main or exact or whole or found]
            more = f" and {len(names) - 6} more" if len(names) > 6 else ""
            raise BadData(
                f"several cameras have the words {format_value(words)}: {', '.join(names[:6])}{more}; give a whole name"
            )
        if not self.cameras:
            raise BadData(f"no data base of cameras is found; {how_to_get()}")
        near = nearest(words, [name for one in self.cameras for name in one.names])
        raise BadData(_say_unknown("camera", words, near))

    def built_in(self, camera: CameraEntry) -> Lens | None:
        """Return the lens that stays on a camera; None if it takes others, or lensfun does not know it."""
        body = camera.body
        if body is None or not body.mount[:1].islower():  # lensfun's mark
            return None
        own = [one for one in self.lenses if body.mount in one.mounts]
        return min(own, key=lambda one: len(one.model), default=None)

    def lens(self, words: str, camera: CameraEntry | None) -> tuple[Lens, list[Lens]]:
        """Return the best lens for words, and the others. Raises BadData with near names."""
        found = self.find_lenses(words, camera)
        if found:
            return found[0], found[1:]
        if not self.lenses:
            raise BadData(f"no data base of lenses is found; {KINDS['lensfun'][1]}")
        every = self.find_lenses("", camera)
        near = nearest(words, [one.name for one in every])
        fitting = f" for {camera.name}" if camera and camera.body else ""
        raise BadData(_say_unknown(f"lens{fitting}", words, near))


def _misfit(lens, body):
    """Return the order of a lens: smaller is better."""
    kinds = sum(map(bool, (lens.distortion, lens.lateral, lens.vignetting)))
    if body is None:
        return (0, 0, -kinds, 0.0)
    same = parts_of(lens.maker)[:1] == parts_of(body.maker)[:1]
    is_cut = lens.crop > 1.04 * body.crop
    return (is_cut, not same, -kinds, abs(lens.crop - body.crop))


def _text(words, what):
    if not isinstance(words, str):
        raise BadData(f"{what}: {format_value(words)}; wanted words of its name")
    return words


def _say_unknown(what, words, near):
    shown = ", ".join(near) if near else "none; fewer or other words may find it"
    return f"no {what} with the words {format_value(words)}; near names: {shown}"


def _squeeze(name):
    """Return a name without spaces and signs, with and without its first word, the maker."""
    parts = parts_of(name)
    return {"".join(parts), "".join(parts[1:])}


def how_to_get() -> str:
    """Return the ways to the data bases in words."""
    return "; ".join(f"{kind}: {way}" for kind, (_, way) in KINDS.items())


def open_catalogue(databases: str | os.PathLike | Sequence | None = None) -> Catalogue:
    """Read all data bases that are found.

    Args:
        databases: Folders that are searched first, see `find_places`.

    Returns:
        Cameras and lenses.

    Raises:
        BadData: `databases` is no path.
        BadFile: A file is damaged.
    """
    places = find_places(databases)
    entries: dict[str, CameraEntry] = {}
    lensfun = Lensfun((), ())
    if "lensfun" in places:
        with announced("reading lensfun's data base"):
            lensfun = read_lensfun(places["lensfun"].files)
        for body in lensfun.bodies:
            aliases = tuple(f"{body.maker} {alias}" for alias in body.aliases)
            _merge(entries, body.maker, (body.model, *body.aliases), aliases, body=body)
    if "darktable" in places:
        for noise in read_noise_profiles(places["darktable"].files[0]):
            _merge(entries, noise.maker, (noise.model,), noise=noise)
    if "camconst" in places:
        for constants in read_camconst(places["camconst"].files[0]):
            for name in constants.names:  # models that share constants are several cameras
                _merge(entries, "", (name,), constants=constants)
    if "dcp" in places:
        for path in places["dcp"].files:
            _merge(entries, "", (path.stem,), profile=path)
    if "libcamera" in places:
        for path in places["libcamera"].files:
            if path.stem != "uncalibrated":
                _merge(entries, "Raspberry Pi", (path.stem,), tuning=read_tuning(path))
    cameras = tuple(sorted(set(map(_Same, entries.values())), key=lambda one: one.entry.name))
    return Catalogue(
        places, tuple(one.entry for one in cameras), lensfun.lenses, dict(lensfun.fits)
    )


@dataclass(frozen=True)
class _Same:
    """An entry that is equal only to itself, for a set."""

    entry: CameraEntry

    def __hash__(self):
        return id(self.entry)

    def __eq__(self, other):
        return self.entry is other.entry


def _merge(entries, maker, models, aliases=(), **part):
    """Add a part to the entry of a camera; a new entry if no data base had one of its names."""
    keys = [key_of(maker, model) for model in models]
    known = next((entries[key] for key in keys if key in entries), None)
    if known is None:
        known = CameraEntry(_full_name(maker, models[0]))
    names = dict.fromkeys((*known.aliases, *aliases))
    (name, value), *_ = part.items()
    if getattr(known, name) is None:
        changed = replace(known, aliases=tuple(names), **{name: value})
    else:
        changed = replace(known, aliases=tuple(names))
    for key in [key for key, one in entries.items() if one is known] + keys:
        entries[key] = changed


def _full_name(maker, model):
    """Return maker and model, the maker once."""
    first = maker.split()[0] if maker else ""
    return model if model.lower().startswith(first.lower()) else f"{first} {model}"


def find_cameras(
    words: str = "", *, databases: str | os.PathLike | Sequence | None = None
) -> list[CameraEntry]:
    """Return the cameras of the installed data bases that have all words in their names.

    Args:
        words: Words of a name, such as "Nikon D750"; "" for all cameras.
        databases: A folder with data bases, or several; searched before the usual places.

    Returns:
        Cameras, the best match first; the list is empty if there is none.

    Raises:
        BadData: An argument has the wrong type.
        BadFile: A data base is damaged.
    """
    _text(words, "camera")
    return open_catalogue(databases).find(words)


def find_lenses(
    words: str = "",
    camera: str | None = None,
    *,
    databases: str | os.PathLike | Sequence | None = None,
) -> list[Lens]:
    """Return the lenses of lensfun's data base that have all words in their names.

    Args:
        words: Words of a name, such as "50mm f/1.8"; "" for all lenses.
        camera: Name of a camera whose mount they must fit; None: any.
        databases: As for `find_cameras`.

    Returns:
        Lenses, the best match first; the list is empty if there is none.

    Raises:
        BadData: An argument has the wrong type, or there is no such camera.
        BadFile: A data base is damaged.
    """
    _text(words, "lens")
    catalogue = open_catalogue(databases)
    return catalogue.find_lenses(
        words, catalogue.camera(_text(camera, "camera")) if camera else None
    )
