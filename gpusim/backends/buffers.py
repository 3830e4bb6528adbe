"""Arrays of OpenCL devices, with the interface of NumPy's, and commands: kernels with arguments."""

from collections import defaultdict
from math import prod

import numpy as np

from gpusim.backends.device import Transfer
from gpusim.domain.memory import CPU

# kept for reuse: fresh pages cost as much as the kernel that writes them (3 ms for 25 MB)
FREE_BLOCKS = 32
FREE_BYTES = 2**30  # more blocks, up to so much in all
VECTOR = 16  # [byte] alignment of host memory that kernels use in place
PAGE = 4096


def allocate_pages(nbytes: int) -> np.ndarray:
    """Return new memory of the host that begins at a page, uint8.

    Args:
        nbytes: Its size.
    """
    store = np.empty(nbytes + PAGE, np.uint8)
    start = -store.ctypes.data % PAGE
    return store[start : start + nbytes]


class OpenCLArray:
    """A buffer with a shape.

    `np.asarray(x)` waits for the device and returns the values: the memory itself on CPU devices, a
    copy on others. `x[i]` and `x[i:j]` are arrays of the device. They share the memory if they
    begin at an address that the device accepts, and are copies otherwise. Host memory is shared by
    DLPack: `torch.from_dlpack(x)`.

    Attributes:
        host: The same memory as NumPy array on CPU devices, None on others.
        device: The array's device.
        owner: Object that must live as long as the buffer.
        ptr: Address of the driver's buffer object.
        region: Buffer, and place in it at which this one begins [byte].
    """

    def __init__(self, device, buffer, shape, dtype, host=None, owner=None, region=None):
        self.device = device
        self.buffer = buffer
        self.ptr = buffer.int_ptr
        self.shape = tuple(shape)
        self.dtype = np.dtype(dtype)
        self.host, self.owner, self.region = host, owner, region or (buffer, 0)
        self.nbytes = prod(self.shape) * self.dtype.itemsize

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of values."""
        return prod(self.shape)

    def __len__(self):
        if not self.shape:
            raise TypeError("an array of no axes has no length")
        return self.shape[0]

    def __repr__(self):
        return f"OpenCLArray(shape={self.shape}, dtype={self.dtype}, device={self.device.name})"

    def numpy(self) -> np.ndarray:
        """Wait, and return the values: a view if the memory is the host's, else a copy."""
        return self.device.numpy(self)

    def __array__(self, dtype=None, copy=None):
        if self.host is None and copy is False:
            raise ValueError(
                f"the values of an array of {self.device.name} cannot be read without a copy"
            )
        values = self.numpy()
        return np.array(values, dtype, copy=copy if self.host is not None else None)

    def __dlpack_device__(self):
        self._require_host()
        return CPU

    def __dlpack__(self, *, stream=None, max_version=None, dl_device=None, copy=None):
        self._require_host()
        return self.numpy().__dlpack__(
            stream=stream, max_version=max_version, dl_device=dl_device, copy=copy
        )

    def _require_host(self):
        if self.host is None:
            raise BufferError(
                f"{self.device.name}: OpenCL memory cannot be shared: use np.asarray(x), or device warp"
            )

    def __getitem__(self, key):
        if not self.shape:
            raise IndexError("an array of no axes has no elements")
        count = self.shape[0]
        if isinstance(key, slice):
            start, stop, step = key.indices(count)
            rows = range(start, stop, step)
            if step == 1 or len(rows) <= 1:
                return self._part(start if rows else 0, (len(rows), *self.shape[1:]))
            return self._rows(rows)
        try:
            index = key.__index__()
        except AttributeError:
            raise TypeError(
                "arrays of OpenCL devices are indexed along the first axis, by whole numbers and slices: "
                "for more, index np.asarray(x)"
            ) from None
        if not -count <= index < count:
            raise IndexError(f"index {index} is out of bounds for an axis of {count}")
        return self._part(index % count, self.shape[1:])

    def _part(self, start, shape):
        """Return the values from row `start` on in another shape, if possible without a copy."""
        device, nbytes = self.device, prod(shape) * self.dtype.itemsize
        if not nbytes:
            return device.empty(shape, self.dtype)
        first = start * prod(self.shape[1:])
        host = (
            None
            if self.host is None
            else self.host.reshape(-1)[first : first + prod(shape)].reshape(shape)
        )
        root, begin = self.region
        begin += first * self.dtype.itemsize
        if begin % device.alignment == 0:
            return OpenCLArray(
                device,
                root.get_sub_region(begin, nbytes),
                shape,
                self.dtype,
                host,
                self,
                (root, begin),
            )
        if host is not None and host.ctypes.data % VECTOR == 0:
            return OpenCLArray(device, device.wrap(host), shape, self.dtype, host, self)
        return self._copy_ranges([(first, prod(shape))], shape)

    def _rows(self, rows):
        size = prod(self.shape[1:])
        return self._copy_ranges([(row * size, size) for row in rows], (len(rows), *self.shape[1:]))

    def _copy_ranges(self, parts, shape):
        """Return a copy of ranges (start, count) of the values, one after the other."""
        result, to = self.device.empty(shape, self.dtype), 0
        for start, count in parts if result.size else ():
            self.device._start_copy(result, self, count, start, to)
            to += count
        return result


