"""Temporary files whose names say which process writes them, so that those of killed processes can be removed.

A name is .gpusim-HOST-BOOT-PID-START-RANDOM. A process is known by its number and its start: numbers are used again.
"""

import functools
import os
import re
import shutil
import sys
import time
import uuid
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

PREFIX = ".gpusim-"
NAME = re.compile(
    r"\.gpusim-([0-9a-f]{8})-([0-9a-f]{8})-([1-9][0-9]{0,8})-([0-9]*)-[0-9a-f]{8}(\..*)?"
)


def temporary_name(suffix: str = "") -> str:
    """Return a new name for a temporary file or folder of this process."""
    host, boot = _place()
    pid = os.getpid()
    return f"{PREFIX}{host}-{boot}-{pid}-{_start(pid) or ''}-{uuid.uuid4().hex[:8]}{suffix}"


def remove_leftovers(folder):
    """Remove temporary files and folders in `folder` whose processes have ended, as far as that is allowed.

    Those of other hosts and containers stay, as nobody here can tell. On Windows all stay.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if (match := NAME.fullmatch(entry.name)) and _has_ended(entry, *match.groups()[:4]):
                with suppress(OSError):
                    shutil.rmtree(entry.path) if entry.is_dir(follow_symlinks=False) else os.unlink(
                        entry.path
                    )


@functools.cache
def remove_leftovers_once(folder):
    """Do `remove_leftovers` if this process has not done so: a folder can have many files."""
    remove_leftovers(folder)


def _has_ended(entry, host, boot, pid, start):
    """Whether the process that writes a temporary file has ended for certain."""
    here, now = _place()
    if os.name != "posix" or host != here:
        return False
    if boot == now:
        return not _is_alive(int(pid), start)
    # of an earlier boot; what a copy of this host, or another container of its name, writes now is newer than the boot
    return sys.platform == "linux" and entry.stat(
        follow_symlinks=False
    ).st_mtime < time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def _is_alive(pid, start):
    """Whether a process of this system is there, and is the one that started then; True if that is not known."""
    try:
        os.kill(pid, 0)  # sends nothing
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        pass
    return _start(pid) in (start, "")


def _start(pid):
    """Start of a process since the boot in ticks, "" if the system does not say, None if it has ended.

    Source: proc_pid_stat(5), fields 3 (state) and 22; the second is a name in brackets.
    """
    fields = _read(f"/proc/{pid}/stat").rpartition(")")[2].split()
    return "" if len(fields) < 20 else None if fields[0] in "ZX" else fields[19]


@functools.cache
def _place():
    """Digests of this host, and of its boot with the container whose process numbers count."""
    import platform

    boot = _read("/proc/sys/kernel/random/boot_id")
    with suppress(OSError):
        boot += os.readlink("/proc/self/ns/pid")
    return _digest(
        platform.node() + (_read("/etc/machine-id") if boot else str(uuid.getnode()))
    ), _digest(boot)


def _digest(text):
    return sha256(text.encode()).hexdigest()[:8]


def _read(path):
    """Text of a system's file, "" if it has none."""
    with suppress(OSError):
        return Path(path).read_text(errors="replace")
    return ""
