"""What a computation asks of a device, noted once: made again, it allocates, builds and copies nothing anew."""

import threading
from contextlib import contextmanager

import numpy as np

from gpusim.backends.device import Device
from gpusim.backends.refusal import of_command, of_launch, of_shape, of_values, refusable
from gpusim.domain.foreign import to_host

SMALL = (
    1 << 16
)  # [byte] of constants whose values are compared; larger ones are given to the device again


class Tape:
    """The requests of one computation to one device, in order. It is used by one thread at a time.

    When the computation is made again on its tape, each request is compared with the one noted in its place. Equal ones
    get what was made then: the same arrays, which are written anew, constants and kernels. From the first other request
    on, the tape is noted anew. So the result never depends on what was noted.
    `replay` starts the noted kernels alone, without the computation's own host code. It is for inputs in the same
    memory, and numbers that are the same; `is_replayable` says whether nothing else happened on the host.
    reads: stages in which the host read values of the device. host_work: those that worked on the host, as they say.
    commands: the noted kernels and copies, in order. numbered: those that take numbers by name, with these and the
    function that makes arguments of them. viewed: arrays of which another form was asked for.
    writes_anew: whether arrays are new each time, for results that are kept; then there is nothing to replay.
    """

    def __init__(self, writes_anew: bool = False):
        self.writes_anew = writes_anew
        self._requests: list = []
        self._at = 0
        self.commands: list = []
        self.numbered: list = []
        self.viewed: list = []
        self.reads: list[str] = []
        self.host_work: list[str] = []

    def begin(self):
        """The computation is made (again) from here on."""
        self._at = 0
        self.commands, self.numbered, self.viewed = [], [], []
        self.reads, self.host_work = [], []

    def again(self, request, make):
        """What `make()` gave for the request in this place, or gives now."""
        if self._at < len(self._requests) and self._requests[self._at][0] == request:
            found = self._requests[self._at][1]
        else:
            del self._requests[self._at :]
            found = make()
            self._requests.append((request, found))
        self._at += 1
        return found

    def constant(self, values, make):
        """Array of these values: that of this place if it has them, else `make()`; the rest of the tape stays."""
        text = values.tobytes()
        found = self.again(("array", values.shape, values.dtype.str), lambda: [text, make()])
        if found[0] != text:
            found[:] = text, make()
        return found[1]

    def start(self, command):
        """Start a command, and note that."""
        self.commands.append(command)
        command.start()

    def replaced(self, others) -> bool:
        """Give the noted kernels other arrays, pairs (old, new); False, and nothing is done, unless all are found.

        Kernels that read an array in another form have that form among their arguments, and not the array itself.
        """
        news = {id(old): new for old, new in others}
        if any(news[id(old)] is not new for old, new in others):  # two for one
            return False
        if any(id(array) in news for array in self.viewed):
            return False
        used = {id(arg) for command in self.commands for arg in command.args}
        if not news.keys() <= used:
            return False
        for command in self.commands:
            if any(id(arg) in news for arg in command.args):
                command.set(tuple(news.get(id(arg), arg) for arg in command.args))
        return True

    def renumber(self, numbers) -> bool:
        """Give the recorded kernels other numbers by name; False, and nothing is done, unless they take all of them.

        See `Taped.launch`.
        """
        if not numbers.keys() <= {name for _, own, _ in self.numbered for name in own}:
            return False
        for place, (command, own, words) in enumerate(self.numbered):
            own = own | {name: value for name, value in numbers.items() if name in own}
            last = last_arguments(own, words)
            command.set((*command.args[: -len(last)], *last))
            self.numbered[place] = command, own, words
        return True

    @property
    def is_replayable(self) -> bool:
        """Whether the noted kernels are all there is to do."""
        return not (self.writes_anew or self.reads or self.host_work)

    def replay(self):
        """Start the noted kernels once more, for inputs in the memory that they had."""
        for command in self.commands:
            command.device.start(command)


class OwnTape(threading.local):
    """A tape of each thread's own, on which results are new arrays. Pickled, it is empty.

    of: what was noted last, for who uses it. raw: the array that it wrote.
    """

    def __init__(self):
        self.tape, self.of, self.raw = Tape(writes_anew=True), (), None

    def __reduce__(self):
        return OwnTape, ()


class _Current(threading.local):
    tape: Tape | None = None


_current = _Current()


@contextmanager
def noted(tape: Tape | None):
    """What devices are asked for inside the block is noted on the tape; on none, if that is None."""
    outer, _current.tape = _current.tape, tape
    if tape is not None:
        tape.begin()
    try:
        yield
    except BaseException:
        if tape is not None:
            tape._requests.clear()  # what was noted may be half of a request
        raise
    finally:
        _current.tape = outer


def last_arguments(numbers, words=None) -> tuple:
    """Return a kernel's last arguments from numbers by name: as float, or as a function `words(**numbers)` says."""
    return tuple(map(float, numbers.values())) if words is None else words(**numbers)


