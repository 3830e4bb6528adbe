"""Temporary files whose names identify the process that writes them.

Files of killed processes can therefore be removed. A name is
.gpusim-HOST-BOOT-PID-START-RANDOM. Number and start time identify a process, because numbers are
reused.
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
    return f"{PREFIX}{host}-{boot}-{pid}-{_own_start(pid)}-{uuid.uuid4().hex[:8]}{suffix}"


def remove_leftovers(folder):
    """Remove temporary files and folders whose processes have ended, if permissions allow it.

    Files of other hosts and containers stay, because the state of their processes is unknown here.
    On Windows all files stay.
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
    """Call `remove_leftovers` once per process: a folder can have many files."""
    remove_leftovers(folder)


def _has_ended(entry, host, boot, pid, start):
    """Return True if the process that writes a temporary file has certainly ended."""
    here, now = _place()
    if os.name != "posix" or host != here:
        return False
    if boot == now:
        return not _is_alive(int(pid), start)
    # Another boot id: a copy of this host, or a container with its name, may write now. Files older
    # than this boot are certainly leftovers.
    return sys.platform == "linux" and entry.stat(
        follow_symlinks=False
    ).st_mtime < time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def _is_alive(pid, start):
    """Return True if the process exists and has this start time; also if that is not known."""
    try:
        os.kill(pid, 0)  # sends nothing
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        pass
    return _start(pid) in (start, "")


def _start(pid):
    """Return the start time of a process since the boot in ticks.

    "" if the system does not report it, None if the process has ended. Source: proc_pid_stat(5),
    fields 3 (state) and 22; the second field is a name in brackets.
    """
    fields = _read(f"/proc/{pid}/stat").rpartition(")")[2].split()
    return "" if len(fields) < 20 else None if fields[0] in "ZX" else fields[19]


@functools.cache
def _own_start(pid):
    """Return the start time of this process; pid: its number, another one after a fork."""
    return _start(pid) or ""


@functools.cache
def _place():
    """Return digests of the host, and of its boot with the container that numbers its processes."""
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
    """Return the text of a system file, "" if it does not exist."""
    with suppress(OSError):
        return Path(path).read_text(errors="replace")
    return ""
