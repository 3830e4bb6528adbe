"""Files that are either complete or not there."""

import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path

from gpusim.domain.errors import BadFile
from gpusim.domain.leftovers import remove_leftovers, remove_leftovers_once, temporary_name


def check_output(path):
    """Raise BadFile unless a file of this name can be written: an empty one is made beside it. None is no output.

    Temporary files that killed processes left in the folder are removed.
    """
    if path is not None:
        with _writing(path) as temporary:
            temporary.touch(exist_ok=False)
            remove_leftovers(temporary.parent)


@contextmanager
def atomic_path(path):
    """Yield a temporary path beside `path`, with the same suffix; it takes the name `path` when the block succeeds.

    When the block fails the temporary file is removed and an existing `path` is left as it was. Raises BadFile when the
    folder is missing or cannot be written to, the disk is full, or `path` is a folder, a device or a pipe.
    """
    with _writing(path) as temporary:
        yield temporary
        os.replace(temporary, path)


@contextmanager
def _writing(path):
    """Yield the name of a temporary file, which is removed; what the system refuses is a BadFile."""
    path = Path(path)
    try:
        kind = _kind(path)
        if kind:  # as root one could even replace /dev/null
            raise BadFile(path, f"is {kind}; wanted the name of a file")
        if not path.absolute().parent.is_dir():
            raise BadFile(path, f"the folder {path.absolute().parent} does not exist")
        remove_leftovers_once(path.absolute().parent)
        temporary = path.with_name(temporary_name(path.suffix[:8]))  # no longer than names may be
        try:
            yield temporary
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    except OSError as error:
        raise BadFile(path, f"cannot be written: {error.strerror or error}") from error


def _kind(path):
    """What is at `path` if it is not a file that can be replaced."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    except ValueError:
        raise BadFile(path, "no file can have this name") from None
    return (
        "a folder" if stat.S_ISDIR(mode) else None if stat.S_ISREG(mode) else "a device or a pipe"
    )
