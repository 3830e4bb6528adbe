"""A tape records a computation's requests to a device; a repeated computation reuses its results.

It then allocates, builds and copies nothing.
"""

import threading
import weakref
from collections.abc import Callable
from contextlib import contextmanager
from math import prod
from typing import Any

import numpy as np

from gpusim.backends.device import Device
from gpusim.backends.refusal import of_commands, of_launch, of_shape, of_values, refusable
from gpusim.domain.memory import to_host

SMALL = 1 << 16  # [byte] of constants whose values are compared; larger ones are copied again
LARGE = (
    1 << 22
)  # [byte] of arrays that a tape that cannot be replayed keeps only while they are used
HELD = "large", "view"  # requests whose results are recorded with a weak reference


class Tape:
    """The requests of one computation to one device, in order, for one thread at a time.

    When the computation runs again on its tape, each request is compared with the recorded one in
    its place. Equal requests get the recorded results: the same arrays, which are overwritten, and
    the same constants and kernels. From the first different request on, the tape is recorded again.
    The result thus never depends on the recording. `replay` starts only the recorded kernels,
    without the computation's host code. Its inputs must have the same memory and its numbers the
    same values; `is_replayable` says whether nothing else happened on the host.

    Attributes:
        reads: Stages in which the host read values of the device.
        host_work: Stages that worked on the host, as they report.
        commands: Recorded kernels and copies, in order.
        numbered: Recorded kernels that take numbers by name, each with these and the function that
            makes arguments of them.
        viewed: Arrays of which another form was requested.
        writes_anew: Whether arrays are new each time, for results that are kept; nothing can then
            be replayed.
    """

    def __init__(self, writes_anew: bool = False):
        self.writes_anew = writes_anew
        self._requests: list = []
        self._at = 0
        self.is_loose = False  # whether dropped arrays are forgotten
        self.commands: list = []
        self.numbered: list = []
        self.viewed: list = []
        self.reads: list[str] = []
        self.host_work: list[str] = []

    def begin(self):
        """Start (or restart) the computation."""
        self._at = 0
        self.is_loose = bool(self.reads or self.host_work) and not self.writes_anew
        self.commands, self.numbered, self.viewed = [], [], []
        self.reads, self.host_work = [], []

    def again(self, request, make, *args):
        """Return the recorded result of the request in this place, or record `make(*args)`."""
        if self._at < len(self._requests) and self._requests[self._at][0] == request:
            found = self._requests[self._at][1]
        else:
            del self._requests[self._at :]
            found = make(*args)
            self._requests.append((request, found))
        self._at += 1
        return found

    def held(self, request, make, *args, of=None):
        """Return the recorded array of the request in this place, or record `make(*args)`.

        of: array that it is a view of, if any; the recorded one must be, too.
        """
        found = self.again(request, lambda: [None, None, None])
        array = found[0]
        if array is None or (of is not None and found[2]() is not of):
            array = make(*args)
            found[:] = (
                None if self.is_loose else array,
                weakref.ref(array),
                of if of is None else weakref.ref(of),
            )
        return array

    def loosen(self):
        """Forget arrays that the computation has dropped: it cannot be replayed."""
        if self.is_loose or self.writes_anew:
            return
        self.is_loose = True
        for command in self.commands:
            command.release()
        self.commands, self.numbered, self.viewed = [], [], []
        kept = []
        for request, found in self._requests[: self._at]:
            if request[0] in HELD:
                found[0] = None
            if request[0] != "copy":
                kept.append((request, found))
        self._requests, self._at = kept, len(kept)

    def forget(self):
        """Forget all requests: something else writes to the recorded arrays."""
        self._requests.clear()

    def end(self):
        """Keep the arrays that are in use at the end: results, and arguments of kernels that may not have ended."""
        for request, found in self._requests if self.is_loose else ():
            if request[0] in HELD:
                found[0] = found[1]()

    def constant(self, values, make):
        """Return the recorded array if its values are equal, else record `make(values, dtype)`.

        The rest of the tape stays.
        """
        text = values.tobytes()
        found = self.again(("array", values.shape, values.dtype.str), list)
        if not found or found[0] != text:
            # the array may share the copy's memory
            found[:] = text, make(values.copy(), values.dtype)
        return found[1]

    def start(self, command):
        """Start a command and record it."""
        command.start()
        if self.is_loose:
            command.release()
        else:
            self.commands.append(command)

    def replace_arrays(self, others) -> bool:
        """Give the recorded kernels other arrays, pairs (old, new); False if one is not found.

        Nothing changes then. Kernels that read an array in another form have that form among their
        arguments, not the array itself.
        """
        return self._replace(others, True)

    def exchange(self, others) -> bool:
        """Give the recorded kernels that use an array another one, pairs (old, new); False if it is impossible.

        Unlike `replace_arrays`, not every old array has to be in use.
        """
        return self._replace(others, False)

    def _replace(self, others, is_each_used) -> bool:
        news = {id(old): new for old, new in others}
        if self.viewed and any(id(array) in news for array in self.viewed):
            return False
        users, used = [], set()
        for command in self.commands:
            own = [place for place in map(id, command.args) if place in news]
            if own:
                used.update(own)
                users.append(command)
        if is_each_used and len(used) < len(news):
            return False
        if len(others) > len(news) and any(
            id(old) in used and news[id(old)] is not new for old, new in others
        ):
            return False  # two for one
        for command in users:
            command.set(tuple([news.get(id(arg), arg) for arg in command.args]))
        return True

    @property
    def used(self) -> set[int]:
        """Identities of the arrays that the recorded kernels use, also in another form."""
        return {id(array) for array in self.viewed} | {
            id(arg) for command in self.commands for arg in command.args
        }

    def renumber(self, numbers) -> bool:
        """Give the recorded kernels other numbers by name; False, and nothing is done, unless they take all of them.

        See `Taped.launch`.
        """
        if not numbers.keys() <= {name for _, own, _ in self.numbered for name in own}:
            return False
        for place, (command, own, words) in enumerate(self.numbered):
            own = own | {name: value for name, value in numbers.items() if name in own}
            last = last_arguments(own, words)
            first = len(command.args) - len(last)
            command.set((*command.args[:first], *last), first)
            self.numbered[place] = command, own, words
        return True

    @property
    def is_replayable(self) -> bool:
        """Whether the recorded kernels are all there is to do."""
        return not (self.writes_anew or self.reads or self.host_work)

    def replay(self):
        """Start the recorded kernels again, for inputs in the same memory."""
        if self.commands:
            self.commands[0].device.start(self.commands)


