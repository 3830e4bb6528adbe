"""Arrays that are kept on disk for the next process, by the constants that they are made of.

A file's name is a digest of the function, its arguments, the program's source, the packages that compute, and the host:
nothing is read that this process would not compute. Files are written under another name and then renamed. A file that
is damaged, and a folder that cannot be read or written, only cost time. The environment variable GPUSIM_TABLES names
the folder; empty, nothing is kept. Without it the folder is gpusim/tables in the user's cache folder.
"""

import hashlib
import io
import os
import platform
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.leftovers import PREFIX, remove_leftovers_once, temporary_name

VARIABLE = "GPUSIM_TABLES"
MOST = 2**28  # [byte] of all files; the oldest go
LARGEST = 2**24  # [byte] of a file
SLOW = 0.004  # [s] that a result takes if it is worth a file
CHECK = 32  # [byte] of the digest in front of the arrays
PLAIN = (bool, int, float, complex, str, bytes, type(None), np.generic)


def stored(function: Callable) -> Callable:
    """Decorate a function whose results are kept on disk.

    It depends on nothing but its arguments: numbers, texts, arrays, tuples and dataclasses of these. It returns an
    array, or a tuple of arrays and numbers.
    """

    @wraps(function)
    def found(*args) -> Any:
        folder = table_folder()
        if folder is None:
            return function(*args)
        path = folder / _name(function, args)
        value = _read(path)
        if value is None:
            start = time.perf_counter()
            value = function(*args)
            if time.perf_counter() - start >= SLOW:
                _write(path, value)
        return value

    return found


def table_folder() -> Path | None:
    """Return the folder of stored arrays; None if nothing is kept."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return Path(named) if named else None
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gpusim/tables"
    except RuntimeError:  # no home folder
        return None


def _name(function, args):
    digest = hashlib.sha256(_version())
    digest.update(f"{function.__module__}.{function.__qualname__}".encode())
    _feed(digest, args)
    return digest.hexdigest()[:40]


@cache
def _version() -> bytes:
    """Return a digest of everything but arguments that results depend on."""
    import scipy

    facts = [np.__version__, scipy.__version__, platform.node(), platform.machine()]
    digest = hashlib.sha256(repr(facts).encode())
    package = Path(__file__).parents[1]
    for path in sorted(package.glob("domain/*.py")) + sorted(package.glob("optics/*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


def _feed(digest, value):
    """Add a value to a digest. Raise TypeError for a value that is not plain data."""
    kind = type(value).__qualname__
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        digest.update(kind.encode())
        _feed(digest, tuple(getattr(value, part.name) for part in fields(value)))
    elif isinstance(value, tuple | list):
        digest.update(f"({len(value)}".encode())
        for one in value:
            _feed(digest, one)
    elif isinstance(value, PLAIN):
        digest.update(f"{kind} {value!r};".encode())
    else:
        raise TypeError(f"{kind} is no constant")


def _read(path):
    """Return the value in a file; None if there is none, or it is damaged."""
    try:
        data = path.read_bytes()
        if hashlib.sha256(data[CHECK:]).digest() != data[:CHECK]:
            return None
        body = io.BytesIO(data[CHECK:])
        is_tuple, *arrays = (_read_array(body) for _ in range(_read_array(body)))
    except (OSError, ValueError):
        return None
    with suppress(OSError):
        os.utime(path)  # the oldest go first
    return tuple(arrays) if is_tuple else arrays[0]


def _read_array(body):
    array = np.lib.format.read_array(body, allow_pickle=False)
    return array.item() if array.ndim == 0 else array


def _write(path, value):
    """Write a value to a file if it is small and the folder permits it."""
    parts = value if isinstance(value, tuple) else (value,)
    if sum(np.asarray(part).nbytes for part in parts) > LARGEST:
        return
    body = io.BytesIO()
    for part in (len(parts) + 1, isinstance(value, tuple), *parts):
        np.lib.format.write_array(body, np.asarray(part), allow_pickle=False)
    data, temporary = body.getvalue(), path.with_name(temporary_name())
    try:
        if not _make_room(path.parent, len(data)):
            return
        temporary.write_bytes(hashlib.sha256(data).digest() + data)
        temporary.replace(path)
    except OSError:
        with suppress(OSError):
            temporary.unlink()


_held: dict[Path, int] = {}  # [byte] in folders, as far as this process knows


def _make_room(folder, size) -> bool:
    """Remove the oldest files if all take too much; return False if the disk has no room. Raise OSError."""
    if folder not in _held or _held[folder] + size > MOST:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers_once(folder)
        entries = [entry for entry in os.scandir(folder) if not entry.name.startswith(PREFIX)]
        files = sorted(
            (entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries
        )
        held = sum(length for _, length, _ in files)
        least = 3 * MOST // 4 if held + size > MOST else held  # room for some more
        for _, length, path in files:
            if held <= least:
                break
            os.unlink(path)
            held -= length
        _held[folder] = held
    _held[folder] += size
    return shutil.disk_usage(folder).free > MOST // 8 + size
