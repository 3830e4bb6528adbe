"""Free memory of this computer, and the check that a request fits."""

import os
from pathlib import Path

import numpy as np

from gpusim.domain.errors import DoesNotFit


class Pinned(np.ndarray):
    """An array in host memory that a device reads at the full rate of its bus: see `Device.pinned`.

    Scenes do not check its values, because a video changes them later. The device finds wrong
    values when it computes the frame, or the next one.
    """


def host_memory() -> int:
    """Return the available memory [byte]: MemAvailable on Linux, elsewhere all physical memory."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError):  # no sysconf on Windows: the allocation itself will fail
        return 2**63


def require_memory(what: str, needed: int):
    """Raise DoesNotFit if `needed` [byte] exceeds the available memory."""
    available = host_memory()
    if needed > available:
        raise DoesNotFit(what, min(needed, 2**63), available, "this computer")
