"""Drivers' folders of compiled kernels: damaged files go, a full folder is replaced.

Drivers trust these files. PoCL aborts at a truncated file and runs code with a flipped bit; Warp
raises or crashes. The checksums of each program's files are therefore stored, and compared before
the files are loaded.
"""

import atexit
import functools
import hashlib
import json
import logging
import os
import shutil
import struct
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path

from gpusim.domain.errors import DeviceError
from gpusim.domain.leftovers import PREFIX, remove_leftovers, temporary_name

# of the header: start of the section table; size and count of its entries
ELF_TABLE = (slice(40, 48), slice(58, 62))
ROOM = 2**25  # [byte] that must be free: kernels for a few cameras take half of it
LARGEST = 2**21  # [byte] that quotas and limits must allow for one file
SUMS = "gpusim-sums.json"  # next to the files of a program
CHANGING = (
    SUMS,
    PREFIX,
    "last_accessed",
)  # beginnings of names of files that no build writes
log = logging.getLogger(__name__)


def lent_folder() -> Path:
    """Return an empty folder that is removed with the process, even with a killed one (later).

    Raises:
        DeviceError: No folder for temporary files has room.
    """
    places = ["/dev/shm", "/var/tmp"]
    with suppress(OSError):  # it tries to write
        places.insert(0, tempfile.gettempdir())
    for place in filter(os.path.isdir, places):
        with suppress(OSError):
            remove_leftovers(place)
            folder = Path(place, temporary_name())
            folder.mkdir(0o700)
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            if has_room(folder):
                return folder
    raise DeviceError(
        f"no room for compiled kernels: wanted {ROOM >> 20} MiB in the user's cache folder or in one of "
        f"{', '.join(places)}; free some, or set TMPDIR"
    )


def has_room(folder: Path) -> bool:
    """Return whether files can be created in the folder and have room. Create it if necessary."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(LARGEST))  # within quotas and limits
        return shutil.disk_usage(folder).free >= ROOM
    except OSError:
        return False


_used: set[Path] = set()  # programs that this process has loaded or built, or their whole cache


def prepare_opencl():
    """Make PoCL's cache usable before PoCL is loaded."""
    folder = pocl_folder()
    if folder is None:  # no home folder: PoCL takes the system's folder for temporary files
        return
    if not has_room(folder):
        os.environ["POCL_CACHE_DIR"] = str(lent_folder())
    weakref.finalize(log, _note_used)  # after the devices have ended


def use(program: Path):
    """Record the checksums of a program's files when the process ends.

    program: its folder, or PoCL's folder of all programs.
    """
    _used.add(program)


def _note_used():
    folder = pocl_folder()
    for program in folder.glob("??/*") if folder in _used else _used:
        note(program)


@functools.cache
def prepare_build(folder: Path) -> bool:
    """Remove damaged programs from PoCL's cache, once, and return whether all are sound then.

    A build from text would load the one that it finds there.
    """
    # files in the place of folders of programs
    strays = [path for path in folder.glob("??") if not path.is_dir()]
    return keep_sound([*strays, *folder.glob("??/*")])


def pocl_folder() -> Path | None:
    """Return PoCL's folder of compiled kernels; None without a home folder."""
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        return None
    return Path(os.environ.get("POCL_CACHE_DIR") or home / "pocl" / "kcache")


def keep_sound(programs) -> bool:
    """Remove damaged programs (folders of files) and log it; return False if one stays."""
    damaged = [
        program
        for program in programs
        if not (program.name.startswith("tempfile") or is_sound(program))
    ]
    for program in damaged:
        remove(program)
    if damaged:
        log.warning(
            "gpusim: %d compiled program%s in %s %s damaged, and built again",
            len(damaged),
            "s" if len(damaged) > 1 else "",
            damaged[0].parent,
            "were" if len(damaged) > 1 else "was",
        )
    return not any(os.path.lexists(program) for program in damaged)


def remove(program: Path):
    """Remove the files of a program, or anything in their place, if permitted."""
    shutil.rmtree(program, ignore_errors=True)
    with suppress(OSError):
        program.unlink()


def is_sound(program: Path) -> bool:
    """Return whether a program's files are as recorded, and files without a record are complete.

    A file with the recorded size and times is not read: 0.1 ms a program instead of 1.
    """
    try:
        noted, found = _read(program), _files(program)
        for name, (state, checksum) in noted.items():
            if found[name] != state and _checksum(program / name) != checksum:
                return False
        return all(_is_whole(program / name) for name in found.keys() - noted.keys())
    except (OSError, KeyError, TypeError, ValueError, RecursionError):
        return False


def note(program: Path):
    """Record the checksums of a program's files, if possible."""
    with suppress(OSError, KeyError, TypeError, ValueError, RecursionError):
        noted, found = _read(program), _files(program)
        if not found or {name: state for name, (state, _) in noted.items()} == found:
            return
        sums = noted  # damage since then is found when it is loaded
        for name, state in found.items():
            if name not in noted or noted[name][0] != state:
                checksum = _checksum(program / name)
                if name not in noted or noted[name][1] == checksum:
                    sums[name] = [state, checksum]
        remove_leftovers(program)
        temporary = program / temporary_name(".json")
        try:
            temporary.write_text(json.dumps(sums))
            temporary.replace(program / SUMS)
        except OSError:
            temporary.unlink(missing_ok=True)


def _read(program):
    """Return name -> (state, checksum) as recorded; none if nothing was. Raise like JSON."""
    try:
        return dict(json.loads((program / SUMS).read_bytes()))
    except FileNotFoundError:
        if os.path.lexists(program / SUMS):  # a link to nowhere
            raise
        return {}


def _files(program):
    """Return name -> state of a program's files: size and times, which every write changes."""
    found = {}
    for folder, _, names in os.walk(program, onerror=_raise):
        for name in names:
            # another process is writing it
            if not name.startswith(CHANGING) and not name.endswith(".temp"):
                path = os.path.join(folder, name)
                state = os.stat(path)
                found[os.path.relpath(path, program)] = [
                    state.st_size,
                    state.st_mtime_ns,
                    state.st_ctime_ns,
                ]
    return found


def _raise(error):
    raise error


def _checksum(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_whole(path):
    """Return whether a file without a record is complete; formats other than PoCL's pass."""
    return {".bc": _is_whole_bitcode, ".so": _is_whole_elf}.get(path.suffix, os.path.isfile)(path)


def _is_whole_bitcode(path):
    """Return whether the blocks of LLVM bitcode fill the file.

    Each block's header has its length in words of 4 bytes.
    """
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(4) != b"BC\xc0\xde":
                return False
            while (place := file.tell()) < size:
                kind, length = struct.unpack("<II", file.read(8))
                if kind & 3 != 1 or place + 8 + 4 * length > size:  # 1: a block begins
                    return False
                file.seek(4 * length, os.SEEK_CUR)
    except (OSError, struct.error):
        return False
    return True


def _is_whole_elf(path):
    """Return whether a shared library contains its whole section table, its last part."""
    try:
        with open(path, "rb") as file:
            header = file.read(64)
            (begin,), (entry, count) = (
                struct.unpack(form, header[part])
                for form, part in zip(("<Q", "<HH"), ELF_TABLE, strict=True)
            )
            return (
                header[:4] == b"\x7fELF"
                and begin + entry * count <= os.fstat(file.fileno()).st_size
            )
    except (OSError, struct.error):
        return False
