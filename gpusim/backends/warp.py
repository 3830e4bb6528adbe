"""Warp devices: CUDA GPUs, and the CPU (one thread) for equivalence and debugging."""

import os
import shutil
import sys
import time
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gpusim.backends.caches import is_writable, lent_folder
from gpusim.backends.device import Device
from gpusim.backends.native import native_kernel
from gpusim.domain.errors import DeviceError


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


class WarpDevice(Device):
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
        self._natives: dict = {}  # kernels from OpenCL text
        self._loaded: set = set()  # specialised kernels that are built
        self.build_ms: dict[str, float] = {}

    @property
    def memory(self):
        return self.wp_device.free_memory if self.is_gpu else super().memory

    def array(self, values, dtype=np.float32):
        if isinstance(values, self._wp.array):
            return values
        values = np.ascontiguousarray(values, dtype)
        return self._wp.array(values, dtype=self._wp.dtype_from_numpy(np.dtype(dtype)), device=self.wp_device,
                              copy=not self.on_host)

    def empty(self, shape, dtype=np.float32):
        return self._wp.empty(shape, dtype=self._wp.dtype_from_numpy(np.dtype(dtype)), device=self.wp_device)

    def numpy(self, array):
        return array if isinstance(array, np.ndarray) else array.numpy()

    def stack(self, arrays):
        result = self._wp.empty((len(arrays), *arrays[0].shape), dtype=arrays[0].dtype, device=self.wp_device)
        for number, array in enumerate(arrays):
            self._wp.copy(result, array, dest_offset=number * array.size, count=array.size)
        return result

    def part(self, array, index):
        result = self._wp.empty(array.shape[1:], dtype=array.dtype, device=self.wp_device)
        self._wp.copy(result, array, src_offset=index * result.size, count=result.size)
        return result

    def launch(self, stage, kernel, grid, *args, defines=None, group=None):
        options = {} if group is None or not self.is_gpu else {"block_dim": int(np.prod(group))}
        clock = self._clock
        with self._lock:
            entry = self._kernel(stage, kernel, defines or {}, args, options)
        begin = time.perf_counter()
        if clock.times is not None and self.is_gpu:
            first = self._wp.Event(self.wp_device, enable_timing=True)
            last = self._wp.Event(self.wp_device, enable_timing=True)
            # arguments are packed before the clock starts: the device would wait for Python in between
            command = self._wp.launch(entry, dim=grid, inputs=args, device=self.wp_device, record_cmd=True, **options)
            self._wp.record_event(first)
            command.launch()
            self._wp.record_event(last)
            clock.events.append((clock.charged or stage, first, last))
            return
        self._wp.launch(entry, dim=grid, inputs=args, device=self.wp_device, **options)
        if clock.times is not None:
            clock.times[clock.charged or stage] += 1e3 * (time.perf_counter() - begin)  # CPU launches return when done

    def _kernel(self, stage, kernel, defines, args, options):
        module = f"gpusim.kernels.{stage}_warp"
        if find_spec(module) is None:
            raise DeviceError(f"{stage}: no Warp kernel; add kernels/{stage.replace('.', '/')}_warp.py")
        loaded = import_module(module)
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
