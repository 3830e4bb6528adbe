"""Warp devices: CUDA GPUs, and the CPU (one thread) for equivalence and debugging."""

import logging
import os
import sys
import threading
import time
from collections import defaultdict
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gpusim.backends.caches import has_room, keep_sound, lent_folder, note, remove
from gpusim.backends.cuda_driver import call_driver, cuda_driver, ordinal_of
from gpusim.backends.device import MATRIX_UNITS
from gpusim.backends.graphs import gather_kernels
from gpusim.backends.native import native_kernel
from gpusim.backends.refusal import of_shape, of_values, refusable
from gpusim.backends.tape import Taped
from gpusim.backends.warp_arrays import (
    Arriving,
    Command,
    array_class,
    mark_in,
    wait_for,
    wait_for_device,
    wait_for_event,
)
from gpusim.domain.errors import BadData, DeviceError
from gpusim.domain.memory import CUDA, Pinned, dlpack_kind, name_of
from gpusim.domain.progress import announced


def start_warp():
    """Return Warp, initialised silently: no log level stops its warning without CUDA."""
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


log = logging.getLogger(__name__)
# Warp's modules are shared by all devices, and built by one thread at a time
_building = threading.RLock()
REFUSALS = "Failed to allocate", "out of memory"  # refused memory, in Warp's words and CUDA's


