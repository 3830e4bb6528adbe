"""Arrays of OpenCL devices, which show themselves as NumPy's do."""

from math import prod

import numpy as np

from gpusim.domain.foreign import CPU

FREE_BLOCKS = (
    32  # kept for reuse: fresh pages cost as much as the kernel that writes them (3 ms for 25 MB)
)
VECTOR = 16  # [byte] at which memory of the host must begin for kernels to use it where it is


class OpenCLArray:
    """A buffer with a shape; `host` is the same memory as NumPy on CPU devices, None elsewhere.

    `np.asarray(x)` waits for the device and gives the values: the memory itself on CPU devices, a copy elsewhere.
    `x[i]` and `x[i:j]` are arrays of the device, of the same memory where that begins at an address that the device
    takes, else copies. Where the memory is the host's, others take it by DLPack: `torch.from_dlpack(x)`.
    device: that it is of. owner: what must live as long as the buffer is in use. region: buffer and place [byte] in it
    that this one begins at.
    """

    def __init__(self, device, buffer, shape, dtype, host=None, owner=None, region=None):
        self.device, self.buffer, self.shape, self.dtype = (
            device,
            buffer,
            tuple(shape),
            np.dtype(dtype),
        )
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
        """Wait, then the values: a view where the memory is the host's, else a copy."""
        return self.device.numpy(self)

    def __array__(self, dtype=None, copy=None):
        if self.host is None and copy is False:
            raise ValueError(
                f"the values of an array of {self.device.name} cannot be had without a copy"
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
        """The values from row `start` on in another shape: of this memory where that can be."""
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
            return OpenCLArray(device, device.wrapped(host), shape, self.dtype, host, self)
        return self._copied([(first, prod(shape))], shape)

    def _rows(self, rows):
        size = prod(self.shape[1:])
        return self._copied([(row * size, size) for row in rows], (len(rows), *self.shape[1:]))

    def _copied(self, parts, shape):
        """Copy of ranges (start, count) of the values, one behind the other."""
        result, to = self.device.empty(shape, self.dtype), 0
        for start, count in parts if result.size else ():
            self.device._copied(result, self, count, start, to)
            to += count
        return result


class Block:
    """Memory that goes back to its device's free list when nothing refers to it, NumPy views included."""

    def __init__(self, free, nbytes, buffer, host):
        self.free, self.nbytes, self.buffer, self.host = free, nbytes, buffer, host
        if host is not None:
            self.__array_interface__ = (
                host.__array_interface__
            )  # np.asarray(block) keeps the block alive

    def __del__(self):
        if sum(map(len, list(self.free.values()))) < FREE_BLOCKS:  # a list: threads add sizes
            self.free[self.nbytes].append((self.buffer, self.host))