class OwnTape(threading.local):
    """A tape per thread, on which results are new arrays; it is pickled empty.

    of: the computation that was recorded last, for its user. raw: the array that it wrote.
    """

    def __init__(self):
        self.tape, self.of, self.raw = Tape(writes_anew=True), (), None

    def __reduce__(self):
        return OwnTape, ()


class _Current(threading.local):
    tape: Tape | None = None


_current = _Current()


@contextmanager
def recording(tape: Tape | None):
    """Record requests to devices inside the block on the tape, or on none if it is None."""
    outer, _current.tape = _current.tape, tape
    if tape is not None:
        tape.begin()
    try:
        yield
    except BaseException:
        if tape is not None:
            tape._requests.clear()  # the last one may be incomplete
        raise
    else:
        if tape is not None:
            tape.end()
    finally:
        _current.tape = outer


def last_arguments(numbers, words=None) -> tuple:
    """Return a kernel's last arguments from numbers by name: as float, or as a function `words(**numbers)` says."""
    return tuple(map(float, numbers.values())) if words is None else words(**numbers)


class Copy:
    """A command that copies values between two arrays. args: target and source."""

    def __init__(self, device, target, source, *places):
        self.device, self.args, self.places = device, (target, source), places
        self.stage, self.name = device._clock.charged or "copies", "copy"

    def set(self, args):
        """Set other arrays of the same kinds."""
        self.args = args

    def release(self):
        """Forget the arrays."""
        self.args = ()

    def start(self):
        """Copy in turn with the kernels."""
        self.device._copy(self.stage, *self.args, *self.places)


