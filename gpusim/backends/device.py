"""The protocol of every backend."""

import os
import threading
import time
import weakref
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from gpusim.domain.errors import BadData, DeviceError
from gpusim.domain.memory import Pinned, host_memory, to_host

MATRIX_UNITS = 8  # NVIDIA's compute capability from which kernels can use them


class Transfer:
    """An array on its way to a device."""

    def __init__(self, array):
        self.array = array

    def join(self) -> Any:
        """Make later launches wait for the array, and return it."""
        return self.array

    def wait(self) -> None:
        """Wait until the array has arrived and its source may be overwritten."""


class _Clock(threading.local):
    """Times of one thread on a device.

    times: milliseconds per stage, or None. charged: stage that is charged. events: not read yet.
    host_work: whether the thread is working on the host. launches: kernels and copies that were timed.
    """

    def __init__(self):
        self.times: defaultdict[str, float] | None = None
        self.charged = ""
        self.events: list = []
        self.host_work = False
        self.launches = 0


class Device:
    """A place where kernels run: it allocates, copies, launches and times.

    Threads may share it. It is pickled by its name. Drivers do not survive a fork: in the child
    process every use raises DeviceError.

    Attributes:
        kind: "numpy", "opencl" or "warp".
        name: The name given to `open_device`, made definite, for example "opencl:0".
        on_host: Whether arrays lie in host memory, where `numpy()` is a view without cost.
        array_type: Class of this device's arrays. They have `shape`, `dtype` and `len()`, are
            indexed along their first axis, and `np.asarray` waits and returns their values.
        is_gpu: Whether the device is a GPU.
        has_fp64: Whether kernels may use float64.
        has_matrix_units: Whether it has NVIDIA's instructions for products of float16 matrices.
        group_limit: Most work-items of a group.
        local_bytes: Local memory of a group that kernels may use [byte].
    """

    kind = "numpy"
    name = "numpy"
    on_host = True
    opened_by: Callable[[str], "Device"]  # `open_device`; `gpusim.backends.select` sets it
    array_type: Any = type(None)  # no foreign arrays: everything is NumPy
    is_gpu = False
    has_fp64 = True
    has_matrix_units = False
    group_limit = 1024
    local_bytes = 48 * 1024  # on every GPU of the last ten years

    def __init__(self):
        self._clock = _Clock()
        self._lock = threading.RLock()  # held while a kernel is built, or set up and started
        if self.kind != "numpy":
            _in_use.add(self)

    def __repr__(self):
        return f"Device({self.name!r})"

    def __reduce__(self):
        return type(self).opened_by, (self.name,)

    @property
    def memory(self) -> int:
        """Memory that may still be allocated [byte]; on the host, its free memory."""
        return host_memory()

    @property
    def largest_array(self) -> int:
        """Largest size of one array [byte]."""
        return self.memory

    def array(self, values: Any, dtype: DTypeLike = np.float32) -> Any:
        """Return an array of this device with these values.

        An array that is already on this device is returned unchanged. Memory is shared if it is
        this device's and type and layout fit; else it is copied.

        Args:
            values: NumPy array, or an array of another device or library with `__dlpack__`,
                `__cuda_array_interface__` or `__array__`.
            dtype: Type of new arrays.

        Returns:
            Array of this device.

        Raises:
            BadData: The memory cannot be read, for example CUDA memory by OpenCL if its owner
                offers no copy.
        """
        return np.ascontiguousarray(to_host(values, self.name), dtype)

    def samples(self, values: Any, dtype: DTypeLike) -> Any:
        """Return `array` in the type `dtype` and contiguous, for arrays of any origin."""
        return self.array(values, dtype)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Any:
        """Return an uninitialised array of this device."""
        return np.empty(shape, dtype)

    def reshape(self, array: Any, shape: tuple[int, ...]) -> Any:
        """Return the same memory in another shape of the same size."""
        return array.reshape(shape)

    def numpy(self, array: Any) -> np.ndarray:
        """Wait, and return the values as NumPy array: a view if `on_host`, else a copy.

        Arrays of other devices and libraries are read, too.
        """
        return to_host(array, self.name)

    def stack(self, arrays: Sequence[Any]) -> Any:
        """Return copies of arrays of one shape and type as one array with a new first axis."""
        return np.stack(arrays)

    def copy(self, target: Any, source: Any) -> None:
        """Copy the values of an array to another one of the same shape and type, in turn with launches."""
        target[...] = source

    def part(self, array: Any, index: int | slice) -> Any:
        """Return a copy of `array[index]` on the device. A slice has a step of 1."""
        return np.array(array[index])

    def on_stream(self, stream: Any) -> Any:
        """Work on another library's CUDA stream inside the block, in turn with its own work.

        Args:
            stream: Its address, or an object with `__cuda_stream__`, `cuda_stream` (PyTorch) or
                `ptr` (CuPy).

        Raises:
            BadData: The device has no CUDA streams.
        """
        raise BadData(f"{self.name} has no CUDA streams; wanted device warp:cuda:0")

    def pinned(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Pinned:
        """Return an uninitialised host array for copies at the full rate of the bus."""
        return np.empty(shape, dtype).view(Pinned)

    def send(self, values: np.ndarray, target: Any = None, after: Any = None) -> Transfer:
        """Begin to copy `values` to this device while it computes.

        The values must stay unchanged until `Transfer.join`.

        Args:
            values: Host array.
            target: Array of this device to copy to, of the same shape and type; None for a new one.
            after: `mark()` after the launch of the last kernel that reads the target.

        Returns:
            The transfer.
        """
        return Transfer(self.array(values, values.dtype))

    def fetch(self, array: Any) -> Callable[[], np.ndarray]:
        """Begin to copy an array to the host after earlier launches; call the result for it."""
        return lambda: self.numpy(array)

    def mark(self) -> Any:
        """Return the place after all earlier launches, for `send`."""

    def launch(
        self,
        stage: str,
        kernel: str,
        grid: tuple[int, ...],
        *args: Any,
        numbers: dict | None = None,
        words: Callable[..., tuple] | None = None,
        defines: dict | None = None,
        group: tuple[int, ...] | None = None,
    ) -> None:
        """Start `kernel` of `stage` over `grid`.

        Args:
            stage: Stage, or another file of kernels, as `area.name`.
            kernel: Name of the kernel.
            grid: Work-items along each axis, the slowest axis first. Kernels guard their bounds.
            *args: Arrays of this device, ints and floats, in the kernel's order.
            numbers: Numbers by name that may change from frame to frame, the kernel's last
                arguments. A recorded launch can be given others.
            words: Function that makes these arguments, `words(**numbers)`; by default each number
                is a float.
            defines: Compile-time constants.
            group: Shape of the work-groups (blocks), the slowest axis first; None for the backend's
                choice.
        """
        raise NotImplementedError

    def flush(self) -> None:
        """Let the device begin all earlier launches, without waiting for them."""

    def sync(self) -> None:
        """Wait for all earlier launches."""

    def give_back(self) -> None:
        """Free memory that is kept for reuse."""

    @contextmanager
    def timed(self) -> Iterator[dict[str, float]]:
        """Collect milliseconds per stage: `with device.timed() as ms: ...`.

        `ms` is complete after the block. Times inside a block also count in blocks around it.
        """
        self.sync()
        clock = self._clock
        if clock.times is not None:
            self._collect(clock)  # earlier launches belong to the outer block
        clock.times, outer = defaultdict(float), clock.times
        times = clock.times
        try:
            yield times
            self.sync()
            self._collect(clock)
        finally:
            clock.events.clear()  # events of a block that failed
            clock.times = outer
            for stage, spent in times.items() if outer is not None else ():
                outer[stage] += spent

    def _collect(self, clock):
        """Add the device's event times to `clock.times`."""

    def count_launches(self, run: Callable[[], Any]) -> int:
        """Return how many kernels and copies between arrays a function starts in this thread.

        A grid that is split into several launches counts as these.

        Args:
            run: The function.
        """
        with self.timed():
            before = self._clock.launches
            run()
        return self._clock.launches - before

    @contextmanager
    def charged(self, stage: str) -> Iterator[None]:
        """Count launches inside the block as time of `stage`, also from other kernel files."""
        clock = self._clock
        outer, clock.charged = clock.charged, stage
        if clock.times is not None:
            clock.times[stage] += 0.0  # keeps the order of the calls; times are known later
        try:
            yield
        finally:
            clock.charged = outer

    @contextmanager
    def host_work(self) -> Iterator[None]:
        """Count the time of work on the host, for example a library's FFT."""
        self.sync()
        start = time.perf_counter()
        yield
        if self._clock.times is not None:
            self._clock.times[self._clock.charged] += 1e3 * (time.perf_counter() - start)


class _Forked(Device):
    """A device in a child process that was forked after its driver had started."""

    def _refuse(self, *_, **__):
        refuse_fork(self.name)

    array = samples = empty = reshape = numpy = stack = part = launch = sync = _refuse  # type: ignore[assignment]


_in_use: weakref.WeakSet[Device] = weakref.WeakSet()
_is_forked = False


def _after_fork():
    global _is_forked
    for device in list(_in_use):
        _is_forked = True
        device.kind = device.kind  # moves it from the class to the instance
        device.__class__ = _Forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def refuse_fork(name):
    """Raise DeviceError in a child process that was forked after a driver had started."""
    if _is_forked:
        raise DeviceError(
            f"{name}: this process was forked from one that had used a device, which drivers do not "
            'survive; start it by "spawn" (multiprocessing.get_context("spawn"), '
            'DataLoader(multiprocessing_context="spawn")), or use devices only in child processes'
        )


def kernel_folder() -> Path:
    """Return the folder of the kernels' files. Raise ImportError if there is none."""
    # next to the package in a checkout, inside an installed package
    spec = find_spec("gpusim.kernels.common")
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("no kernels")
    return Path(spec.submodule_search_locations[0]).parent
