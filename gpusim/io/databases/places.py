"""Where data bases of cameras and lenses lie on a computer."""

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from gpusim.domain.errors import BadData, BadFile, Missing, UnknownName, format_value

VARIABLE = "GPUSIM_DATABASES"  # environment: folders, separated as in PATH
MOST_FILES = 20000  # of a folder that a user names; a whole disk would take minutes
_SHARES = (
    *("/usr/share", "/usr/local/share", "/opt/homebrew/share", "~/.local/share", "~/.config"),
    *("/Applications/darktable.app/Contents/Resources/share",),
    *("/Applications/RawTherapee.app/Contents/Resources/share",),
    *("C:/Program Files/darktable/share", "C:/Program Files/RawTherapee"),
)
# kind -> folders below a share, and how to get the data base
KINDS = {
    "lensfun": (
        ("lensfun/updates/version_1", "lensfun/version_2", "lensfun/version_1", "lensfun"),
        "pip install lensfunpy, or Debian's liblensfun-data-v1",
    ),
    "darktable": (("darktable",), "install darktable, or fetch its noiseprofiles.json"),
    "camconst": (("rawtherapee", "RawTherapee", ""), "install RawTherapee (rawtherapee-data)"),
    "dcp": (
        ("rawtherapee/dcpprofiles", "dcpprofiles"),
        "install RawTherapee, or name a folder of .dcp files",
    ),
    "libcamera": (
        ("libcamera/ipa/rpi/vc4", "libcamera/ipa/rpi/pisp", "libcamera/ipa/raspberrypi"),
        "install libcamera-ipa",
    ),
}


@dataclass(frozen=True)
class Place:
    """Files of one data base.

    Attributes:
        kind: A key of KINDS.
        files: The files, sorted.
        label: Name in sources: its folder or file, and its version if known.
    """

    kind: str
    files: tuple[Path, ...]
    label: str


def find_places(databases: str | os.PathLike | Sequence | None = None) -> dict[str, Place]:
    """Return the data bases that are found, by kind.

    Folders that are named come first, then folders of the environment variable GPUSIM_DATABASES,
    the usual places of programs, and the package lensfunpy.

    Args:
        databases: A folder or several; they are searched with all folders in them.

    Raises:
        BadData: `databases` is neither a path nor a list of paths.
        BadFile: A folder that is named does not exist, or has too many files.
    """
    named = [*_folders(databases), *filter(None, os.environ.get(VARIABLE, "").split(os.pathsep))]
    found: dict[str, Place] = {}
    for folder in named:
        files = _files_below(Path(folder).expanduser())
        for kind in KINDS:
            if kind not in found and (own := _files_of(kind, files)):
                found[kind] = Place(kind, own, _label(kind, own))
    for kind, (places, _) in KINDS.items():
        if kind not in found and (own := _find_installed(kind, places)):
            found[kind] = Place(kind, own, _label(kind, own))
    return found


def require(places: dict[str, Place], kind: str) -> Place:
    """Return a data base. Raises Missing with how to get it."""
    if kind not in KINDS:
        raise UnknownName("data base", kind, KINDS)
    if kind not in places:
        raise Missing(
            f"data base {kind}: not found; {KINDS[kind][1]}, or name its folder (--databases, {VARIABLE})"
        )
    return places[kind]


def _folders(databases) -> list:
    if databases is None:
        return []
    if isinstance(databases, str | os.PathLike):
        return [databases]
    if isinstance(databases, Iterable) and not isinstance(databases, bytes):
        folders = list(databases)
        if all(isinstance(one, str | os.PathLike) for one in folders):
            return folders
    raise BadData(f"databases = {format_value(databases)}: wanted a folder, or a list of folders")


def _files_below(folder: Path) -> list[Path]:
    """Return the files of a folder and of all folders in it; a file itself. Raises BadFile."""
    try:
        if folder.is_file():
            return [folder]
        if not folder.is_dir():
            raise BadFile(folder, "no such folder; wanted a folder of data bases")
    except (OSError, ValueError):
        raise BadFile(folder, "no such folder; wanted a folder of data bases") from None
    found = []
    for where, _, names in os.walk(folder):
        found += [Path(where, name) for name in names]
        if len(found) > MOST_FILES:
            why = f"more than {MOST_FILES} files below; wanted the folder of the data bases itself"
            raise BadFile(folder, why)
    return found


def _files_of(kind, files) -> tuple[Path, ...]:
    """Return the files of one kind among others."""
    if kind == "darktable":
        own = [path for path in files if path.name == "noiseprofiles.json"][:1]
    elif kind == "camconst":
        own = [path for path in files if path.name == "camconst.json"][:1]
    elif kind == "dcp":
        own = [path for path in files if path.suffix.lower() == ".dcp"]
    elif kind == "lensfun":
        own = [path for path in files if path.suffix == ".xml" and _begins(path, b"<lensdatabase")]
        own = [path for path in own if path.parent == min(own).parent]
    else:
        own = [path for path in files if path.suffix == ".json" and _begins(path, b'"rpi.')]
        names: dict[str, Path] = {}
        for path in sorted(own):  # of vc4 and pisp the first
            names.setdefault(path.name, path)
        own = list(names.values())
    return tuple(sorted(own))


def _begins(path, word) -> bool:
    """Return whether a word is in the first bytes of a file."""
    try:
        with open(path, "rb") as file:
            return word in file.read(4096)
    except OSError:
        return False


def _find_installed(kind, places) -> tuple[Path, ...]:
    """Return the files of a data base at the usual places; () if there are none."""
    folders = [Path(share, place).expanduser() for share in _SHARES for place in places]
    if kind == "lensfun" and (package := _package_folder()):
        folders.insert(0, package)
    for folder in folders:
        try:
            files = [path for path in folder.iterdir() if path.is_file()]
        except OSError:
            continue
        if own := _files_of(kind, files):
            return own
    return ()


def _package_folder() -> Path | None:
    """Return the folder of lensfunpy's data base without loading the package."""
    try:
        spec = find_spec("lensfunpy")
    except (ImportError, ValueError):
        return None
    return Path(spec.origin).parent / "db_files" if spec and spec.origin else None


def _label(kind, files) -> str:
    """Return the words for a data base in sources: place, and a version or a digest of its files."""
    place = files[0] if len(files) == 1 or kind in ("darktable", "camconst") else files[0].parent
    if place.name == "db_files" and place.parent.name == "lensfunpy":
        from importlib.metadata import version

        return f"lensfun's data base in lensfunpy {version('lensfunpy')}"
    names = {"camconst": "RawTherapee's", "dcp": "DCP profiles", "libcamera": "libcamera's"}
    return f"{names.get(kind, kind + chr(39) + 's')} {place} (sha256 {_digest(files)})"


def _digest(files) -> str:
    """Return the first digits of the digest of files."""
    total = hashlib.sha256()
    for path in files:
        try:
            total.update(path.read_bytes())
        except OSError as error:
            raise BadFile(path, f"cannot be read: {error.strerror or error}") from None
    return total.hexdigest()[:12]
