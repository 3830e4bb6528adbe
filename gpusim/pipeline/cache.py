"""A cache of computed values. A value is computed again only if one of its inputs has changed."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import FunctionType, MethodType
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.backends.tape import Tape, recording
from gpusim.domain.content import Content
from gpusim.domain.scene import Scene
from gpusim.optics.blas import one_core
from gpusim.planner.facts import Facts
from gpusim.planner.plan import Plan

# equal only if they are the same object; their arrays are not compared
BY_IDENTITY = (Scene, Content, Plan, Facts)
PLAIN = (str, bytes, int, float, bool, slice, type(None), np.generic, MethodType)
NUMBERS = (int, float, str, bool)
SEQUENCES = (tuple, list)
OTHER, REPLACED, REFILLED, SAME = range(4)  # how a key relates to another

# attribute of each array that a step rewrites: the step, and the version of the contents
_WRITER = "_written_by"
_VERSIONS = itertools.count(1)
NOBODY = (None, 0)


@dataclass(eq=False, slots=True)
class One:
    """A device array in a key, with the version of its contents."""

    value: Any
    version: int = 0


class Cache:
    """Results of functions, stored by name until an argument changes.

    Use a cache with a device in one thread at a time. Threads may share a cache without a device.

    Args:
        device: Device on which repeated computations are recorded on tapes (see `gpusim.backends.tape`). A repeated
            computation then overwrites the arrays of the last one. None: each result is a new array.
    """

    def __init__(self, device: Device | None = None):
        self._device = None if device is None or device.kind == "numpy" else device
        # True if repeated computations overwrite the arrays of the last ones
        self.is_taped = self._device is not None
        # of the arrays whose contents have versions
        self._array_type = () if self._device is None else self._device.array_type
        self._entries: dict[str, tuple[Any, Any, Tape | None]] = {}
        self._token = object()
        # token of the `gpusim.pipeline.step.Values` that used the cache last
        self.user: object | None = None

    def __call__(self, name: str, function: Callable, *args, **kwargs) -> Any:
        """Return `function(*args, **kwargs)`, computed only if an argument has changed since the last call.

        The arguments are the key. The function must not depend on anything else, so it must be no bound method and have
        no closure.
        """
        return self.run(name, function, args, kwargs, {})

    def run(
        self, name: str, function: Callable, args: tuple, kwargs: Mapping, numbers: Mapping
    ) -> Any:
        """Return `function(*args, **kwargs, **numbers)`, see `__call__`.

        Args:
            name: Name of the result. One result is stored per name.
            function: The function.
            args: Values, also device arrays. If only the contents of arrays have changed, or arrays are replaced by
                others of the same shape and type, the recorded kernels run again without the function.
            kwargs: Further arguments that do not change from frame to frame.
            numbers: Numbers that change from frame to frame. If only they have changed, the recorded kernels run again
                with the new numbers.

        Returns:
            The result of the function.
        """
        key = function, self.with_versions(args), kwargs
        found = self._entries.get(name)  # read once: another thread may replace it
        change, has_numbers, changed = OTHER, True, {}
        if found is not None:
            of, its, options, old = found[0]
            if of is function:
                change = _compare_all(its, key[1], BY_IDENTITY) if len(its) == len(args) else OTHER
                if options is not kwargs and change != OTHER:
                    change = min(change, compare(options, kwargs))
            if old != numbers:
                changed = {n: value for n, value in numbers.items() if old.get(n, NOBODY) != value}
                has_numbers = not changed
            if change == SAME and has_numbers:
                return found[1]
        if found is None or found[0][0] is not function:
            _require_pure(name, function)
        tape = None if self._device is None else Tape() if found is None else found[2]
        try:
            if (
                found is not None
                and change != OTHER
                and tape is not None
                and tape.is_replayable
                and (has_numbers or tape.renumber(changed))
                and (change != REPLACED or self._replace_arrays(tape, found, key))
            ):
                tape.replay()
                value = found[1]
            else:
                with recording(tape), one_core():
                    value = function(*args, **kwargs, **numbers)
        except BaseException:
            if tape is not None:  # its arrays may be half written
                self._entries.pop(name, None)
            raise
        self._entries[name] = (*key, numbers), value, tape
        if self._device is not None:
            self._set_versions(name, None if found is None else found[1], value)
        return value

    def with_versions(self, value):
        """Return a value for a key: device arrays get the version of their contents."""
        kind = type(value)
        if kind is tuple or kind is list:
            return tuple([self.with_versions(part) for part in value])
        if isinstance(value, self._array_type):
            return One(value, version_of(value))
        return value

    @staticmethod
    def _replace_arrays(tape, found, key) -> bool:
        """Replace the arrays of the recorded kernels by those in a new key; return False if it is impossible."""
        others = [
            (own.value, its.value)
            for own, its in zip(ones(found[0][1]), ones(key[1]), strict=True)
            if own.value is not its.value
        ]
        parts = found[1] if isinstance(found[1], tuple) else (found[1],)
        return not any(part is old for part in parts for old, _ in others) and tape.replace_arrays(
            others
        )

    def tape_of(self, name: str) -> Tape | None:
        """Return the tape of a result; None if it has none."""
        found = self._entries.get(name)
        return None if found is None else found[2]

    def expire(self, name: str) -> list[tuple[Any, tuple]]:
        """Forget for which arguments a result was computed: something else rewrites its arrays.

        Returns:
            These arrays, each with its writer, for `renew`.
        """
        key, value, tape = self._entries[name]
        if key[0] is not None:
            self._entries[name] = (None, (), {}, {}), value, tape
            if tape is not None and not tape.commands:
                tape.forget()  # its constants may be written to, too
        self._set_versions(name, value, value)
        own = self._token, name
        parts = value if isinstance(value, tuple) else (value,)
        return [(part, own) for part in parts if getattr(part, _WRITER, NOBODY)[0] == own]

    def host_accesses(self) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
        """Return results whose last computation did not only start kernels.

        Returns:
            For each its name, the stages in which the host read device values, and the stages computed on the host.
        """
        taped = [(name, tape) for name, (_, _, tape) in self._entries.items() if tape is not None]
        return [
            (name, tuple(tape.reads), tuple(tape.host_work))
            for name, tape in taped
            if not tape.is_replayable
        ]

    def _set_versions(self, name, before, value):
        """Give the arrays that a step has rewritten a new version number."""
        own = self._token, name
        parts = value if isinstance(value, tuple) else (value,)
        if before is not value:
            for part in before if isinstance(before, tuple) else (before,):
                if (
                    isinstance(part, self._array_type)
                    and getattr(part, _WRITER, NOBODY)[0] == own
                    and not any(part is other for other in parts)
                ):
                    delattr(part, _WRITER)
        for part in parts:
            # an array passed on from another step keeps its version
            if isinstance(part, self._array_type) and getattr(part, _WRITER, (own, 0))[0] == own:
                setattr(part, _WRITER, (own, next(_VERSIONS)))

    def __reduce__(self):
        return Cache, (self._device,)  # empty


def version_of(array: Any) -> int:
    """Return the version of a device array's contents; 0: no step has rewritten them."""
    return getattr(array, _WRITER, NOBODY)[1]


