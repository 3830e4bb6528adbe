"""Work to time, checks of its results, and hashes of its sources and inputs."""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.backends.device import kernel_folder

SUFFIXES = (".py", ".cl", ".clh")


@dataclass(frozen=True)
class Work:
    """A subject that is ready to run on a device.

    Attributes:
        run: Does the work once. It need not wait for the device.
        moved: Bytes of the inputs and results, each read or written once.
        operations: Multiplications and additions, or None if they are not counted.
        nbytes: Memory that stays allocated for the next run [byte].
        is_wall: Whether the host's clock counts: all that a user waits for. Else the device's clock
            and the work of host libraries count.
    """

    run: Callable[[], Any]
    moved: int
    operations: int | None
    nbytes: int
    is_wall: bool


@dataclass(frozen=True)
class Check:
    """A comparison of a subject with its truth.

    Attributes:
        case: What is compared, in words.
        error: The largest error.
        tolerance: The allowed error.
        why: The derivation of the tolerance, or the reason of a failure.
    """

    case: str
    error: float
    tolerance: float
    why: str

    @property
    def is_good(self) -> bool:
        """True if the error is within the tolerance."""
        return bool(self.error <= self.tolerance)


def find_worst(checks: Iterable[Check]) -> Check:
    """Return the first check that fails, or the one nearest to its tolerance.

    Args:
        checks: At least one check.
    """
    checks = list(checks)
    failed = [check for check in checks if not check.is_good]
    if failed:
        return failed[0]
    return max(checks, key=lambda check: check.error / (check.tolerance or 1.0))


def write_size(size: tuple[int, int]) -> str:
    """Return a size as COLSxROWS."""
    return f"{size[0]}x{size[1]}"


@lru_cache(maxsize=64)
def digest_sources(area: str = "", name: str = "") -> str:
    """Return the SHA-256 of kernels' sources, which their files' names are part of.

    Args:
        area: Area of the stage; "" takes all files of all areas.
        name: Name of the stage. Its own files are taken, and all files of `common`.
    """
    folder, digest = kernel_folder(), hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        is_own = path.parent.name == area and _is_of(path.name, name)
        if path.suffix in SUFFIXES and (not area or is_own or path.parent.name == "common"):
            digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _is_of(file, name):
    """Return whether a file is one of a stage's."""
    stem = Path(file).stem
    return stem == name or stem.startswith(f"{name}_")


def digest_values(*values: Any) -> str:
    """Return the SHA-256 of plain values and arrays.

    Args:
        *values: Texts, numbers, arrays, and tuples, lists and dicts of these.
    """
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, dict):
            digest.update(
                digest_values(*(part for pair in value.items() for part in pair)).encode()
            )
        elif isinstance(value, list | tuple):
            digest.update(f"{len(value)}:{digest_values(*value)}".encode())
        else:
            digest.update(f"{type(value).__name__}:{value!r}\0".encode())
    return digest.hexdigest()
