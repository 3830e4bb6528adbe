"""Warp with two CUDA devices that there are not: kernels run on the CPU, and what mixes the two is refused.

As on two GPUs: a launch, an event and a stream belong to one ordinal, the default device is cuda:0, CUDA's default
stream and pinned memory are those of the thread's current context. Beyond that, whatever is read, or written again,
before its stream has waited for the one that used it last is refused, too: a race, which real GPUs do not report.
"""

import ctypes
import threading
from bisect import bisect_right
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np

from gpusim.backends import warp as backend
from gpusim.backends.select import open_device
from gpusim.backends.warp import WarpDevice

real = backend.start_warp()  # without its messages
_contexts = threading.local()


def current():
    """The device whose context this thread has; cuda:0 where it has none, as CUDA's runtime takes it."""
    stack = getattr(_contexts, "stack", [])
    return stack[-1] if stack else FAKE.devices[0]


@contextmanager
def context_of(device):
    stack = _contexts.__dict__.setdefault("stack", [])
    stack.append(device)
    try:
        yield
    finally:
        stack.pop()


class Event:
    def __init__(self, device=None, enable_timing=False):
        self.device, self.stamp = FAKE.get_device(device), {}


class Stream:
    """seen: how far other streams had come when this one waited for them, by stream; it is its own clock."""

    def __init__(self, device=None, cuda_stream=1):
        self.device, self.cuda_stream, self.seen = FAKE.get_device(device), cuda_stream, {self: 0}

    def _require_context(self):
        if self.cuda_stream is None and current() is not self.device:
            raise RuntimeError(
                f"CUDA's default stream of {self.device} while {current()} is current"
            )

    def record_event(self, event=None):
        self._require_context()
        event = event or Event(self.device)
        if event.device is not self.device:  # Warp's words
            raise RuntimeError(
                f"Event from device {event.device} cannot be recorded on stream from device "
                f"{self.device}"
            )
        self.seen[self] += 1
        event.stamp = dict(self.seen)
        return event

    def wait_event(self, event):
        self._require_context()
        for stream, tick in event.stamp.items():
            self.seen[stream] = max(self.seen.get(stream, 0), tick)

    def uses(self, memory):
        """Something is launched here that reads or writes the memory."""
        user, tick = memory.used
        if user is not None and self.seen.get(user, 0) < tick:
            raise RuntimeError(
                f"a race: memory of {memory.device} is used on a stream of {self.device} that has not "
                f"waited for a stream of {user.device}"
            )
        self.seen[self] += 1
        memory.used = self, self.seen[self]


class CudaDevice:
    """One of the two, or the host ("cpu", -1)."""

    is_primary, max_shared_memory_per_block, sm_count, free_memory = True, 48 * 1024, 2, 2**32
    arch = 75  # without matrix units

    def __init__(self, ordinal):
        self.ordinal, self.is_cuda, self.is_cpu = ordinal, ordinal >= 0, ordinal < 0
        self.alias = self.name = f"cuda:{ordinal}" if self.is_cuda else "cpu"
        self.lock = threading.Lock()

    def __str__(self):
        return self.alias

    @property
    def context_guard(self):
        return context_of(self)

    def set_stream(self, stream, sync=True):
        if stream.device is not self:
            raise RuntimeError(
                f"Stream from device {stream.device} cannot be used on device {self}"
            )
        if sync:
            with self.context_guard:
                stream.wait_event(self.stream.record_event())
        self.stream = stream


class Memory:
    """What views share: where it is, and which stream used it last."""

    def __init__(self, device, values):
        self.device, self.values, self.used = device, values, (None, 0)
        start = values.ptr or 0
        with FAKE.lock:
            FAKE.memories[start] = self
            FAKE.starts = sorted(FAKE.memories)

    @staticmethod
    def at(address):
        with FAKE.lock:
            return FAKE.memories[FAKE.starts[bisect_right(FAKE.starts, address) - 1]]