class Taped(Device):
    """A device whose requests can be noted. A backend defines what is asked with a leading underscore.

    Of a launch it makes a command: `set(args)` gives it other arguments of the same kinds, `start()` starts it; stage
    and name are those of its kernel; device: that made it.
    Memory that the driver refuses raises OutOfMemory.
    """

    @refusable(of_values)
    def array(self, values, dtype=np.float32):
        if isinstance(values, self.array_type) and self._is_here(values):
            return values
        if not isinstance(values, np.ndarray):
            shared = self._shared(values, np.dtype(dtype))
            if shared is not None:
                return shared
            values = to_host(values, self.name)
        tape = _current.tape
        if tape is None:
            return self._array(values, dtype)
        values = np.ascontiguousarray(values, dtype)
        if values.nbytes > SMALL:
            return self._array(values, dtype)
        return tape.constant(
            values, lambda: self._array(values.copy(), dtype)
        )  # it may use what it is given

    @refusable(of_values)
    def samples(self, values, dtype):
        return self._fitting(self.array(values, dtype), np.dtype(dtype))

    @refusable(of_shape)
    def empty(self, shape, dtype=np.float32):
        tape = _current.tape
        if tape is None or tape.writes_anew:
            return self._empty(shape, dtype)
        return tape.again(
            ("empty", tuple(shape), np.dtype(dtype).str), lambda: self._empty(shape, dtype)
        )

    def reshape(self, array, shape):
        tape = _current.tape
        if tape is None or tape.writes_anew:
            return self._reshape(array, shape)
        tape.viewed.append(array)
        return tape.again(
            ("reshape", self._place(array), tuple(shape)), lambda: self._reshape(array, shape)
        )

    @refusable(of_values)
    def numpy(self, array):
        if isinstance(array, np.ndarray):
            return array
        if not (isinstance(array, self.array_type) and self._is_here(array)):
            return to_host(array, self.name)
        tape = _current.tape
        if tape is not None and not self._clock.host_work:
            tape.reads.append(self._clock.charged or "between the stages")
        return self._numpy(array)

    @contextmanager
    def host_work(self):
        tape, clock = _current.tape, self._clock
        if tape is not None:
            tape.host_work.append(clock.charged)
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
            self._copied(result, array, size, 0, number * size)
        return result

    def part(self, array, index):
        result = self.empty(array.shape[1:], self._dtype(array))
        size = int(np.prod(result.shape))
        self._copied(result, array, size, index * size, 0)
        return result

    @refusable(of_values)
    def _copied(self, target, source, count, start, to):
        """Copy `count` values between arrays in turn with what is launched."""
        tape, what = _current.tape, (target, source, count, start, to)
        if tape is None:
            self._copy(*what).start()
        else:
            places = self._place(target), self._place(source), count, start, to
            command = tape.again(("copy", *places), lambda: self._copy(*what))
            command.set((target, source))
            tape.start(command)

    @refusable(of_command)
    def start(self, command):
        """Start a command once more."""
        command.start()

    @refusable(of_launch)
    def launch(
        self, stage, kernel, grid, *args, numbers=None, words=None, defines=None, group=None
    ):
        if numbers:
            args = (*args, *last_arguments(numbers, words))
        tape = _current.tape
        if tape is None:
            self._launch(stage, kernel, grid, args, defines or {}, group)
        elif 0 not in grid:
            request = stage, kernel, tuple(grid), group, defines
            command = tape.again(
                request, lambda: self._command(stage, kernel, grid, args, defines or {}, group)
            )
            command.set(args)
            if numbers:
                tape.numbered.append((command, numbers, words))
            tape.start(command)

    def refusal(self, error: Exception) -> str:
        """What a driver said when it refused memory; "" where that is not what the error is."""
        return (str(error) or "out of memory") if isinstance(error, MemoryError) else ""

    def give_back(self):
        """Let go of memory that is kept for reuse."""

    def _array(self, values, dtype):
        """Array of this device with these values, not one of its own already."""
        raise NotImplementedError

    def _is_here(self, array) -> bool:
        """Whether an array of `array_type` is of this device."""
        raise NotImplementedError

    def _shared(self, values, dtype):
        """Array of this type made of memory that only devices read, of another's array; None where the host can."""

    def _fitting(self, array, dtype):
        """An array of this device with this type, contiguous: itself or a copy."""
        raise NotImplementedError

    def _empty(self, shape, dtype):
        raise NotImplementedError

    def _reshape(self, array, shape):
        raise NotImplementedError

    def _numpy(self, array):
        raise NotImplementedError

    def _place(self, array):
        """What tells an array's memory and its form from another's."""
        raise NotImplementedError

    def _dtype(self, array) -> np.dtype:
        raise NotImplementedError

    def _copy(self, target, source, count, start, to):
        """Command that copies `count` values of `source` from `start` on to `target` from `to` on."""
        raise NotImplementedError

    def _launch(self, stage, kernel, grid, args, defines, group):
        raise NotImplementedError

    def _command(self, stage, kernel, grid, args, defines, group):
        """Command that launches with these arguments."""
        raise NotImplementedError
