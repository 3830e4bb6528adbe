"""What was computed before, given again while what it was made of stays the same."""

from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

PLAIN = (str, bytes, int, float, bool, slice, type(None), np.generic)


@dataclass(frozen=True, eq=False)
class One:
    """What another step gave, or a user: the same while it is one object, whatever its values."""

    value: Any


class Kept:
    """One value of each name, with the key that it was made for."""

    def __init__(self):
        self._values: dict[str, tuple[Any, Any]] = {}

    def __call__(self, name: str, key, make):
        """What `make()` gave for a key that is the same, see `same`, or gives now."""
        found = self._values.get(name)  # read once: another thread may put its own there
        if found is None or not same(found[0], key):
            found = self._values[name] = key, make()
        return found[1]

    def __getstate__(self):
        return {"_values": {}}  # arrays of a device, made anew


def same(a, b) -> bool:
    """Whether two keys name one thing: equal numbers, texts and arrays, field by field; else one object."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, One):
        return a.value is b.value
    if isinstance(a, PLAIN):
        return bool(a == b)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    if is_dataclass(a):
        return all(same(getattr(a, part.name), getattr(b, part.name)) for part in fields(a))
    return False
