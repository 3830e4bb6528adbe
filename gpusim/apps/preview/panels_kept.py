"""Results that panels keep while what they are computed from stays the same."""

from collections.abc import Callable
from typing import Any

from gpusim.pipeline.cache import same


class Kept:
    """One result by name."""

    def __init__(self):
        self._known: dict[str, tuple[tuple, Any]] = {}

    def __call__(self, name: str, key: tuple, make: Callable[[], Any]) -> Any:
        """Return `make()`, or its last result of this name if that had the same key."""
        known = self._known.get(name)
        if known is None or not same(known[0], key):
            known = self._known[name] = key, make()
        return known[1]
