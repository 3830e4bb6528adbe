"""Atomic output: files are either complete or absent."""

import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path

from gpusim.domain.errors import BadFile
from gpusim.domain.leftovers import remove_leftovers, remove_leftovers_once, temporary_name


def check_output(path):
    """Raise BadFile unless the file can be written, tested with an empty file next to it.

    None is no output. Folders that are missing are made for the test, and removed. Temporary files of
    killed processes in the folder are removed.
    """
    if path is not None:
        with _temporary_file(path) as temporary:
            temporary.touch(exist_ok=False)
            remove_leftovers(temporary.parent)


@contextmanager
def atomic_path(path):
    """Yield a temporary path next to `path` with its suffix, renamed to `path` on success.

    Missing folders are made. If the block fails, the temporary file and these folders are removed and
    an existing `path` stays unchanged. Raises BadFile if the folder is not writable, the disk is full,
    or `path` is a folder, a device or a pipe.
    """
    with _temporary_file(path) as temporary:
        yield temporary
        os.replace(temporary, path)


@contextmanager
def _temporary_file(path):
    """Yield the name of a temporary file and remove it at the end; raise BadFile on OSError."""
    path = Path(path)
    try:
        kind = _kind(path)
        if kind:  # root could even replace /dev/null
            raise BadFile(path, f"is {kind}; wanted the name of a file")
        folder = path.absolute().parent
        temporary = path.with_name(temporary_name(path.suffix[:8]))  # within the limit of names
        missing = [one for one in (folder, *folder.parents) if not one.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            remove_leftovers_once(folder)
            yield temporary
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            with suppress(OSError):  # a file is in them
                for one in missing:
                    one.rmdir()
    except OSError as error:
        raise BadFile(path, f"cannot be written: {error.strerror or error}") from error


def _kind(path):
    """Return the kind of object at `path` in words; None for a regular file or nothing."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    except ValueError:
        raise BadFile(path, "no file can have this name") from None
    if stat.S_ISREG(mode):
        return None
    return "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
