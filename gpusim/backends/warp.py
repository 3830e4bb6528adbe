"""Warp devices: CUDA GPUs, and the CPU (one thread) for equivalence and debugging."""

import ctypes
import functools
import os
import shutil
import sys
import time
from collections import defaultdict
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gpusim.backends.caches import is_writable, lent_folder
from gpusim.backends.device import Transfer
from gpusim.backends.native import native_kernel
from gpusim.backends.refusal import of_shape, of_values, refusable
from gpusim.backends.tape import Taped
from gpusim.domain.errors import BadData, DeviceError
from gpusim.domain.foreign import CUDA, dlpack_kind, name_of
from gpusim.domain.memory import Pinned


def started_warp():
    """Warp, initialised without a word: it has a native warning, on machines without CUDA, that no log level stops."""
    try:
        import warp as wp
    except ImportError as error:
        raise DeviceError(f"Warp devices need Warp ({error}); pip install warp-lang") from error

    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        try:
            wp.init()
        except OSError:  # its cache cannot be written
            wp.config.kernel_cache_dir = str(lent_folder())
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
    return wp


@functools.cache
def array_class(wp):
    """Warp's array with more of what NumPy's have: its own refuses `np.asarray` in CUDA memory, and empty slices."""

    class WarpArray(wp.array):
        def __array__(self, dtype=None, copy=None):  # in host memory NumPy takes `__array_interface__`
            if self.device.is_cuda and copy is False:
                raise ValueError(f"the values of an array of warp:{self.device} cannot be had without a copy")
            return np.array(self.numpy(), dtype, copy=None if self.device.is_cuda else copy)

        def __getitem__(self, key):
            if isinstance(key, slice):
                start, stop, step = key.indices(len(self))
                if step < 0 or stop <= start:  # Warp has no such views
                    return as_shown(wp.array(self.numpy()[key], dtype=self.dtype, device=self.device))
                key = slice(start, stop, step)
            elif hasattr(key, "__index__"):
                if not -len(self) <= key.__index__() < len(self):  # which also ends a loop over the array
                    raise IndexError(f"index {key} is out of bounds for an axis of {len(self)}")
                key = key.__index__()
            return as_shown(super().__getitem__(key))

        def reshape(self, shape):
            return as_shown(super().reshape(shape))

    def as_shown(array):
        array.__class__ = WarpArray
        return array

    WarpArray.of = staticmethod(as_shown)
    return WarpArray


REFUSALS = "Failed to allocate", "out of memory"  # of memory, in Warp's words and CUDA's


class _Command:
    """A launch with its arguments packed. stage: that is charged. name: of the kernel."""

    def __init__(self, device, stage, name, launch, args):
        self.device, self.stage, self.name, self.launch, self.args = device, stage, name, launch, args
        for index in range(len(args)):
            self._own(index + 1)

    def _own(self, place):
        """Pack an array for this launch alone: Warp packs it once for all launches, and `set` writes there."""
        params, addresses = self.launch.params, self.launch.params_addr
        if isinstance(params[place], ctypes.Structure):
            params[place] = type(params[place]).from_buffer_copy(params[place])
            if addresses:
                addresses[place] = ctypes.c_void_p(ctypes.addressof(params[place]))

    def set(self, args):
        for index, (old, new) in enumerate(zip(self.args, args, strict=True)):
            if new is old or (isinstance(new, int | float | np.number) and new == old):
                continue
            packed = self.launch.params[index + 1]
            if isinstance(new, int | float | np.number):
                packed.value = new
            elif new.shape == old.shape and new.dtype == old.dtype and new.is_contiguous and old.is_contiguous:
                packed.data = new.ptr  # all that is other; packing an array anew takes 10 us
            else:
                self.launch.set_param_at_index(index, new)
                self._own(index + 1)
        self.args = args

    def start(self):
        self.device._timed(self.stage, self.launch.launch)


class _Transfer(Transfer):
    def __init__(self, device, array, source, event):
        super().__init__(array)
        self.device, self.source, self.event = device, source, event

    def join(self):
        self.device.wp_device.stream.wait_event(self.event)
        return self.array

    def wait(self):
        self.device._wp.synchronize_event(self.event)


class _Copy:
    """A copy between two arrays in turn with the kernels. args: the one written, and the one read."""

    def __init__(self, device, target, source, *places):
        self.device, self.args, self.places = device, (target, source), places
        self.stage, self.name = device._clock.charged or "copies", "copy"

    def set(self, args):
        """Other arrays of the same kinds."""
        self.args = args

    def start(self):
        (target, source), (count, start, to) = self.args, self.places
        self.device._timed(self.stage, lambda: self.device._wp.copy(target, source, to, start, count))


