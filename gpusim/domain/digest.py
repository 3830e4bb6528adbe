"""Digests of values: equal values have the same digest in every process."""

from dataclasses import fields, is_dataclass
from hashlib import sha256

import numpy as np


def digest(value) -> str:
    """Return a digest of 16 hexadecimal digits.

    The value consists of dataclasses, arrays, tuples, lists, dicts, numbers and strings; a Camera,
    for example.
    """
    found = sha256()
    _add(found, value)
    return found.hexdigest()[:16]


def _add(found, value):
    if is_dataclass(value):
        found.update(type(value).__name__.encode())
        for field in fields(value):
            if not field.metadata.get("digest", True):
                continue
            found.update(field.name.encode())
            _add(found, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        found.update(
            repr((value.dtype.str, value.shape)).encode() + np.ascontiguousarray(value).tobytes()
        )
    elif isinstance(value, list | tuple | dict):
        items = list(value.items() if isinstance(value, dict) else value)
        found.update(f"{type(value).__name__} {len(items)}".encode())
        for item in items:
            _add(found, item)
    else:
        found.update(repr(value).encode())
