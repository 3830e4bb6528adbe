"""The protocol every backend fulfils."""

import time
from collections import defaultdict
from contextlib import contextmanager

import numpy as np

from gpusim.domain.memory import host_memory


class Device:
    """A place where kernels run: allocate, move, launch, time.

    kind: "numpy", "opencl" or "warp"; name: what `open_device` was asked for, made definite, such as "opencl:0".
    on_host: arrays live in host memory, so `numpy()` is a view that costs nothing.
    array_type: class of this device's arrays; they have `shape` and `dtype`.
    """

    kind = "numpy"
    name = "numpy"
    on_host = True
    array_type: type = type(None)  # no foreign arrays: everything is NumPy
    is_gpu = False
    has_fp64 = True
    group_limit = 1024  # work-items of a group at most

    def __init__(self):
        self._times: defaultdict[str, float] | None = None
        self._charged = ""  # the stage whose time is running

    @property
    def memory(self) -> int:
        """What may still be allocated in all [byte]: the host's free memory, for devices on the host."""
        return host_memory()

    def array(self, values, dtype=np.float32):
        """Array of this device with these values; one that is there already is returned as it is."""
        return np.ascontiguousarray(values, dtype)

    def empty(self, shape, dtype=np.float32):
        """Uninitialised array of this device."""
        return np.empty(shape, dtype)

    def reshape(self, array, shape):
        """The same memory with another shape of the same size."""
        return array.reshape(shape)

    def numpy(self, array) -> np.ndarray:
        """Wait, then the values as NumPy: a view where `on_host`, else a copy."""
        return np.asarray(array)

    def launch(self, stage: str, kernel: str, grid: tuple, *args, defines: dict | None = None, group=None):
        """Start `kernel` of `stage` over `grid` (slowest axis first; kernels guard their bounds).

        args: arrays of this device, ints and floats, in the kernel's order. defines: compile-time constants.
        group: work-group (block) shape, slowest axis first, or None for the backend's choice.
        """
        raise NotImplementedError

    def sync(self):
        """Wait for everything that was launched."""

    @contextmanager
    def timed(self):
        """Collect milliseconds per stage: `with device.timed() as ms: ...`, `ms` is complete after the block."""
        self.sync()
        self._times, outer = defaultdict(float), self._times
        times = self._times
        try:
            yield times
            self.sync()
            self._collect()
        finally:
            self._times = outer

    def _collect(self):
        """Add the device's own event times to `self._times`."""

    @contextmanager
    def charged(self, stage: str):
        """Count what is launched inside the block as the time of `stage`, whatever file the kernels are in."""
        outer, self._charged = self._charged, stage
        try:
            yield
        finally:
            self._charged = outer

    @contextmanager
    def host_work(self):
        """Count the time of work done on the host, a library's FFT say."""
        self.sync()
        start = time.perf_counter()
        yield
        if self._times is not None:
            self._times[self._charged] += 1e3 * (time.perf_counter() - start)
