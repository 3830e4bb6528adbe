"""The protocol every backend fulfils."""

import os
import threading
import time
import weakref
from collections import defaultdict
from collections.abc import Callable
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadData, DeviceError
from gpusim.domain.foreign import to_host
from gpusim.domain.memory import Pinned, host_memory


class Transfer:
    """An array on its way to a device."""

    def __init__(self, array):
        self.array = array

    def join(self):
        """Let what is launched from now on wait for it; returns the array."""
        return self.array

    def wait(self):
        """Wait until it has arrived, and its source may be written to."""


class _Clock(threading.local):
    """What one thread times on a device: milliseconds per stage, if any, the stage that is charged, events.

    host_work: whether it works on the host just now.
    """

    def __init__(self):
        self.times: defaultdict[str, float] | None = None
        self.charged = ""
        self.events: list = []
        self.host_work = False


class Device:
    """A place where kernels run: allocate, move, launch, time. Threads may share it; it is pickled by its name.

    Drivers do not survive a fork: in the child process every use raises DeviceError.

    kind: "numpy", "opencl" or "warp"; name: what `open_device` was asked for, made definite, such as "opencl:0".
    on_host: arrays live in host memory, so `numpy()` is a view that costs nothing.
    array_type: class of this device's arrays; they have `shape`, `dtype` and `len()`, their first axis can be indexed,
        and `np.asarray` waits and gives their values.
    """

    kind = "numpy"
    name = "numpy"
    on_host = True
    opened_by: Callable[[str], "Device"]  # by name; `gpusim.backends.select` sets it
    array_type: type = type(None)  # no foreign arrays: everything is NumPy
    is_gpu = False
    has_fp64 = True
    group_limit = 1024  # work-items of a group at most
    local_bytes = (
        48 * 1024
    )  # local memory of a group that kernels may use: as every GPU of the last ten years has

    def __init__(self):
        self._clock = _Clock()
        self._lock = (
            threading.RLock()
        )  # held while a kernel is built, or given its arguments and started
        if self.kind != "numpy":
            _in_use.add(self)

    def __repr__(self):
        return f"Device({self.name!r})"

    def __reduce__(self):
        return type(self).opened_by, (self.name,)

    @property
    def memory(self) -> int:
        """What may still be allocated in all [byte]: the host's free memory, for devices on the host."""
        return host_memory()

    @property
    def largest_array(self) -> int:
        """What one array may take [byte]."""
        return self.memory

    def array(self, values, dtype=np.float32):
        """Array of this device with these values; one that is there already is returned as it is.

        values: NumPy's, or an array of another device or library with `__dlpack__`, `__cuda_array_interface__` or
        `__array__`. Of the same memory where that is this device's and the type and the layout fit, else a copy.
        Raises BadData for memory that cannot be read, such as CUDA's by OpenCL where its owner gives no copy.
        """
        return np.ascontiguousarray(to_host(values, self.name), dtype)

    def samples(self, values, dtype):
        """`array` whose type is `dtype`, contiguous, whosever it is."""
        return self.array(values, dtype)

    def empty(self, shape, dtype=np.float32):
        """Uninitialised array of this device."""
        return np.empty(shape, dtype)

    def reshape(self, array, shape):
        """The same memory with another shape of the same size."""
        return array.reshape(shape)

    def numpy(self, array) -> np.ndarray:
        """Wait, then the values as NumPy: a view where `on_host`, else a copy. Of arrays of others, too."""
        return to_host(array, self.name)

    def stack(self, arrays):
        """Copies of arrays of this device, all of one shape and type, as one array: its first axis counts them."""
        return np.stack(arrays)

    def part(self, array, index: int):
        """A copy of `array[index]`, on the device."""
        return np.array(array[index])

    def on_stream(self, stream):
        """Inside the block, work on a CUDA stream of another library's, in turn with what that does there.

        stream: its address, or an object with `__cuda_stream__`, `cuda_stream` (PyTorch) or `ptr` (CuPy). Raises
        BadData for devices that have none.
        """
        raise BadData(f"{self.name} has no CUDA streams; wanted device warp:cuda:0")

    def pinned(self, shape, dtype=np.float32) -> Pinned:
        """Uninitialised array of the host that is copied to this device at the full rate of the bus."""
        return np.empty(shape, dtype).view(Pinned)

    def send(self, values, target=None, after=None):
        """Begin to copy `values` to this device, beside what it computes: a `Transfer`, or what is done by then.

        target: array of this device to copy to, of their shape and type; a new one if None. after: what `mark` gave
        when the last kernel that reads the target had been launched. The values stay as they are until `Transfer.join`.
        """
        return Transfer(self.array(values, values.dtype))

    def fetch(self, array):
        """Begin to copy an array of this device to the host, after what was launched; call the result for values."""
        return lambda: self.numpy(array)

    def mark(self):
        """A place in what was launched, for `send`."""

    def launch(
        self,
        stage: str,
        kernel: str,
        grid: tuple,
        *args,
        numbers: dict | None = None,
        words=None,
        defines: dict | None = None,
        group=None,
    ):
        """Start `kernel` of `stage` over `grid` (slowest axis first; kernels guard their bounds).

        args: arrays of this device, ints and floats, in the kernel's order. numbers: numbers by name that may change
        from frame to frame, the kernel's last arguments; a recorded launch can be given others. words: function that
        makes these arguments, `words(**numbers)`; by default each number is a float. defines: compile-time constants.
        group: work-group (block) shape, slowest axis first, or None for the backend's choice.
        """
        raise NotImplementedError

    def sync(self):
        """Wait for everything that was launched."""

    @contextmanager
    def timed(self):
        """Collect milliseconds per stage: `with device.timed() as ms: ...`, `ms` is complete after the block.

        What is timed inside belongs to blocks around it, too.
        """
        self.sync()
        clock = self._clock
        if clock.times is not None:
            self._collect(clock)  # what was launched before is the outer block's
        clock.times, outer = defaultdict(float), clock.times
        times = clock.times
        try:
            yield times
            self.sync()
            self._collect(clock)
        finally:
            clock.events.clear()  # those of a block that failed
            clock.times = outer
            for stage, spent in times.items() if outer is not None else ():
                outer[stage] += spent

    def _collect(self, clock):
        """Add the device's own event times to `clock.times`."""

    @contextmanager
    def charged(self, stage: str):
        """Count what is launched inside the block as the time of `stage`, whatever file the kernels are in."""
        clock = self._clock
        outer, clock.charged = clock.charged, stage
        if clock.times is not None:
            clock.times[stage] += 0.0  # in the order of their calls, whenever their times are known
        try:
            yield
        finally:
            clock.charged = outer

    @contextmanager
    def host_work(self):
        """Count the time of work done on the host, a library's FFT say."""
        self.sync()
        start = time.perf_counter()
        yield
        if self._clock.times is not None:
            self._clock.times[self._clock.charged] += 1e3 * (time.perf_counter() - start)


class _Forked(Device):
    """What a device is in a child process that was forked after its driver had started."""

    def _refuse(self, *_, **__):
        refuse_fork(self.name)

    array = samples = empty = reshape = numpy = stack = part = launch = sync = _refuse  # type: ignore[assignment]


_in_use: weakref.WeakSet[Device] = weakref.WeakSet()
_is_forked = False


def _after_fork():
    global _is_forked
    for device in list(_in_use):
        _is_forked = True
        device.kind = device.kind  # of its class until now
        device.__class__ = _Forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def refuse_fork(name):
    """Raise DeviceError in a child process that was forked after a driver had started."""
    if _is_forked:
        raise DeviceError(
            f"{name}: this process was forked from one that had used a device, which drivers do not "
            'survive; start it by "spawn" (multiprocessing.get_context("spawn"), '
            'DataLoader(multiprocessing_context="spawn")), or use devices in child processes alone'
        )


def kernel_folder() -> Path:
    """Return the folder of the kernels' files. Raises ImportError without one."""
    spec = find_spec(
        "gpusim.kernels.common"
    )  # beside the package in a checkout, inside it when it is installed
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("no kernels")
    return Path(spec.submodule_search_locations[0]).parent
