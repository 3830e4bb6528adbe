"""What makes a video what it is, kept beside it: a run that goes on with it, or another shard, is of the same."""

import json
import os
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text

PARTS = ".parts"  # suffix of a folder of what is not complete
LARGEST = 2**26  # [byte] of a manifest
ENDS = 2**16  # [byte] of a file that tell it from another of its size


@contextmanager
def kept(path: Path, made: dict, outputs: str, is_empty: Callable[[], bool]):
    """While a video is made: its manifest is there, or is the one that was there.

    made: plain data. outputs: what to remove for a video that begins anew. is_empty: whether nothing was written: a
    manifest that is new then goes again when the work fails. Raises BadFile where it is another video's.
    """
    is_new = not path.exists()
    _keep(path, json.loads(json.dumps(made)), outputs)
    try:
        yield
    except BaseException:
        if is_new and is_empty():
            path.unlink(missing_ok=True)
            if path.parent.suffix == PARTS:
                with suppress(OSError):  # others are at work there
                    path.parent.rmdir()
        raise


class _IsThere(Exception):
    """Another shard was faster."""


def _keep(path, made, outputs):
    if not path.exists():
        with suppress(_IsThere), atomic_path(path) as temporary:
            temporary.write_text(json.dumps(made, indent=2) + "\n")
            try:
                os.link(temporary, path)  # the first of several shards writes it, and no other over it
            except FileExistsError:
                raise _IsThere from None
            except OSError:
                pass  # a file system without links: the last one writes it
    try:
        found = json.loads(read_text(path, "a manifest of a video", LARGEST))
        others = [name for name in made if found.get(name) != made[name]]
        named = [name for one in others for name in (
            [inner for inner in made[one] if found[one].get(inner) != made[one][inner]]
            if isinstance(made[one], dict) and isinstance(found.get(one), dict) else [one])]
    except (ValueError, AttributeError, RecursionError) as error:  # RecursionError: of JSON, lists in lists
        raise BadFile(path, f"not a manifest of a video ({error}); remove it and {outputs}") from error
    if others:
        raise BadFile(path, f"of one with other {', '.join(named)}; give -o another name, or remove it and {outputs}")


def file_digest(path) -> str:
    """Digest of a file's size, beginning and end; "" of what is no file, such as a chart's name."""
    path = Path(path)
    if not path.is_file():
        return ""
    found = sha256(str(path.stat().st_size).encode())
    with path.open("rb") as file:
        found.update(file.read(ENDS))
        file.seek(max(path.stat().st_size - ENDS, 0))
        found.update(file.read(ENDS))
    return found.hexdigest()[:16]


def digest(value) -> str:
    """Digest of a camera, or of another value of dataclasses, arrays, tuples and numbers."""
    found = sha256()
    _add(found, value)
    return found.hexdigest()[:16]


def _add(found, value):
    if is_dataclass(value):
        found.update(type(value).__name__.encode())
        for field in fields(value):
            found.update(field.name.encode())
            _add(found, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        found.update(repr((value.dtype.str, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, list | tuple | dict):
        items = list(value.items() if isinstance(value, dict) else value)
        found.update(f"{type(value).__name__} {len(items)}".encode())
        for item in items:
            _add(found, item)
    else:
        found.update(repr(value).encode())