def renew(written: list[tuple[Any, tuple]]) -> None:
    """Give arrays of `Cache.expire` new versions: they are rewritten once more."""
    for array, own in written:
        setattr(array, _WRITER, (own, next(_VERSIONS)))


def _require_pure(name, function):
    """Raise TypeError if a function depends on more than its arguments."""
    if isinstance(function, MethodType) and not isinstance(function.__self__, type):
        raise TypeError(
            f"{name}: {function.__qualname__} is bound to an object; pass the object as an argument"
        )
    if isinstance(function, FunctionType) and function.__closure__:
        # a stage's public form closes over its own name
        inner = getattr(function, "__wrapped__", None)
        if inner is None:
            raise TypeError(
                f"{name}: {function.__qualname__} has a closure; pass what it uses as arguments"
            )


def same(a, b) -> bool:
    """Return True if two values are equal. Dataclasses are compared field by field, other objects by identity."""
    return compare(a, b, ()) == SAME


def compare(a, b, by_identity: tuple = BY_IDENTITY) -> int:
    """Return how two keys relate.

    by_identity: types that are compared by identity.

    Returns:
        SAME for equal keys, REFILLED if only contents of device arrays differ, REPLACED if device arrays are replaced
        by others of the same shape and type, else OTHER.
    """
    if a is b:
        return SAME
    kind = type(a)
    if kind is not type(b):
        return OTHER
    if kind is One:
        if a.value is b.value:
            return SAME if a.version == b.version else REFILLED
        return REPLACED if _is_replaceable(a.value, b.value) else OTHER
    if isinstance(a, SEQUENCES):
        return _compare_all(a, b, by_identity) if len(a) == len(b) else OTHER
    if isinstance(a, PLAIN):
        return SAME if a == b else OTHER
    if isinstance(a, by_identity):
        return OTHER
    if isinstance(a, dict):
        if list(a) != list(b):
            return OTHER
        return _compare_all(list(a.values()), list(b.values()), by_identity)
    if isinstance(a, np.ndarray):
        return SAME if a.dtype == b.dtype and np.array_equal(a, b) else OTHER
    if is_dataclass(a):
        names = [part.name for part in fields(a)]
        own, its = ([getattr(one, name) for name in names] for one in (a, b))
        return _compare_all(own, its, by_identity)
    return OTHER


def _is_replaceable(a, b):
    """Return True if kernels can use one device array instead of the other."""
    return (
        type(a) is type(b)
        and not isinstance(a, np.ndarray)
        and hasattr(a, "dtype")
        and a.shape == b.shape
        and a.dtype == b.dtype
    )


def ones(key) -> list[One]:
    """Return the device arrays in a key, in order."""
    if isinstance(key, One):
        return [key]
    return [one for part in key for one in ones(part)] if isinstance(key, SEQUENCES) else []


def _compare_all(a, b, by_identity):
    """Return the lowest relation between pairs of parts."""
    least = SAME
    for own, its in zip(a, b, strict=True):
        if own is its:
            continue
        kind = type(own)
        if kind is One and kind is type(its) and own.value is its.value:
            if own.version != its.version and least > REFILLED:
                least = REFILLED
            continue
        if kind in NUMBERS and kind is type(its) and own == its:
            continue
        found = compare(own, its, by_identity)
        if found == OTHER:
            return OTHER
        if found < least:
            least = found
    return least
