"""How much memory this computer has left, and the refusal of what would not fit."""

import os
from pathlib import Path

import numpy as np

from gpusim.domain.errors import DoesNotFit


class Pinned(np.ndarray):
    """An array in host memory that a device copies from at the full rate of its bus: see `Device.pinned`.

    Scenes do not look at its values, which are written as a video goes on. What is wrong with them is found on the
    device, by the frame that is made of them or the next.
    """


def host_memory() -> int:
    """Memory that can be had [byte]: what Linux calls available, elsewhere all there is."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError):  # no sysconf on Windows: the allocation itself has to fail
        return 2**63


def require_memory(what: str, needed: int):
    """Raise DoesNotFit, with figures, when `needed` [byte] exceeds what this computer has."""
    available = host_memory()
    if needed > available:
        raise DoesNotFit(what, min(needed, 2**63), available, "this computer")
