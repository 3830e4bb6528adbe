"""OpenCL devices: PoCL on CPUs, any vendor's GPU."""

import os
import time
import weakref
from collections import defaultdict, deque
from contextlib import contextmanager
from math import prod

import numpy as np

from gpusim.backends.buffers import (
    VECTOR,
    Arriving,
    Block,
    Command,
    FreeMemory,
    OpenCLArray,
    allocate_pages,
    kinds_of,
)
from gpusim.backends.caches import pocl_folder
from gpusim.backends.device import MATRIX_UNITS
from gpusim.backends.driver import finish, is_gpu, pyopencl
from gpusim.backends.launches import BUILD_OPTIONS, program_head, split_grid, stage_source
from gpusim.backends.pocl import known_processor
from gpusim.backends.pocl_programs import Programs
from gpusim.backends.refusal import of_shape, of_values, refusable
from gpusim.backends.tape import SMALL, Taped
from gpusim.domain.errors import DeviceError
from gpusim.domain.memory import Pinned
from gpusim.domain.progress import announced

# Refused memory, in the drivers' words; a buffer's size above the limit of one buffer is "invalid"
REFUSALS = (
    "MEM_OBJECT_ALLOCATION_FAILURE",
    "OUT_OF_RESOURCES",
    "OUT_OF_HOST_MEMORY",
    "INVALID_BUFFER_SIZE",
)


