"""How much memory this computer has left, and the refusal of what would not fit."""

import os
from pathlib import Path

from gpusim.domain.errors import DoesNotFit


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