class WarpDevice(Taped):
    """One Warp device: `cpu` or `cuda:N`.

    Nothing here depends on Warp's default device or on the current CUDA context, which may belong
    to another GPU: every array, event, stream and launch names its device.
    """

    kind = "warp"

    def __init__(self, alias: str, name: str):
        super().__init__()
        wp = start_warp()
        try:
            self.wp_device = wp.get_device(alias)
        except Exception as error:  # Warp raises ValueError or RuntimeError by version
            raise DeviceError(f"{name}: {error}") from error
        self._wp = wp
        self._home = self.wp_device
        self.name = name
        self.is_gpu = self.wp_device.is_cuda
        self.on_host = not self.is_gpu
        self.has_matrix_units = self.is_gpu and self.wp_device.arch >= 10 * MATRIX_UNITS
        if self.is_gpu:  # Warp's kernels use 4 bytes a work-item
            self.local_bytes = min(
                self.local_bytes, self.wp_device.max_shared_memory_per_block - 4 * self.group_limit
            )
        self.array_type = wp.array
        self._as_shown = array_class(wp).of
        self._copies = wp.Stream(self.wp_device) if self.is_gpu else None  # parallel to kernels
        self.capturing = wp.Stream(self.wp_device) if self.is_gpu else None  # for graphs only
        self._landings: defaultdict = defaultdict(list)  # pinned memory that `fetch` uses again
        self._modules: dict = {}  # modules of the stages
        self._natives: dict = {}  # kernels from OpenCL text
        self._loaded: set = set()  # modules that are built, with the sizes of their groups
        self.build_ms: dict[str, float] = {}

    @property
    def memory(self):
        return self.wp_device.free_memory if self.is_gpu else super().memory

    def _array(self, values, dtype):
        values = np.ascontiguousarray(values, dtype)
        return self._as_shown(
            self._wp.array(
                values,
                dtype=self._wp.dtype_from_numpy(np.dtype(dtype)),
                device=self.wp_device,
                copy=not self.on_host,
            )
        )

    def _share(self, values, dtype):
        wp = self._wp
        try:
            if isinstance(values, wp.array):  # of another of Warp's devices
                if self.on_host:
                    return self._array(values.numpy(), dtype)  # it waits
                array = self._bring(values)
            elif not self.is_gpu:
                return None
            elif dlpack_kind(values) in CUDA:
                with wp.ScopedDevice(
                    f"cuda:{values.__dlpack_device__()[1]}"
                ):  # torch exports from no other
                    array = wp.from_dlpack(values)  # its owner's stream is waited for
            elif hasattr(values, "__cuda_array_interface__"):
                array = self._by_interface(values)
            else:
                return None
        # each library raises its own class: for a tensor with a gradient, a type unknown to Warp
        except Exception as error:
            raise BadData(
                f"{self.name}: cannot read an array of {name_of(values)}: "
                f"{str(error).partition(chr(10))[0][:150]}"
            ) from error
        return self._fitting(self._as_shown(array), dtype)

    def _by_interface(self, values):
        """Return an array over the CUDA memory of the CUDA array interface, on any device."""
        interface = values.__cuda_array_interface__
        number = ordinal_of(interface["data"][0])
        owner = (
            self.wp_device
            if number in (None, self.wp_device.ordinal)
            else self._wp.get_device(f"cuda:{number}")
        )
        if interface.get("stream") is not None:  # work there may not have ended
            wait_for_device(self._wp, owner)
        kind = self._wp.dtype_from_numpy(np.dtype(interface["typestr"]))
        return self._wp.array(values, dtype=kind, device=owner, copy=False)

    def _bring(self, array):
        """Return a copy of an array of another Warp device, in turn with launches on both."""
        if not array.device.is_cuda:
            return array.to(self.wp_device)
        here, there = self.wp_device.stream, array.device.stream
        wait_for(mark_in(there), here)
        copy = array.to(self.wp_device)
        wait_for(mark_in(here), there)  # its memory must not be reused earlier
        return copy

    def _fitting(self, array, dtype):
        given = array
        if array.device != self.wp_device:
            array = self._bring(array)
        if not array.is_contiguous:
            array = array.contiguous()
        if self._dtype(array) != dtype:
            other, array = array, self._empty(array.shape, dtype)
            self._load("casts", self._wp.get_module("warp.utils"))
            self._wp.utils.array_cast(other, array)
        return array if array is given else self._as_shown(array)  # the caller's array stays

    def _empty(self, shape, dtype):
        return self._as_shown(
            self._wp.empty(
                shape, dtype=self._wp.dtype_from_numpy(np.dtype(dtype)), device=self.wp_device
            )
        )

    @contextmanager
    def on_stream(self, stream):
        if not self.is_gpu:
            super().on_stream(stream)  # it raises
        given = (
            stream.__cuda_stream__()[1]
            if hasattr(stream, "__cuda_stream__")
            else getattr(stream, "cuda_stream", getattr(stream, "ptr", stream))
        )
        if not isinstance(given, int):
            raise BadData(
                f"CUDA stream: {name_of(stream)}, wanted an address, or an object with `__cuda_stream__`, "
                "`cuda_stream` or `ptr`"
            )
        # PyTorch's, CuPy's
        of = getattr(stream, "device_index", getattr(stream, "device_id", None))
        if isinstance(of, int) and of not in (-1, self.wp_device.ordinal):
            raise BadData(
                f"CUDA stream: one of cuda:{of}, wanted one of {self.wp_device.alias}, which does the work"
            )
        device = self.wp_device
        with device.context_guard:  # the default stream is that of this device
            # 0: CUDA's default stream
            own, before = (self._wp.Stream(device, cuda_stream=given or None), device.stream)
            device.set_stream(own, True)  # in turn with our own
            try:
                yield
            finally:
                device.set_stream(before, True)

    def _pinned(self, shape, kind):
        """Return a Warp array in host memory that CUDA copies at the full rate of the bus."""
        with self.wp_device.context_guard:  # otherwise device 0 creates a context for it
            return self._wp.empty(shape, dtype=kind, device="cpu", pinned=True)

    @refusable(of_shape)
    def pinned(self, shape, dtype=np.float32):
        if self.on_host:
            return super().pinned(shape, dtype)
        return self._pinned(shape, self._wp.dtype_from_numpy(np.dtype(dtype))).numpy().view(Pinned)

    @refusable(of_values)
    def send(self, values, target=None, after=None):
        if self.on_host:
            return super().send(values)
        wp = self._wp
        target = self._empty(values.shape, values.dtype) if target is None else target
        if after is not None:
            wait_for(after, self._copies)
        source = wp.array(np.asarray(values), dtype=target.dtype, device="cpu", copy=False)
        wp.copy(target, source, stream=self._copies)
        return Arriving(self, target, source, mark_in(self._copies))

    @refusable(of_values)
    def fetch(self, array):
        if self.on_host:  # later launches may write to the array
            copied = np.array(array.numpy())
            return lambda: copied
        wp, free = self._wp, self._landings[array.shape, array.dtype]
        landing = free.pop() if free else self._pinned(array.shape, array.dtype)
        stream = self.wp_device.stream
        with self.wp_device.context_guard:
            if not (self.has_driver and array.is_contiguous):
                wp.copy(landing, array)
            else:  # with less host work than `wp.copy`
                given = landing.ptr, array.ptr, array.capacity, stream.cuda_stream
                call_driver("cuMemcpyDtoHAsync_v2", *given)
            event = stream.record_event()

        def finish_fetch():
            wait_for_event(self, event)
            values = np.array(landing.numpy())
            free.append(landing)
            return values

        return finish_fetch

    def mark(self):
        return None if self.on_host else mark_in(self.wp_device.stream)

    def refusal(self, error):
        text = str(error) if isinstance(error, RuntimeError) else ""
        return text if any(words in text for words in REFUSALS) else super().refusal(error)

    def give_back(self):
        self._landings.clear()

    def _reshape(self, array, shape):
        return self._as_shown(array.reshape(shape))

    def _numpy(self, array):
        return array.numpy()

    def _dtype(self, array):
        return np.dtype(self._wp.dtype_to_numpy(array.dtype))

    def _copy(self, stage, target, source, count, start, to):
        self._timed(stage, lambda: self._wp.copy(target, source, to, start, count))

    def _launch(self, stage, kernel, grid, args, defines, group):
        entry, options = self._entry(stage, kernel, defines, args, group)
        if self._clock.times is not None and self.is_gpu:
            # arguments are packed before the clock starts: the device would wait for Python
            self._command(stage, kernel, grid, args, defines, group).start()
        else:
            self._timed(
                self._clock.charged or stage,
                lambda: self._wp.launch(
                    entry, dim=grid, inputs=args, device=self.wp_device, **options
                ),
            )

    def _entry(self, stage, kernel, defines, args, group):
        """Return the kernel and its launch options."""
        options = {} if group is None or not self.is_gpu else {"block_dim": int(np.prod(group))}
        with self._lock:
            return self._kernel(stage, kernel, defines, args, options), options

    def _command(self, stage, kernel, grid, args, defines, group):
        entry, options = self._entry(stage, kernel, defines, args, group)
        launch = self._wp.launch(
            entry, dim=grid, inputs=args, device=self.wp_device, record_cmd=True, **options
        )
        return Command(self, self._clock.charged or stage, kernel, launch, args)

    def gather(self, commands):
        return gather_kernels(self, commands) if self.has_driver else super().gather(commands)

    @property
    def has_driver(self) -> bool:
        """Whether functions of CUDA's driver can be called."""
        return self.is_gpu and cuda_driver() is not None

    @property
    def is_timed(self) -> bool:
        """Whether a block is timed."""
        return self._clock.times is not None

    def _timed(self, stage, start):
        """Start something on the device, and time it if a block is timed."""
        clock = self._clock
        if clock.times is None:
            start()
        elif self.is_gpu:
            first, last = (self._wp.Event(self.wp_device, enable_timing=True) for _ in range(2))
            with self.wp_device.context_guard:
                self.wp_device.stream.record_event(first)
                start()
                self.wp_device.stream.record_event(last)
            clock.events.append((stage, first, last))
        else:  # CPU launches return when done
            begin = time.perf_counter()
            start()
            clock.times[stage] += 1e3 * (time.perf_counter() - begin)
            clock.launches += 1

    def _kernel(self, stage, kernel, defines, args, options):
        loaded = self._modules.get(stage)
        if loaded is None:
            module = f"gpusim.kernels.{stage}_warp"
            if find_spec(module) is None:
                raise DeviceError(
                    f"{stage}: no Warp kernel; add kernels/{stage.replace('.', '/')}_warp.py"
                )
            loaded = self._modules[stage] = import_module(module)
        if getattr(loaded, "NATIVE", False):
            return self._native(stage, kernel, defines, args, options)
        if not hasattr(loaded, "specialise"):
            self._load(stage, loaded, **options)
            return getattr(loaded, kernel)
        self._load(stage, loaded)
        with _building:
            entry = loaded.specialise(kernel, **defines)
        self._load(stage, entry.module, **options)  # its own module
        return entry

    def _native(self, stage, kernel, defines, args, options):
        ranks = tuple(arg.ndim if isinstance(arg, self._wp.array) else None for arg in args)
        key = (stage, kernel, ranks, *sorted(defines.items()))
        if key not in self._natives:
            with _building:
                self._natives[key] = native_kernel(self._wp, stage, kernel, defines, ranks)
        self._load(stage, self._natives[key].module, **options)
        return self._natives[key]

    def _load(self, stage, module, **options):
        """Build a module on this device, once for each size of its groups."""
        key = module, options.get("block_dim")
        if key not in self._loaded:
            with _building, announced(f"compiling {stage}"):
                self._build(stage, module, **options)
            self._loaded.add(key)

    def _build(self, stage, module, **options):
        start = time.perf_counter()
        if not keep_sound(self._cache_folders(module)):
            self._wp.config.kernel_cache_dir = str(lent_folder())
        try:
            self._wp.load_module(module, device=self.wp_device, **options)
        except Exception as cause:  # its class depends on the damage in the cache, if any
            self._forget(module, cause)
            try:
                self._wp.load_module(module, device=self.wp_device, **options)
            except Exception as error:
                raise DeviceError(
                    f"{self.name}: cannot build {stage}: {str(error).partition(chr(10))[0]}"
                ) from error
        for folder in self._cache_folders(module):
            note(folder)
        self.build_ms[stage] = self.build_ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)

    def _cache_folders(self, module):
        """Return the folders in which Warp keeps a module, by the first digits of its hash."""
        name = getattr(module, "name", None) or module.__name__
        return list(Path(self._wp.config.kernel_cache_dir).glob(f"wp_{name}_{'[0-9a-f]' * 7}"))

    def _forget(self, module, cause):
        """Remove the files of a module; use a temporary folder if the cache has no room."""
        folders = self._cache_folders(module)
        for folder in folders:
            remove(folder)
        folder = Path(self._wp.config.kernel_cache_dir)
        if not has_room(folder) or any(map(os.path.lexists, folders)):
            self._wp.config.kernel_cache_dir = str(lent_folder())
        elif folders:
            log.warning(
                "gpusim: %s could not be loaded (%s), and is built again",
                folders[0],
                str(cause).partition("\n")[0],
            )
        # Warp keeps failures, too
        (
            module if hasattr(module, "mark_modified") else self._wp.get_module(module.__name__)
        ).mark_modified()

    def sync(self):
        wait_for_device(self._wp, self.wp_device)

    def _collect(self, clock):
        clock.launches += len(clock.events)
        with self.wp_device.context_guard:
            for stage, first, last in clock.events:
                clock.times[stage] += self._wp.get_event_elapsed_time(first, last)
        clock.events.clear()
