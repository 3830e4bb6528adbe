"""What makes a video what it is, kept beside it: a run that goes on with it, or another shard, is of the same."""

import json
import os
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from gpusim.domain.errors import BadFile
from gpusim.domain.leftovers import remove_leftovers
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PARTS = ".parts"  # suffix of a folder of what is not complete
SECONDS = 1.0  # after which the names of plans are kept, or at the end of a segment
SHOWN = 3  # names of plans, in a message
LARGEST = 2**26  # [byte] of a manifest
ENDS = 2**16  # [byte] of a file that tell it from another of its size


@contextmanager
def kept(path: Path, made: dict, outputs: str, is_empty: Callable[[], bool]):
    """While a video is made: its manifest is there, or is the one that was there.

    made: plain data. outputs: what to remove for a video that begins anew. is_empty: whether nothing was written: a
    manifest that is new then goes again when the work fails. Temporary files that killed processes left in its folder
    are removed. Raises BadFile where it is another video's.
    """
    remove_leftovers(path.parent)
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
                os.link(
                    temporary, path
                )  # the first of several shards writes it, and no other over it
            except FileExistsError:
                raise _IsThere from None
            except OSError:
                pass  # a file system without links: the last one writes it
    try:
        found = json.loads(read_text(path, "a manifest of a video", LARGEST))
        others = [name for name in made if found.get(name) != made[name]]
        named = [
            name
            for one in others
            for name in (
                [inner for inner in made[one] if found[one].get(inner) != made[one][inner]]
                if isinstance(made[one], dict) and isinstance(found.get(one), dict)
                else [one]
            )
        ]
        _plans_in(found)
    except (
        ValueError,
        AttributeError,
        RecursionError,
    ) as error:  # RecursionError: of JSON, lists in lists
        raise BadFile(
            path, f"not a manifest of a video ({error}); remove it and {outputs}"
        ) from error
    if others:
        raise BadFile(
            path,
            f"of one with other {', '.join(named)}; give -o another name, or remove it and {outputs}",
        )


class Plans:
    """Names of the plans that made a video's frames, kept in its manifest: "plans", by name the runs [first, last].

    Shards add theirs to one manifest. Used as a context manager, which writes them at its end.
    """

    def __init__(self, path: Path):
        self._path = path
        self.runs: dict[str, list] = {}
        self._written = time.monotonic()

    def __enter__(self) -> "Plans":
        return self

    def __exit__(self, *error) -> None:
        self.write()

    def add(self, name: str, number: int, is_last: bool = False):
        """Note the plan of a frame. is_last: of its segment: then, or after SECONDS, the manifest is written."""
        self.runs[name] = _joined([*self.runs.get(name, ()), [number, number]])
        if is_last or time.monotonic() > self._written + SECONDS:
            self.write()

    def write(self):
        """Put them into the manifest, if it is still there. Raises BadFile."""
        self._written = time.monotonic()
        with _alone(self._path.parent), suppress(FileNotFoundError, ValueError, RecursionError):
            made = json.loads(self._path.read_text(encoding="utf-8"))
            others = _plans_in(made)
            plans = others | {
                name: _joined([*others.get(name, ()), *runs]) for name, runs in self.runs.items()
            }
            if plans != others:
                with atomic_path(self._path) as temporary:
                    temporary.write_text(json.dumps(made | {"plans": plans}, indent=2) + "\n")

    def __str__(self):
        names = list(self.runs)
        some = ", ".join(names[:SHOWN]) + (
            f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        )
        return f"plan{'s' if len(names) > 1 else ''} {some}"


def _plans_in(made):
    """Return the runs of a manifest's plans by their names. Raises ValueError for anything else."""
    plans = made.get("plans", {}) if isinstance(made, dict) else None
    if not isinstance(plans, dict) or not all(
        isinstance(runs, list)
        and all(isinstance(run, list) and [*map(type, run)] == [int, int] for run in runs)
        for runs in plans.values()
    ):
        raise ValueError("plans that are no runs of frames")
    return plans


def _joined(runs):
    """Runs of numbers in order, those that meet as one."""
    found: list[list[int]] = []
    for first, last in sorted(runs):
        if found and first <= found[-1][1] + 1:
            found[-1][1] = max(last, found[-1][1])
        else:
            found.append([first, last])
    return found


@contextmanager
def _alone(folder: Path):
    """While no other process of this system is in here for the same folder, if the system can tell."""
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


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