class OpenCLDevice(Taped):
    """One OpenCL device with one in-order queue; `timed` uses a second one with event times."""

    kind = "opencl"
    array_type = OpenCLArray

    def __init__(self, cl_device, name: str):
        super().__init__()
        self._cl = cl = pyopencl()
        self.name = name
        self.cl_device = cl_device
        self.group_limit = cl_device.max_work_group_size
        self.local_bytes = min(self.local_bytes, cl_device.local_mem_size)
        self.is_gpu = is_gpu(cl_device)
        self.has_fp64 = "cl_khr_fp64" in cl_device.extensions
        if "cl_nv_device_attribute_query" in cl_device.extensions:
            self.has_matrix_units = cl_device.compute_capability_major_nv >= MATRIX_UNITS
        self.on_host = not self.is_gpu and bool(cl_device.host_unified_memory)
        self.alignment = cl_device.mem_base_addr_align // 8  # [byte] of buffers inside others
        self.processor = known_processor(cl_device)
        self.context = cl.Context([cl_device])
        # NVIDIA's queue takes 15 us for a launch if it records times
        self._queues = (
            cl.CommandQueue(self.context),
            cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE),
        )
        self.queue, self._timing = self._queues[0], 0
        # parallel to kernels
        self._copies = None if self.on_host else cl.CommandQueue(self.context)
        self._kernels: dict = {}
        self._spare: defaultdict = defaultdict(list)  # kernels without a command
        self._programs: dict = {}
        self._built = Programs(cl, self.context)
        # new program -> kernels and sizes of groups that have started: PoCL compiles each then
        self._started: dict[tuple, set] = {}
        self._free = FreeMemory()  # for reuse
        self._landings: defaultdict = defaultdict(list)  # pinned memory that `fetch` uses again
        self._sent: deque = deque()  # small copies to the device that may not have ended
        self._in_flight: list = []  # host memory of queued kernels, which must outlive them
        self.build_ms: dict[str, float] = {}  # time to build the programs of each stage
        # When Python ends, it frees arrays and the device in any order: the driver must not write
        # to them then
        self._waits: list = []  # one entry for each thread that waits in the driver
        weakref.finalize(
            self, finish, self._lock, (*self._queues, self._copies), self._waits, os.getpid()
        )

    @property
    def memory(self):
        return super().memory if self.on_host else self.cl_device.global_mem_size

    @property
    def largest_array(self):
        return self.cl_device.max_mem_alloc_size

    def _array(self, values, dtype):
        values = np.ascontiguousarray(values, dtype)
        if not values.size:  # OpenCL has no empty buffers
            return self._empty(values.shape, dtype)
        if self.on_host and values.ctypes.data % VECTOR == 0:
            return OpenCLArray(self, self.wrap(values), values.shape, dtype, values)
        result = self._empty(values.shape, dtype)
        if values.nbytes > SMALL:
            with self.waiting():
                self._cl.enqueue_copy(self.queue, result.buffer, values)  # blocks: `values` may go
        else:  # a blocking copy would wait for all earlier launches
            done = self._cl.command_execution_status.COMPLETE
            with self._lock:  # the queue stays
                self._sent.append(
                    self._cl.enqueue_copy(
                        self.queue, result.buffer, values.copy(), is_blocking=False
                    )
                )
                while self._sent and self._sent[0].command_execution_status == done:
                    self._sent.popleft()
        return result

    def _fitting(self, array, dtype):
        return array if array.dtype == dtype else self._array(self._numpy(array), dtype)

    def _empty(self, shape, dtype):
        dtype = np.dtype(dtype)
        nbytes = max(prod(shape) * dtype.itemsize, 1)
        try:
            buffer, host = self._free.take(nbytes)
        except IndexError:
            buffer, host = self._allocate(nbytes)
        block = Block(self._free, nbytes, buffer, host)
        if host is not None:
            host = np.asarray(block)[: prod(shape) * dtype.itemsize].view(dtype).reshape(shape)
        return OpenCLArray(self, buffer, shape, dtype, host, block)

    def _allocate(self, nbytes):
        if not self.on_host:
            return self._cl.Buffer(self.context, self._cl.mem_flags.READ_WRITE, nbytes), None
        host = allocate_pages(nbytes)  # page-aligned memory is shared, not copied
        return self.wrap(host), host

    def wrap(self, values: np.ndarray):
        """Return a buffer over host memory, which must outlive it."""
        flags = self._cl.mem_flags
        access = flags.READ_WRITE if values.flags.writeable else flags.READ_ONLY
        return self._cl.Buffer(self.context, access | flags.USE_HOST_PTR, hostbuf=values)

    @refusable(of_shape)
    def pinned(self, shape, dtype=np.float32):
        if self.on_host:
            return super().pinned(shape, dtype)
        flags, dtype = self._cl.mem_flags, np.dtype(dtype)
        buffer = self._cl.Buffer(
            self.context,
            flags.READ_WRITE | flags.ALLOC_HOST_PTR,
            max(prod(shape) * dtype.itemsize, 1),
        )
        both = self._cl.map_flags.READ | self._cl.map_flags.WRITE
        # it keeps the buffer
        values, _ = self._cl.enqueue_map_buffer(self.queue, buffer, both, 0, tuple(shape), dtype)
        return values.view(Pinned)

    @refusable(of_values)
    def send(self, values, target=None, after=None):
        if self.on_host:
            return super().send(values)
        target = self._empty(values.shape, values.dtype) if target is None else target
        event = self._cl.enqueue_copy(
            self._copies,
            target.buffer,
            values,
            is_blocking=False,
            wait_for=None if after is None else [after],
        )
        self._copies.flush()
        return Arriving(self, target, event)

    @refusable(of_values)
    def fetch(self, array):
        if self.on_host:  # later launches may write to the array
            copied = self._empty(array.shape, array.dtype)
            with self._lock:
                self._cl.enqueue_copy(
                    self.queue, copied.buffer, array.buffer, byte_count=array.nbytes
                )
                self._keep((copied, array))
            return lambda: self._numpy(copied)
        free = self._landings[array.shape, array.dtype]
        values = free.pop() if free else self.pinned(array.shape, array.dtype)
        with self._lock:
            event = self._cl.enqueue_copy(self.queue, values, array.buffer, is_blocking=False)

        def finish_fetch():
            with self.waiting():
                event.wait()
            free.append(values)
            return np.array(values, copy=True, subok=False)

        return finish_fetch

    def mark(self):
        if self.on_host:
            return None
        with self._lock:
            return self._cl.enqueue_marker(self.queue)

    def refusal(self, error):
        text = str(error) if isinstance(error, self._cl.Error) else ""
        return text if any(name in text for name in REFUSALS) else super().refusal(error)

    def give_back(self):
        self._free.clear()
        self._landings.clear()

    def _reshape(self, array, shape):
        host = None if array.host is None else array.host.reshape(shape)
        return OpenCLArray(self, array.buffer, shape, array.dtype, host, array.owner, array.region)

    def _numpy(self, array):
        if array.host is not None:
            self.sync()
            return array.host
        out = np.empty(array.shape, array.dtype)
        if out.size:
            with self.waiting():
                self._cl.enqueue_copy(self.queue, out, array.buffer)
        return out

    def _dtype(self, array):
        return array.dtype

    def _copy(self, stage, target, source, count, start, to):
        size = source.dtype.itemsize
        with self._lock:
            event = self._cl.enqueue_copy(
                self.queue,
                target.buffer,
                source.buffer,
                byte_count=count * size,
                src_offset=start * size,
                dst_offset=to * size,
            )
            if self._clock.times is not None:
                self._clock.events.append((stage, event))
            self._keep((target, source))

    def _launch(self, stage, kernel, grid, args, defines, group):
        clock = self._clock
        values = [arg.buffer if isinstance(arg, OpenCLArray) else arg for arg in args]
        with self._lock:  # a kernel keeps its arguments from being set until it is started
            entry = self._kernel(stage, kernel, defines, args)
            pieces = split_grid(tuple(grid), group, self.is_gpu)
            with self.compiling(self._first_words(stage, kernel, defines, pieces)):
                for size, block, offset in pieces:
                    event = entry(
                        self.queue, size[::-1], block[::-1], *values, global_offset=offset[::-1]
                    )
                    if clock.times is not None:
                        clock.events.append((clock.charged or stage, event))
            self._keep(args)

    def _keep(self, used):
        """Keep queued kernels' arguments until these have ended; GPU drivers do so themselves."""
        if self.is_gpu:
            return
        if len(self._in_flight) > 256:
            self.sync()
        self._in_flight.append(used)

    def _command(self, stage, kernel, grid, args, defines, group):
        spare = self._spare[stage, kernel, *sorted(defines.items())]
        try:
            entry = spare.pop()  # making one takes 0.2 ms
        except IndexError:
            with self._lock:
                entry = self._entry(stage, self._program(stage, defines), kernel, args)
        pieces = split_grid(tuple(grid), group, self.is_gpu)
        words = self._first_words(stage, kernel, defines, pieces)
        charged = self._clock.charged or stage
        return Command(self, charged, kernel, entry, pieces, args, spare, words)

    def _first_words(self, stage, kernel, defines, pieces):
        """Return words for the kernels that PoCL will compile as these pieces start; "" if there are none."""
        started = self._started.get((stage, *sorted(defines.items())))
        if started is None:
            return ""
        new = {(kernel, block, any(offset)) for _, block, offset in pieces} - started
        started |= new
        return f"compiling {stage}" if new else ""

    @contextmanager
    def compiling(self, words: str):
        """Announce the first start of kernels inside the block, and wait for it. words: "" for a later start."""
        if not words:
            yield
            return
        with announced(words):
            yield
            self.queue.finish()

    def _kernel(self, stage, kernel, defines, args):
        key = (stage, kernel, *sorted(defines.items()))
        if key not in self._kernels:
            program = self._program(stage, defines)
            self._kernels[key] = self._entry(stage, program, kernel, args)
        return self._kernels[key]

    def _entry(self, stage, program, kernel, args):
        try:
            entry = self._cl.Kernel(program, kernel)
            # typed once, a launch costs microseconds instead of hundreds of them
            entry.set_arg_types(kinds_of(args))
            return entry
        except self._cl.Error as error:
            raise DeviceError(
                f"{self.name} ({self.cl_device.name}): cannot load {kernel} of {stage}: {error}; remove "
                f"the driver's cache of compiled kernels ({pocl_folder()})"
            ) from error

    def _program(self, stage, defines):
        key = (stage, *sorted(defines.items()))
        if key not in self._programs:
            source, include = stage_source(stage)
            head = program_head(defines, self.is_gpu)
            if self.processor:  # PoCL's cache does not know that it builds for another processor
                head += f"typedef int built_for_{self.processor.replace('-', '_')};\n"
            start = time.perf_counter()
            options = [*BUILD_OPTIONS, "-I", str(include)]
            if "REGISTERS" in defines and "cl_nv_compiler_options" in self.cl_device.extensions:
                options.append(f"-cl-nv-maxrregcount={defines['REGISTERS']}")
            try:
                with announced(f"compiling {stage}"):
                    self._programs[key], is_new = self._built.build(head + source, options)
                if is_new:
                    self._started[key] = set()
            except self._cl.Error as error:
                lines = str(error).splitlines()  # with the compiler's log
                cause = next((line for line in lines if "error: " in line), lines[0])[:300]
                raise DeviceError(
                    f"{self.name} ({self.cl_device.name}): cannot build {stage}.cl: {cause}"
                ) from error
            self.build_ms[stage] = self.build_ms.get(stage, 0.0) + 1e3 * (
                time.perf_counter() - start
            )
        return self._programs[key]

    def flush(self):
        with self._lock:  # the queue stays
            self.queue.flush()

    def sync(self):
        with self._lock:
            done, self._in_flight = self._in_flight, []
        with self.waiting():
            self.queue.finish()
        done.clear()  # only now have the kernels that used them ended

    @contextmanager
    def waiting(self):
        """Mark a driver call that lets other threads run; the end of the process waits for it."""
        with self._lock:
            self._waits.append(None)
        try:
            yield
        finally:
            self._waits.pop()

    @contextmanager
    def timed(self):
        self._record(1)
        try:
            with super().timed() as times:
                yield times
        finally:
            self._record(-1)

    def _record(self, more):
        """Launch on the queue that records times while any thread times a block."""
        with self._lock:
            self._timing += more
            queue = self._queues[self._timing > 0]
            if queue is not self.queue:
                self.queue.finish()  # keeps the order of launches
                self.queue = queue

    def _collect(self, clock):
        clock.launches += len(clock.events)
        for stage, event in clock.events:
            clock.times[stage] += 1e-6 * (event.profile.end - event.profile.start)
        clock.events.clear()
