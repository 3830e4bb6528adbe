"""Manifests: a file next to a video or data set that records everything its frames depend on.

A run that resumes it, or another shard, must have the same manifest.
"""

import json
import os
import time
from collections.abc import Callable, Iterable
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim import __version__
from gpusim.backends.probe import hardware_id
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadFile
from gpusim.domain.leftovers import remove_leftovers
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PARTS = ".parts"  # suffix of a folder of incomplete work
SECONDS = 1.0  # between two updates of the plans in a manifest
SHOWN = 3  # names of plans, in a message
LARGEST = 2**26  # [byte] of a manifest
ENDS = 2**16  # [byte] at each end of a file that its digest covers


@contextmanager
def keep_manifest(path: Path, made: dict, outputs: str, is_empty: Callable[[], bool]):
    """Write the manifest of a run, or check the existing one, while the run works.

    Temporary files that killed processes left in the folder are removed.

    Args:
        path: File of the manifest.
        made: Content, as plain data.
        outputs: Files that a new start has to remove, in words.
        is_empty: Function that returns whether nothing was written. If so, a new manifest is
            removed when the work fails.

    Raises:
        BadFile: If the existing manifest belongs to another run.
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
    """Another shard has written the manifest."""


def _keep(path, made, outputs):
    """Write the manifest, or check the existing one. Raises BadFile."""
    if not path.exists():
        with suppress(_IsThere), atomic_path(path) as temporary:
            temporary.write_text(json.dumps(made, indent=2) + "\n")
            try:
                os.link(temporary, path)  # only the first of several shards writes it
            except FileExistsError:
                raise _IsThere from None
            except OSError:
                pass  # a file system without links: the last shard writes it
    try:
        found = json.loads(read_text(path, "a manifest of a video", LARGEST))
        others = _find_differences(made, found)
        _plans_in(found)
    # RecursionError: of JSON, lists in lists
    except (ValueError, AttributeError, RecursionError) as error:
        raise BadFile(path, f"not a manifest ({error}); remove it and {outputs}") from error
    if others:
        names = ", ".join(others)
        raise BadFile(
            path, f"a run with other {names}; give -o another name, or remove it and {outputs}"
        )


def _find_differences(made, found):
    """Return the names of the entries that differ in another manifest; of tables, their keys."""
    names = []
    for name, value in made.items():
        other = found.get(name)
        keys = []
        if isinstance(value, dict) and isinstance(other, dict):
            keys = [key for key in value if other.get(key) != value[key]]
        names += keys or ([name] if other != value else [])
    return names


class Plans:
    """Plans of a video's frames, in its manifest: "plans", runs [first, last] of frames by name.

    Shards add theirs to one manifest. A context manager that writes them at its end.

    Args:
        path: File of the manifest.
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
        """Add the plan of a frame. The manifest is updated after SECONDS and after a segment."""
        self.runs[name] = _join_runs([*self.runs.get(name, ()), [number, number]])
        if is_last or time.monotonic() > self._written + SECONDS:
            self.write()

    def write(self):
        """Add the plans to the manifest, if it still exists. Raises BadFile."""
        self._written = time.monotonic()
        with _alone(self._path.parent), suppress(FileNotFoundError, ValueError, RecursionError):
            made = json.loads(self._path.read_text(encoding="utf-8"))
            others = _plans_in(made)
            plans = others | {
                name: _join_runs([*others.get(name, ()), *runs]) for name, runs in self.runs.items()
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
    """Return the runs of a manifest's plans by name. Raises ValueError if they are malformed."""
    plans = made.get("plans", {}) if isinstance(made, dict) else None
    if not isinstance(plans, dict) or not all(
        isinstance(runs, list)
        and all(isinstance(run, list) and [*map(type, run)] == [int, int] for run in runs)
        for runs in plans.values()
    ):
        raise ValueError("its plans are not runs of frames")
    return plans


def _join_runs(runs):
    """Return runs of numbers in order, with adjacent ones merged."""
    found: list[list[int]] = []
    for first, last in sorted(runs):
        if found and first <= found[-1][1] + 1:
            found[-1][1] = max(last, found[-1][1])
        else:
            found.append([first, last])
    return found


@contextmanager
def _alone(folder: Path):
    """Lock a folder against other processes, if the system can."""
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
    """Return a digest of a file's size, beginning and end; "" for a chart."""
    path = Path(path)
    if not path.is_file():
        return ""
    found = sha256(str(path.stat().st_size).encode())
    with path.open("rb") as file:
        found.update(file.read(ENDS))
        file.seek(max(path.stat().st_size - ENDS, 0))
        found.update(file.read(ENDS))
    return found.hexdigest()[:16]


def describe_run(
    simulator: "Simulator", files: Iterable, options: dict[str, str], **others: Any
) -> dict[str, Any]:
    """Return the content of a manifest: everything that the frames of a run depend on.

    Args:
        simulator: Camera and device.
        files: Names of the files that the frames show.
        options: Options of the command line as text, by name.
        others: More of the manifest, as plain data.
    """
    return {
        "gpusim": __version__,
        "camera": digest(simulator.camera),
        **others,
        "contents of files": [file_digest(name) for name in files],
        "options": options,
        "device": hardware_id(simulator.device),
    }