class FreeMemory:
    """Memory of arrays that were dropped, by its size [byte].

    Threads may change the counts at the same time: they are made again before memory is refused.
    """

    def __init__(self):
        self._blocks: defaultdict = defaultdict(list)
        self._nbytes, self._count = 0, 0

    def take(self, nbytes):
        """Return memory of this size. Raises IndexError if there is none."""
        found = self._blocks[nbytes].pop()
        self._nbytes -= nbytes
        self._count -= 1
        return found

    def keep(self, nbytes, memory):
        """Keep memory for `take`, unless there is enough."""
        if self._nbytes + nbytes > FREE_BYTES and self._count >= FREE_BLOCKS:
            blocks = [(size, len(its)) for size, its in list(self._blocks.items())]
            self._nbytes = sum(size * count for size, count in blocks)
            self._count = sum(count for _, count in blocks)
            if self._nbytes + nbytes > FREE_BYTES and self._count >= FREE_BLOCKS:
                return
        self._blocks[nbytes].append(memory)
        self._nbytes += nbytes
        self._count += 1

    def clear(self):
        """Free all memory."""
        self._blocks.clear()
        self._nbytes, self._count = 0, 0


class Block:
    """Memory that returns to its device's free memory after the last reference, also of views."""

    def __init__(self, free, nbytes, buffer, host):
        self.free, self.nbytes, self.buffer, self.host = free, nbytes, buffer, host
        if host is not None:
            # np.asarray(block) keeps the block alive
            self.__array_interface__ = host.__array_interface__

    def __del__(self):
        self.free.keep(self.nbytes, (self.buffer, self.host))


def kinds_of(args) -> list:
    """Return the types of a kernel's arguments: of numbers, and None for arrays."""
    return [
        np.int32
        if isinstance(arg, int | np.integer)
        else np.float32
        if isinstance(arg, float | np.floating)
        else None
        for arg in args
    ]


def _value_of(arg):
    return arg.buffer if isinstance(arg, OpenCLArray) else arg


class Command:
    """A separate kernel object with its arguments, whose types it knows.

    stage: stage that is charged. name: name of the kernel. spare: list to which the kernel finally
    returns. words: names the work of the first start, such as "compiling sensor.noise"; "" if it compiles nothing.
    """

    def __init__(self, device, stage, name, kernel, pieces, args, spare, words):
        self.device, self.stage, self.name, self.words = device, stage, name, words
        self.kernel, self.args, self.spare = kernel, args, spare
        self.pieces = [
            (size[::-1], block[::-1], offset[::-1] if any(offset) else None)
            for size, block, offset in pieces
        ]
        self.enqueue = device._cl.enqueue_nd_range_kernel
        kernel.set_args(*map(_value_of, args))

    def __del__(self):
        self.spare.append(self.kernel)

    def set(self, args, first=0):
        """Set other arguments; those before `first` are the same."""
        arrays, has_numbers = [], False
        for index in range(first, len(args)):
            old, new = self.args[index], args[index]
            if isinstance(new, OpenCLArray):
                if new is not old:
                    arrays.append(index)
            elif new != old:
                has_numbers = True
        if has_numbers:  # all at once: one number alone takes longer
            self.kernel.set_args(*map(_value_of, args))
        else:
            for index in arrays:
                self.kernel.set_arg(index, args[index].buffer)
        self.args = args

    def release(self):
        """Forget the arrays; the device keeps them while they are used."""
        self.args = tuple(None if isinstance(arg, OpenCLArray) else arg for arg in self.args)

    def start(self):
        if self.words:
            words, self.words = self.words, ""
            with self.device._lock, self.device.compiling(words):
                self._enqueue()
        else:
            self._enqueue()

    def _enqueue(self):
        device, kernel, enqueue = self.device, self.kernel, self.enqueue
        clock = device._clock
        with device._lock:
            for size, block, offset in self.pieces:
                event = enqueue(device.queue, kernel, size, block, offset)
                if clock.times is not None:
                    clock.events.append((self.stage, event))
            device._keep(self.args)


class Arriving(Transfer):
    """An array that a separate queue writes while kernels run."""

    def __init__(self, device, array, event):
        super().__init__(array)
        self.device, self.event = device, event  # the event keeps the values

    def join(self):
        with self.device._lock:
            self.device._cl.enqueue_barrier(self.device.queue, wait_for=[self.event])
        return self.array

    def wait(self):
        with self.device.waiting():
            self.event.wait()