class WarpDevice(Taped):
    """One Warp device: `cpu` or `cuda:N`."""

    kind = "warp"

    def __init__(self, alias: str, name: str):
        super().__init__()
        wp = started_warp()
        try:
            self.wp_device = wp.get_device(alias)
        except Exception as error:  # Warp raises ValueError or RuntimeError by version
            raise DeviceError(f"{name}: {error}") from error
        self._wp = wp
        self.name = name
        self.is_gpu = self.wp_device.is_cuda
        self.on_host = not self.is_gpu
        if self.is_gpu:  # Warp's kernels keep 4 bytes a work-item for themselves
            self.local_bytes = min(self.local_bytes, self.wp_device.max_shared_memory_per_block - 4 * self.group_limit)
        self.array_type = wp.array
        self._as_shown = array_class(wp).of
        self._copies = wp.Stream(self.wp_device) if self.is_gpu else None  # beside the kernels
        self._landings: defaultdict = defaultdict(list)  # pinned memory that `fetch` uses again
        self._modules: dict = {}  # of the stages
        self._natives: dict = {}  # kernels from OpenCL text
        self._loaded: set = set()  # specialised kernels that are built
        self.build_ms: dict[str, float] = {}

    @property
    def memory(self):
        return self.wp_device.free_memory if self.is_gpu else super().memory

    def _array(self, values, dtype):
        values = np.ascontiguousarray(values, dtype)
        return self._as_shown(self._wp.array(values, dtype=self._wp.dtype_from_numpy(np.dtype(dtype)),
                                             device=self.wp_device, copy=not self.on_host))

    def _is_here(self, array):
        return array.device == self.wp_device

    def _shared(self, values, dtype):
        wp = self._wp
        try:
            if isinstance(values, wp.array):  # of another of Warp's devices
                if self.on_host:
                    return self._array(values.numpy(), dtype)  # which waits
                array = values.to(self.wp_device)
            elif not self.is_gpu:
                return None
            elif dlpack_kind(values) in CUDA:
                array = wp.from_dlpack(values)  # its owner's stream is waited for
            elif hasattr(values, "__cuda_array_interface__"):
                array = self._by_interface(values)
            else:
                return None
        except Exception as error:  # of any class by library: a tensor with a gradient, a type that Warp has not
            raise BadData(f"{self.name}: cannot read an array of {name_of(values)}: "
                          f"{str(error).partition(chr(10))[0][:150]}") from error
        return self._fitting(self._as_shown(array), dtype)

    def _by_interface(self, values):
        """Array over memory of this device that the CUDA array interface tells of."""
        interface = values.__cuda_array_interface__
        if interface.get("stream") is not None:  # work there may not have ended
            self._wp.synchronize_device(self.wp_device)
        kind = self._wp.dtype_from_numpy(np.dtype(interface["typestr"]))
        return self._wp.array(values, dtype=kind, device=self.wp_device, copy=False)

    def _fitting(self, array, dtype):
        given = array
        if array.device != self.wp_device:
            array = array.to(self.wp_device)
        if not array.is_contiguous:
            array = array.contiguous()
        if self._dtype(array) != dtype:
            other, array = array, self._empty(array.shape, dtype)
            self._wp.utils.array_cast(other, array)
        return array if array is given else self._as_shown(array)  # the caller's own stays as it is

    def _empty(self, shape, dtype):
        return self._as_shown(
            self._wp.empty(shape, dtype=self._wp.dtype_from_numpy(np.dtype(dtype)), device=self.wp_device))

    @contextmanager
    def on_stream(self, stream):
        if not self.is_gpu:
            super().on_stream(stream)  # which refuses
        given = stream.__cuda_stream__()[1] if hasattr(stream, "__cuda_stream__") else getattr(
            stream, "cuda_stream", getattr(stream, "ptr", stream))
        if not isinstance(given, int):
            raise BadData(f"CUDA stream: {name_of(stream)}, wanted an address, or an object with `__cuda_stream__`, "
                          "`cuda_stream` or `ptr`")
        own = self._wp.Stream(self.wp_device, cuda_stream=given or None)  # 0: CUDA's default stream
        with self._wp.ScopedStream(own, sync_enter=True, sync_exit=True):  # in turn with our own
            yield

    @refusable(of_shape)
    def pinned(self, shape, dtype=np.float32):
        if self.on_host:
            return super().pinned(shape, dtype)
        kind = self._wp.dtype_from_numpy(np.dtype(dtype))
        return self._wp.empty(shape, dtype=kind, device="cpu", pinned=True).numpy().view(Pinned)

    @refusable(of_values)
    def send(self, values, target=None, after=None):
        if self.on_host:
            return super().send(values)
        wp = self._wp
        target = self._empty(values.shape, values.dtype) if target is None else target
        if after is not None:
            self._copies.wait_event(after)
        source = wp.array(np.asarray(values), dtype=target.dtype, device="cpu", copy=False)
        wp.copy(target, source, stream=self._copies)
        return _Transfer(self, target, source, self._copies.record_event())

    @refusable(of_values)
    def fetch(self, array):
        if self.on_host:
            return super().fetch(array)
        wp, free = self._wp, self._landings[array.shape, array.dtype]
        values = free.pop() if free else wp.empty(array.shape, dtype=array.dtype, device="cpu", pinned=True)
        wp.copy(values, array)
        event = self.wp_device.stream.record_event()

        def fetched():
            wp.synchronize_event(event)
            free.append(values)
            return np.array(values.numpy())

        return fetched

    def mark(self):
        return None if self.on_host else self.wp_device.stream.record_event()

    def refusal(self, error):
        text = str(error) if isinstance(error, RuntimeError) else ""
        return text if any(words in text for words in REFUSALS) else super().refusal(error)

    def give_back(self):
        self._landings.clear()

    def _reshape(self, array, shape):
        return self._as_shown(array.reshape(shape))

    def _numpy(self, array):
        return array.numpy()

    def _place(self, array):
        return array.ptr, array.shape, array.dtype

    def _dtype(self, array):
        return np.dtype(self._wp.dtype_to_numpy(array.dtype))

    def _copy(self, target, source, count, start, to):
        return _Copy(self, target, source, count, start, to)

    def _launch(self, stage, kernel, grid, args, defines, group):
        entry, options = self._entry(stage, kernel, defines, args, group)
        if self._clock.times is not None and self.is_gpu:
            # arguments are packed before the clock starts: the device would wait for Python in between
            self._command(stage, kernel, grid, args, defines, group).start()
        else:
            self._timed(self._clock.charged or stage, lambda: self._wp.launch(
                entry, dim=grid, inputs=args, device=self.wp_device, **options))

    def _entry(self, stage, kernel, defines, args, group):
        """The kernel, and how it is launched."""
        options = {} if group is None or not self.is_gpu else {"block_dim": int(np.prod(group))}
        with self._lock:
            return self._kernel(stage, kernel, defines, args, options), options

    def _command(self, stage, kernel, grid, args, defines, group):
        entry, options = self._entry(stage, kernel, defines, args, group)
        launch = self._wp.launch(entry, dim=grid, inputs=args, device=self.wp_device, record_cmd=True, **options)
        return _Command(self, self._clock.charged or stage, kernel, launch, args)

    def _timed(self, stage, start):
        """Start something on the device, and time it where that is asked for."""
        clock = self._clock
        if clock.times is None:
            start()
        elif self.is_gpu:
            first = self._wp.Event(self.wp_device, enable_timing=True)
            last = self._wp.Event(self.wp_device, enable_timing=True)
            self._wp.record_event(first)
            start()
            self._wp.record_event(last)
            clock.events.append((stage, first, last))
        else:  # CPU launches return when done
            begin = time.perf_counter()
            start()
            clock.times[stage] += 1e3 * (time.perf_counter() - begin)

    def _kernel(self, stage, kernel, defines, args, options):
        loaded = self._modules.get(stage)
        if loaded is None:
            module = f"gpusim.kernels.{stage}_warp"
            if find_spec(module) is None:
                raise DeviceError(f"{stage}: no Warp kernel; add kernels/{stage.replace('.', '/')}_warp.py")
            loaded = self._modules[stage] = import_module(module)
        if getattr(loaded, "NATIVE", False):
            return self._native(stage, kernel, defines, args, options)
        if stage not in self.build_ms:
            self._build(stage, loaded)
        if not hasattr(loaded, "specialised"):
            return getattr(loaded, kernel)
        entry = loaded.specialised(kernel, **defines)
        if entry not in self._loaded:  # a kernel with a module of its own
            self._build(stage, entry.module, **options)
            self._loaded.add(entry)
        return entry

    def _native(self, stage, kernel, defines, args, options):
        ranks = tuple(arg.ndim if isinstance(arg, self._wp.array) else None for arg in args)
        key = (stage, kernel, ranks, *sorted(defines.items()))
        if key not in self._natives:
            self._natives[key] = native_kernel(self._wp, stage, kernel, defines, ranks)
            self._build(stage, self._natives[key].module, **options)
        return self._natives[key]

    def _build(self, stage, module, **options):
        start = time.perf_counter()
        try:
            self._wp.load_module(module, device=self.wp_device, **options)
        except Exception:  # of whatever kind by what is corrupt in the cache, if that is why
            self._forget(module)
            try:
                self._wp.load_module(module, device=self.wp_device, **options)
            except Exception as error:
                raise DeviceError(f"{self.name}: cannot build {stage}: {str(error).partition(chr(10))[0]}") from error
        self.build_ms[stage] = self.build_ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)

    def _forget(self, module):
        """Drop what is kept of a module; keep nothing beyond this process where the cache cannot be written."""
        folder = Path(self._wp.config.kernel_cache_dir)
        for kept in folder.glob(f"wp_{getattr(module, 'name', module.__name__)}_*"):
            shutil.rmtree(kept, ignore_errors=True)
        if not is_writable(folder):
            self._wp.config.kernel_cache_dir = str(lent_folder())

    def sync(self):
        self._wp.synchronize_device(self.wp_device)

    def _collect(self, clock):
        for stage, first, last in clock.events:
            clock.times[stage] += self._wp.get_event_elapsed_time(first, last)
        clock.events.clear()
