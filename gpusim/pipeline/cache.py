"""What was computed before, given again while what it was made of stays the same."""

import itertools
from dataclasses import dataclass, fields, is_dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from gpusim.backends import Device
from gpusim.backends.tape import Tape, noted

PLAIN = (str, bytes, int, float, bool, slice, type(None), np.generic)
NUMBERS = (int, float, str, bool)
OTHER, REPLACED, REFILLED, SAME = range(4)  # how a key relates to another


@dataclass(eq=False, slots=True)
class One:
    """What another step gave, or a user: the same while it is one object of one version, whatever its values."""

    value: Any
    version: int = 0


class Kept:
    """One value of each name, with the key that it was made for.

    device: where steps that are made again and again run on tapes (see `gpusim.backends.tape`), and then write to the
    arrays that they gave before; by default every value is new. One thread at a time then; threads may share others.
    """

    def __init__(self, device: Device | None = None):
        self._device = None if device is None or device.kind == "numpy" else device
        self._entries: dict[str, tuple[Any, Any, Tape | None]] = {}
        self._owners: WeakKeyDictionary = (
            WeakKeyDictionary()
        )  # of arrays that are written again: step and version
        self._versions = itertools.count(1)

    def beside(self) -> "Kept":
        """Another one, in whose keys arrays of this one are known; both end together."""
        other = Kept(self._device)
        other._owners, other._versions = self._owners, self._versions
        return other

    def one(self, value) -> One:
        """The value as part of a key: the same until the step that made it writes to it again."""
        return One(value, self._owners.get(value, ("", 0))[1] if self._is_array(value) else 0)

    def __call__(self, name: str, key, make, adjust=None):
        """What `make()` gave for a key that is the same, see `compared`, or gives now.

        key: all that `make` depends on. Where nothing but the contents of its arrays is new, or others of the same form
        are in their places, its kernels are started again without it. adjust: function that sets other numbers in the
        kernels of a tape, where the last part of the key alone is other.
        """
        found = self._entries.get(name)  # read once: another thread may put its own there
        change, has_numbers = OTHER, True
        if found is not None:
            change = (
                compared(found[0], key) if adjust is None else compared(found[0][:-1], key[:-1])
            )
            has_numbers = adjust is None or compared(found[0][-1], key[-1]) == SAME
            if change == SAME and has_numbers:
                return found[1]
        tape = None if self._device is None else Tape() if found is None else found[2]
        try:
            if (
                found is not None
                and change != OTHER
                and tape is not None
                and tape.is_replayable
                and (change != REPLACED or self._replaced(tape, found, key))
            ):
                if not has_numbers:
                    adjust(tape)
                tape.replay()
                value = found[1]
            else:
                with noted(tape):
                    value = make()
        except BaseException:
            if tape is not None:  # its arrays may be half written
                self._entries.pop(name, None)
            raise
        self._entries[name] = key, value, tape
        if self._device is not None:
            self._renew(name, None if found is None else found[1], value)
        return value

    @staticmethod
    def _replaced(tape, found, key) -> bool:
        """Whether the noted kernels now have the key's arrays in the places of others, and give nothing of those."""
        others = [
            (own.value, its.value)
            for own, its in zip(ones(found[0]), ones(key), strict=True)
            if own.value is not its.value
        ]
        parts = found[1] if isinstance(found[1], tuple) else (found[1],)
        return not any(part is old for part in parts for old, _ in others) and tape.replaced(others)

    def on_host(self) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
        """Steps that did more than start kernels when last made on their tapes: see `gpusim.pipeline.host`.

        Each with the stages in which the host read values of the device, and those that worked on the host.
        """
        taped = [(name, tape) for name, (_, _, tape) in self._entries.items() if tape is not None]
        return [
            (name, tuple(tape.reads), tuple(tape.host_work))
            for name, tape in taped
            if not tape.is_replayable
        ]

    def _renew(self, name, before, value):
        """Tell the arrays that a step wrote to from what they were."""
        owners, none = self._owners, (name, 0)
        parts = value if isinstance(value, tuple) else (value,)
        if before is not value:
            for part in before if isinstance(before, tuple) else (before,):
                if (
                    self._is_array(part)
                    and owners.get(part, ("", 0))[0] == name
                    and not any(part is other for other in parts)
                ):
                    del owners[part]
        for part in parts:
            if self._is_array(part) and owners.get(part, none)[0] == name:
                owners[part] = name, next(self._versions)  # what a step hands on is not its own

    def _is_array(self, value):
        return self._device is not None and isinstance(value, self._device.array_type)

    def __reduce__(self):
        return Kept, (self._device,)  # made anew


def same(a, b) -> bool:
    """Whether two keys name one thing: equal numbers, texts and arrays, field by field; else one object."""
    return compared(a, b) == SAME


def compared(a, b) -> int:
    """SAME where two keys name one thing; REFILLED where some of its arrays were written to since; else OTHER.

    REPLACED where other arrays of devices, of the same shapes and types, are in the places of some.
    """
    if a is b:
        return SAME
    if type(a) is not type(b):
        return OTHER
    if isinstance(a, One):
        if a.value is b.value:
            return SAME if a.version == b.version else REFILLED
        return REPLACED if _alike(a.value, b.value) else OTHER
    if isinstance(a, PLAIN):
        return SAME if a == b else OTHER
    if isinstance(a, tuple | list):
        return _all(a, b) if len(a) == len(b) else OTHER
    if isinstance(a, np.ndarray):
        return SAME if a.dtype == b.dtype and np.array_equal(a, b) else OTHER
    if is_dataclass(a):
        names = [part.name for part in fields(a)]
        return _all([getattr(a, name) for name in names], [getattr(b, name) for name in names])
    return OTHER


def _alike(a, b):
    """Whether these are two arrays of devices that kernels take for each other."""
    return (
        type(a) is type(b)
        and not isinstance(a, np.ndarray)
        and hasattr(a, "dtype")
        and a.shape == b.shape
        and a.dtype == b.dtype
    )


def ones(key) -> list[One]:
    """What is given as One in a key, in order."""
    if isinstance(key, One):
        return [key]
    return [one for part in key for one in ones(part)] if isinstance(key, tuple | list) else []


def _all(a, b):
    """The least of what pairs of parts are."""
    least = SAME
    for own, its in zip(a, b, strict=True):
        if own is its or (type(own) in NUMBERS and type(own) is type(its) and own == its):
            continue
        found = compared(own, its)
        if found == OTHER:
            return OTHER
        least = min(least, found)
    return least
