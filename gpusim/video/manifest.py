"""What makes a video what it is, kept beside it: a run that goes on with it, or another shard, is of the same."""

import json
import os
from dataclasses import fields, is_dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text


def keep(path: Path, made: dict, outputs: str):
    """Write the manifest, or compare it with the one that is there.

    made: plain data. outputs: what to remove for a video that begins anew. Raises BadFile where it is another video's.
    """
    made = json.loads(json.dumps(made))
    if not path.exists():
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(made, indent=2) + "\n")
            try:
                os.link(temporary, path)  # the first of several shards writes it
            except FileExistsError:
                pass
            except OSError:  # a file system without links
                return
    try:
        found = json.loads(read_text(path, "a manifest of a video", 2**26))
        others = [name for name in made if found.get(name) != made[name]]
    except (ValueError, AttributeError) as error:
        raise BadFile(path, f"not a manifest of a video ({error}); remove it and {outputs}") from error
    if others:
        raise BadFile(path, f"of a video with other {', '.join(others)}; give -o another name, or remove it and "
                            f"{outputs}")


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