class Array:
    """Warp's array; `real` has the values in the host's memory."""

    def __init__(self, data=None, dtype=None, device=None, copy=True):
        self.device = FAKE.get_device(device)
        given = data if isinstance(data, np.ndarray) else np.asarray(data)
        self._take(real.array(given, dtype=dtype, device="cpu", copy=copy or self.device.is_cuda))
        if self.device.is_cuda:
            self.device.stream.uses(self.memory)

    def _take(self, values, memory=None):
        self.real, self.memory = values, memory or Memory(self.device, values)
        self.ptr, self.shape, self.dtype, self.ndim, self.size = (
            values.ptr,
            values.shape,
            values.dtype,
            values.ndim,
            values.size,
        )
        self.capacity, self.is_contiguous = values.capacity, values.is_contiguous
        return self

    @classmethod
    def of_real(cls, values, device, memory=None):
        array = Array.__new__(Array)
        array.device = device
        return array._take(values, memory)

    def __len__(self):
        return self.shape[0]

    def __getitem__(self, key):
        return Array.of_real(self.real[key], self.device, self.memory)

    def reshape(self, shape):
        return Array.of_real(self.real.reshape(shape), self.device, self.memory)

    def contiguous(self):
        self.device.stream.uses(self.memory)
        return Array.of_real(self.real.contiguous(), self.device)

    def to(self, device):
        copied = FAKE.empty(self.shape, self.dtype, device)
        FAKE.copy(copied, self)
        return copied

    def numpy(self):
        if self.device.is_cuda:
            FAKE.synchronize_device(self.device)
        user, tick = self.memory.used
        if user is not None and FAKE.waited.get(user, 0) < tick:
            raise RuntimeError(f"a race: the host reads what a stream of {user.device} uses")
        return self.real.numpy()


class Launch:
    def __init__(self, device, kernel, dim, inputs, options):
        self.device, self.kernel, self.dim, self.options = device, kernel, dim, options
        FAKE.require(device, inputs)
        values = [arg.real if isinstance(arg, Array) else arg for arg in inputs]
        if isinstance(kernel, Native):
            self.params, self.params_addr = [None, *map(packed, values)], None
        else:
            self.made = real.launch(kernel, dim=dim, inputs=values, device="cpu", record_cmd=True)
            self.params, self.params_addr = self.made.params, self.made.params_addr

    def set_param_at_index(self, index, new):
        FAKE.require(self.device, [new])
        if isinstance(self.kernel, Native):
            self.params[index + 1] = packed(new.real)
        else:
            self.made.set_param_at_index(index, new.real)

    def launch(self):
        for param in self.params[1:]:
            if isinstance(param, ctypes.Structure) and param.data:
                memory = Memory.at(param.data)
                if memory.device is not self.device:
                    raise RuntimeError(f"a launch on {self.device} of memory of {memory.device}")
                self.device.stream.uses(memory)
        if isinstance(self.kernel, Native):
            self.kernel.run(self.dim, self.params[1:], self.options)
        else:
            self.made.launch()


def packed(value):
    if isinstance(value, real.array):
        return type(value.__ctype__()).from_buffer_copy(value.__ctype__())
    return ctypes.c_int32(value) if isinstance(value, int | np.integer) else ctypes.c_float(value)


class Native:
    """A kernel of OpenCL text, which runs on PoCL in the GPU's form."""

    def __init__(self, of, stage, name, defines):
        self.of, self.stage, self.name, self.defines, self.module = of, stage, name, defines, self

    def run(self, dim, params, options):
        with FAKE.lock:
            args = [
                self._values(param) if isinstance(param, ctypes.Structure) else param.value
                for param in params
            ]
            there = [
                self.of.array(arg.copy(), arg.dtype) if isinstance(arg, np.ndarray) else arg
                for arg in args
            ]
            group = (options["block_dim"],) if "block_dim" in options else None
            self.of.launch(
                self.stage,
                self.name,
                tuple(np.atleast_1d(dim)),
                *there,
                defines=self.defines,
                group=group,
            )
            for arg, made in zip(args, there, strict=True):
                if isinstance(arg, np.ndarray):
                    arg[:] = self.of.numpy(made)

    @staticmethod
    def _values(param):
        memory = Memory.at(param.data)
        flat = memory.values.numpy().reshape(-1)
        return flat[(param.data - memory.values.ptr) // flat.itemsize :][
            : int(np.prod(param.shape[: param.ndim]))
        ]


