"""Files that a client sends: bounded, in a temporary folder, found by their SHA-256."""

import hashlib
import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Mapping
from pathlib import Path

from gpusim.apps.preview.scene_choice import is_file_name
from gpusim.domain.errors import BadData, BadFile, GpusimError, format_value
from gpusim.io.files import open_file
from gpusim.io.scene.envi import DATA
from gpusim.io.scene.readers import SUFFIXES

MOST_BYTES = 2**29  # of one file
MOST_KEPT = 2**30  # [byte] of a client's files; the ones used longest ago are removed
PIECE = 2**20  # [byte] hashed at once
ENVI_DATA = tuple(suffix for suffix in DATA if suffix)
SCENES = tuple(dict.fromkeys((*SUFFIXES, *ENVI_DATA)))  # suffixes of files of scenes


class Wanted(BadData):
    """Files that the settings name and that this server does not have.

    Attributes:
        files: Name -> SHA-256.
    """

    def __init__(self, files: Mapping[str, str]):
        self.files = dict(files)
        names = ", ".join(f"{name} (SHA-256 {sha})" for name, sha in files.items())
        super().__init__(f"wanted: {names}; drop the file on the page, or choose another scene")


class Uploads:
    """Files of a client. Their folder is removed with this object.

    Args:
        known: SHA-256 -> path of the files that the preview was started with.
    """

    def __init__(self, known: Mapping[str, Path] | None = None):
        self._known = dict(known or {})
        self._kept: dict[str, int] = {}  # SHA-256 -> size [byte], the last used one last
        self._folder: Path | None = None

    def check(self, name: str, size: int, suffixes: Iterable[str] = SCENES):
        """Raise BadFile unless a file of this name and size [byte] may be sent.

        suffixes: Allowed suffixes.
        """
        allowed = tuple(suffixes)
        if not is_file_name(name):
            raise BadFile(
                format_value(name),
                "allowed are names of up to 120 printable letters without / and \\; rename the file",
            )
        if not name.lower().endswith(allowed):
            raise BadFile(name, f"allowed are {', '.join(allowed)}; convert it to one of these")
        if size > MOST_BYTES:
            raise BadFile(
                name,
                f"{size / 2**20:.0f} MiB; allowed are {MOST_BYTES / 2**20:.0f} MiB; make it smaller, or "
                "start `gpusim preview` with it",
            )

    def arriving(self) -> Path:
        """Return a new path for a file that arrives, in the folder of this client."""
        descriptor, path = tempfile.mkstemp(prefix="arriving-", dir=self._root())
        os.close(descriptor)
        return Path(path)

    def keep(
        self, name: str, path: Path, wanted: Mapping[str, str] | None = None
    ) -> tuple[str, str]:
        """Keep a file that has arrived. Return its name and its SHA-256.

        name: Its name. path: From `arriving`; it is moved. wanted: Name -> SHA-256 of the files
        that are missing: only these are kept, under their names. Raises BadFile.
        """
        try:
            sha, size = sha_of(path), path.stat().st_size
            if wanted:
                name = _wanted_name(name, sha, wanted)
            self._make_room(size, sha)
            self._kept[sha] = self._kept.pop(sha, size)
            os.replace(path, self._place(sha) / name)
        except OSError as error:
            raise BadFile(name, f"cannot be kept: {error.strerror or error}") from error
        finally:
            path.unlink(missing_ok=True)
        return name, sha

    def missing(self, files: Mapping[str, str]) -> dict[str, str]:
        """Return the files (name -> SHA-256) that are not here."""
        here = self._known.keys() | self._kept.keys()
        return {name: sha for name, sha in files.items() if sha not in here}

    def path(self, name: str, sha: str) -> Path:
        """Return the path of a file with this name. Raises Wanted."""
        if self.missing({name: sha}):
            raise Wanted({name: sha})
        if sha in self._known:
            source = self._known[sha]
        else:
            self._kept[sha] = self._kept.pop(sha)
            source = next(self._place(sha).iterdir())
        return source if source.name == name else _link(source, self._place(sha) / name)

    def together(self, files: Mapping[str, str]) -> Path:
        """Return a folder with all of these files (name -> SHA-256). Raises Wanted."""
        if missing := self.missing(files):
            raise Wanted(missing)
        paths = [self.path(name, sha) for name, sha in files.items()]
        if len({path.parent for path in paths}) == 1:
            return paths[0].parent
        text = "".join(f"{sha} {name}\n" for name, sha in sorted(files.items()))
        folder = self._place(hashlib.sha256(text.encode()).hexdigest())
        for path in paths:
            _link(path, folder / path.name)
        return folder

    def is_known(self, files: Mapping[str, str]) -> bool:
        """Return whether all files are ones that the preview was started with."""
        return {*files.values()} <= self._known.keys()

    def shorten(self, error: GpusimError) -> BadData:
        """Return an error that names files without the client's folder."""
        text = error.details
        if self._folder is not None:
            text = re.sub(
                rf"{re.escape(str(self._folder))}{re.escape(os.sep)}[^{os.sep}]+.", "", text
            )
        return BadData(text)

    def _root(self):
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="gpusim-preview-"))
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        return self._folder

    def _place(self, sha):
        """Return the folder of a SHA-256."""
        folder = self._root() / sha
        folder.mkdir(exist_ok=True)
        return folder

    def _make_room(self, size, sha):
        """Remove the files that were used longest ago until one of this size [byte] fits."""
        for one in [one for one in self._kept if one != sha]:
            if sum(self._kept.values()) + size <= MOST_KEPT:
                return
            shutil.rmtree(self._place(one), ignore_errors=True)
            self._kept.pop(one)


def sha_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal. Raises BadFile."""
    digest = hashlib.sha256()
    with open_file(path) as file:
        while piece := file.read(PIECE):
            digest.update(piece)
    return digest.hexdigest()


def _wanted_name(name, sha, wanted):
    """Return the name under which a file is wanted. Raises BadFile if it is another file."""
    for one, own in wanted.items():
        if own == sha:
            return one
    asked = wanted[name] if name in wanted else " or ".join(wanted.values())
    raise BadFile(
        name,
        f"its SHA-256 is {sha}, wanted {asked}: this is another file; send the right one, or choose another "
        "scene",
    )


def _link(source, path):
    """Return a path at which a file is found under another name or in another folder."""
    if not path.exists():
        path.symlink_to(source)
    return path
