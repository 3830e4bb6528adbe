"""Files that are either complete or not there."""

import os
import uuid
from contextlib import contextmanager
from pathlib import Path

from gpusim.domain.errors import BadFile


def check_output(path):
    """Raise BadFile if a file of this name cannot be: no such folder, or a folder itself. None is no output."""
    if path is None:
        return
    folder = Path(path).absolute().parent
    if not folder.is_dir():
        raise BadFile(path, f"the folder {folder} does not exist")
    if Path(path).is_dir():
        raise BadFile(path, "is a folder")


@contextmanager
def atomic_path(path):
    """Yield a temporary path beside `path`, with the same suffix; it takes the name `path` when the block succeeds.

    When the block fails the temporary file is removed and an existing `path` is left as it was. Raises BadFile when the
    folder is missing or cannot be written to.
    """
    check_output(path)
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise BadFile(path, f"cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