class FakeWarp:
    array, Event, Stream = Array, Event, Stream
    uint16, float32, int32 = real.uint16, real.float32, real.int32
    dtype_from_numpy, dtype_to_numpy = (
        staticmethod(real.dtype_from_numpy),
        staticmethod(real.dtype_to_numpy),
    )
    get_module = staticmethod(real.get_module)
    config, __version__ = real.config, real.__version__

    def __init__(self):
        self.lock, self.memories, self.starts, self.waited = threading.RLock(), {}, [], {}
        self.loading = threading.Lock()
        self.utils = SimpleNamespace(array_cast=self._cast)

    def start(self):
        self.host = CudaDevice(-1)
        self.devices = [CudaDevice(0), CudaDevice(1)]
        for device in self.devices:
            device.stream = Stream(device)
        return self

    def get_device(self, device=None):
        if isinstance(device, CudaDevice):
            return device
        named = {device.alias: device for device in (self.host, *self.devices)}
        return self.devices[0] if device is None else named[device]

    def get_cuda_devices(self):
        return self.devices

    def get_cuda_driver_version(self):
        return 13, 0

    def empty(self, shape, dtype=float, device=None, pinned=False):
        device = self.get_device(device)
        if pinned and not getattr(_contexts, "stack", []):
            raise RuntimeError("pinned memory without a context: CUDA makes one on device 0")
        return Array.of_real(real.zeros(shape, dtype=dtype, device="cpu"), device)

    def copy(self, dest, src, dest_offset=0, src_offset=0, count=0, stream=None):
        if stream is None:
            stream = next(
                (array.device.stream for array in (dest, src) if array.device.is_cuda), None
            )
        if stream is not None:
            if stream.device not in (dest.device, src.device):
                raise RuntimeError(
                    f"a copy between {src.device} and {dest.device} on a stream of {stream.device}"
                )
            for array in (src, dest):
                stream.uses(array.memory)
        real.copy(dest.real, src.real, dest_offset, src_offset, count)

    def _cast(self, values, out):
        self.require(values.device, [out])
        for array in (values, out):
            array.device.stream.uses(array.memory)
        real.utils.array_cast(values.real, out.real)

    def require(self, device, arrays):
        for array in arrays:
            if isinstance(array, Array) and array.device is not device:
                raise RuntimeError(f"a launch on {device} of an array of {array.device}")

    def launch(self, kernel, dim, inputs, device=None, record_cmd=False, **options):
        command = Launch(self.get_device(device), kernel, dim, inputs, options)
        return command if record_cmd else command.launch()

    def load_module(self, module, device=None, **options):
        if not self.loading.acquire(blocking=False):
            raise AssertionError("two threads build Warp's modules at once")
        try:
            if device is None or not self.get_device(device).is_cuda:
                raise RuntimeError("a module for no CUDA device")
            if not isinstance(module, Native):
                real.load_module(module, device="cpu")
        finally:
            self.loading.release()

    def synchronize_device(self, device=None):
        stream = self.get_device(device).stream
        self._host_waits(stream.seen)
        for other in [
            used[0] for used in (memory.used for memory in list(self.memories.values())) if used[0]
        ]:
            if other.device is stream.device:
                self._host_waits({other: other.seen[other]})

    def synchronize_event(self, event):
        self._host_waits(event.stamp)

    def get_event_elapsed_time(self, first, last):
        if not (current() is first.device is last.device):
            raise RuntimeError(
                f"events of {first.device} and {last.device} while {current()} is current"
            )
        self.synchronize_event(last)
        return 1.0

    def _host_waits(self, stamp):
        for stream, tick in stamp.items():
            self.waited[stream] = max(self.waited.get(stream, 0), tick)

    def get_stream(self, device=None):
        return self.get_device(device).stream

    def record_event(self, event=None):  # as Warp: on the default device's stream
        return self.devices[0].stream.record_event(event)


FAKE = FakeWarp()
FAKE.start()


class TwoCuda(WarpDevice):
    """`warp:cuda:0` or `warp:cuda:1` of the double."""

    shared = None  # where OpenCL's text runs

    has_driver = False  # the double has no memory and no graphs that CUDA's driver knows

    def _native(self, stage, kernel, defines, args, options):
        key = stage, kernel, *sorted(defines.items())
        if key not in self._natives:
            self._natives[key] = Native(TwoCuda.shared, stage, kernel, defines)
        self._load(stage, self._natives[key].module, **options)
        return self._natives[key]


def two_cuda(monkeypatch, native):
    """The two devices, also by their names. native: OpenCL device for what Warp has no kernels for."""
    FAKE.__init__()
    FAKE.start()
    monkeypatch.setattr(backend, "start_warp", lambda: FAKE)
    TwoCuda.shared = native
    devices = [TwoCuda(f"cuda:{ordinal}", f"warp:cuda:{ordinal}") for ordinal in range(2)]
    opened = open_device.__globals__["_open"]
    named = {device.name: device for device in devices}
    monkeypatch.setitem(
        open_device.__globals__, "_opened", lambda name: named.get(name) or opened(name)
    )
    return devices