class Taped(Device):
    """A device whose requests can be recorded; backends define its underscored attributes.

    Its launches are commands: `set(args)` gives a command other arguments of the same kinds,
    `start()` starts it, `release()` forgets the arrays; `stage` and `name` belong to its kernel,
    `device` is its device. Memory that the driver refuses raises OutOfMemory.
    """

    _home: Any = None  # `device` of this device's arrays, if not itself
    # (values, dtype): an array of this device with these values, which are not one of its arrays
    _array: Callable[..., Any]
    # (array, dtype): an array of this device with this type, contiguous: itself or a copy
    _fitting: Callable[..., Any]
    _empty: Callable[..., Any]  # (shape, dtype)
    _reshape: Callable[..., Any]  # (array, shape)
    _numpy: Callable[..., Any]  # (array)
    _dtype: Callable[..., np.dtype]  # (array)
    # (stage, target, source, count, start, to): copies `count` values from `source` to `target`
    _copy: Callable[..., None]
    _launch: Callable[..., None]  # (stage, kernel, grid, args, defines, group)
    _command: Callable[..., Any]  # (the same): a command that launches with these arguments

    @refusable(of_values)
    def array(self, values, dtype=np.float32):
        if self._is_own(values):
            return values
        if not isinstance(values, np.ndarray):
            shared = self._share(values, np.dtype(dtype))
            if shared is not None:
                return shared
            values = to_host(values, self.name)
        tape = _current.tape
        if tape is None:
            return self._array(values, dtype)
        values = np.ascontiguousarray(values, dtype)
        if values.nbytes > SMALL:
            return self._array(values, dtype)
        return tape.constant(values, self._array)

    @refusable(of_values)
    def samples(self, values, dtype):
        return self._fitting(self.array(values, dtype), np.dtype(dtype))

    @refusable(of_shape)
    def empty(self, shape, dtype=np.float32):
        tape = _current.tape
        if tape is None or tape.writes_anew:
            return self._empty(shape, dtype)
        kind = np.dtype(dtype)
        is_large = prod(shape) * kind.itemsize >= LARGE
        request = ("large" if is_large else "empty", tuple(shape), kind.str)
        return (tape.held if is_large else tape.again)(request, self._empty, shape, dtype)

    def reshape(self, array, shape):
        tape = _current.tape
        if tape is None or tape.writes_anew:
            return self._reshape(array, shape)
        if not tape.is_loose:
            tape.viewed.append(array)
        return tape.held(("view", tuple(shape)), self._reshape, array, shape, of=array)

    @refusable(of_values)
    def numpy(self, array):
        if isinstance(array, np.ndarray):
            return array
        if not self._is_own(array):
            return to_host(array, self.name)
        tape = _current.tape
        if tape is not None and not self._clock.host_work:
            tape.reads.append(self._clock.charged or "between the stages")
            tape.loosen()
        return self._numpy(array)

    @contextmanager
    def host_work(self):
        tape, clock = _current.tape, self._clock
        if tape is not None:
            tape.host_work.append(clock.charged)
            tape.loosen()
        outer, clock.host_work = clock.host_work, True
        try:
            with super().host_work():
                yield
        finally:
            clock.host_work = outer

    def stack(self, arrays):
        result = self.empty((len(arrays), *arrays[0].shape), self._dtype(arrays[0]))
        size = int(np.prod(arrays[0].shape))
        for number, array in enumerate(arrays):
            self._start_copy(result, array, size, 0, number * size)
        return result

    def part(self, array, index):
        first, shape = index, array.shape[1:]
        if isinstance(index, slice):
            first, last, _ = index.indices(array.shape[0])
            shape = (last - first, *shape)
        result = self.empty(shape, self._dtype(array))
        start = first * int(np.prod(array.shape[1:]))
        self._start_copy(result, array, int(np.prod(shape)), start, 0)
        return result

    def copy(self, target, source):
        """Copy the values of an array to another one of the same shape and type, in turn with launches."""
        self._start_copy(target, source, int(np.prod(source.shape)), 0, 0)

    @refusable(of_values)
    def _start_copy(self, target, source, count, start, to):
        """Copy `count` values between arrays, in turn with launches."""
        tape = _current.tape
        places = (count, start, to)
        if tape is None or tape.is_loose:
            self._copy(self._clock.charged or "copies", target, source, *places)
        else:
            request = ("copy", _place(target), _place(source), *places)
            command = tape.again(request, Copy, self, target, source, *places)
            command.set((target, source))
            tape.start(command)

    def gather(self, commands: list) -> list:
        """Return what starts these commands again and again at less cost, for `start`."""
        return commands

    @refusable(of_commands)
    def start(self, commands):
        """Start commands again, in order."""
        for command in commands:
            command.start()

    @refusable(of_launch)
    def launch(
        self, stage, kernel, grid, *args, numbers=None, words=None, defines=None, group=None
    ):
        if 0 in grid:
            return
        if numbers:
            args = (*args, *last_arguments(numbers, words))
        tape = _current.tape
        if tape is None:
            self._launch(stage, kernel, grid, args, defines or {}, group)
        else:
            request = stage, kernel, tuple(grid), group, defines
            command = tape.again(
                request, self._command, stage, kernel, grid, args, defines or {}, group
            )
            command.set(args)
            if numbers:
                tape.numbered.append((command, numbers, words))
            tape.start(command)

    def refusal(self, error: Exception) -> str:
        """Return the driver's message if the error is refused memory, else ""."""
        return (str(error) or "out of memory") if isinstance(error, MemoryError) else ""

    def _is_own(self, values) -> bool:
        """Return whether it is an array of this device."""
        return isinstance(values, self.array_type) and values.device in (self, self._home)

    def _share(self, values, dtype):
        """Return an array made from another's device memory; None if the host can read it."""


def _place(array):
    """Return a key that distinguishes an array's memory and form."""
    return array.ptr, array.shape, array.dtype
