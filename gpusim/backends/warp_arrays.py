"""Arrays of Warp devices with the interface of NumPy's, the order of streams, and commands."""

import ctypes
import functools
import threading

import numpy as np

from gpusim.backends.cuda_driver import call_driver
from gpusim.backends.device import Transfer


@functools.cache
def array_class(wp):
    """Return a subclass of Warp's array with more of NumPy's interface.

    Warp's own refuses `np.asarray` on CUDA memory, and empty slices.
    """

    class WarpArray(wp.array):
        def __array__(
            self, dtype=None, copy=None
        ):  # in host memory NumPy takes `__array_interface__`
            if self.device.is_cuda and copy is False:
                raise ValueError(
                    f"the values of an array of warp:{self.device} cannot be read without a copy"
                )
            return np.array(self.numpy(), dtype, copy=None if self.device.is_cuda else copy)

        def numpy(self):
            """Wait, then the values: a view in host memory, a copy of CUDA's.

            Warp's own makes another stream current meanwhile, for every thread.
            """
            if not self.device.is_cuda or not self.size:
                return super().numpy()
            values = np.empty(self.shape, wp.dtype_to_numpy(self.dtype))
            wait_for_device(wp, self.device)
            wp.copy(
                wp.array(values, dtype=self.dtype, device="cpu", copy=False),
                self if self.is_contiguous else self.contiguous(),
            )
            wait_for_device(wp, self.device)
            return values

        def __getitem__(self, key):
            if isinstance(key, slice):
                start, stop, step = key.indices(len(self))
                if step < 0 or stop <= start:  # Warp has no such views
                    return as_shown(
                        wp.array(self.numpy()[key], dtype=self.dtype, device=self.device)
                    )
                key = slice(start, stop, step)
            elif hasattr(key, "__index__"):
                # the error also ends a loop over the array
                if not -len(self) <= key.__index__() < len(self):
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


def mark_in(stream):
    """Return an event after a stream's work, on the stream's own device."""
    with stream.device.context_guard:  # CUDA's default stream is that of the current context
        return stream.record_event()


def wait_for(event, stream):
    """Make later work of a stream wait for an event of any device."""
    with stream.device.context_guard:
        stream.wait_event(event)


CAPTURES: dict[str, threading.RLock] = {}


def capturing(name: str) -> threading.RLock:
    """Return the lock of a CUDA device of Warp that a capture of a graph holds: Warp refuses to wait meanwhile."""
    return CAPTURES.setdefault(name, threading.RLock())


def wait_for_device(wp, device):
    """Wait for all work of a device, of every thread."""
    with capturing(str(device)):  # Warp's devices cannot be keys
        wp.synchronize_device(device)


def wait_for_event(device, event):
    """Wait for an event of a WarpDevice, also while another thread captures: only Warp's own function refuses."""
    if device.has_driver:
        call_driver("cuEventSynchronize", event.cuda_event)
    else:
        device._wp.synchronize_event(event)


class Command:
    """A launch with packed arguments.

    stage: stage that is charged. name: name of the kernel. changes: how often its arguments were changed.
    """

    def __init__(self, device, stage, name, launch, args):
        self.device, self.stage, self.name, self.changes = device, stage, name, 0
        self.launch, self.args = launch, args
        for index in range(len(args)):
            self._own(index + 1)

    def _own(self, place):
        """Pack an array for this launch only: Warp shares one pack, and `set` writes to it."""
        params, addresses = self.launch.params, self.launch.params_addr
        if isinstance(params[place], ctypes.Structure):
            params[place] = type(params[place]).from_buffer_copy(params[place])
            if addresses:
                addresses[place] = ctypes.c_void_p(ctypes.addressof(params[place]))

    def set(self, args, first=0):
        """Set other arguments; those before `first` are the same."""
        for index in range(first, len(args)):
            old, new = self.args[index], args[index]
            if new is old or (isinstance(new, int | float | np.number) and new == old):
                continue
            self.changes += 1
            packed = self.launch.params[index + 1]
            if isinstance(new, int | float | np.number):
                packed.value = new
            elif (
                old is not None
                and new.shape == old.shape
                and new.dtype == old.dtype
                and new.is_contiguous
                and old.is_contiguous
            ):
                packed.data = new.ptr  # nothing else differs; packing the array again takes 10 us
            else:
                self.launch.set_param_at_index(index, new)
                self._own(index + 1)
        self.args = args

    def release(self):
        """Forget the arrays."""
        numbers = int, float, np.number
        self.args = tuple(arg if isinstance(arg, numbers) else None for arg in self.args)
        self.launch.fwd_args = None  # Warp's copy for recordings of its own

    def start(self):
        self.device._timed(self.stage, self.launch.launch)


class Arriving(Transfer):
    """An array that a separate stream writes while kernels run."""

    def __init__(self, device, array, source, event):
        super().__init__(array)
        self.device, self.source, self.event = device, source, event

    def join(self):
        wait_for(self.event, self.device.wp_device.stream)
        return self.array

    def wait(self):
        wait_for_event(self.device, self.event)
