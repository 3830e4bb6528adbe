"""Commands of a Warp device: kernels with arguments, transfers from the host."""

import ctypes

import numpy as np

from gpusim.backends.device import Transfer
from gpusim.backends.warp_arrays import wait_for


class Command:
    """A launch with packed arguments. stage: stage that is charged. name: name of the kernel."""

    def __init__(self, device, stage, name, launch, args):
        self.device, self.stage, self.name = device, stage, name
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

    def set(self, args):
        for index, (old, new) in enumerate(zip(self.args, args, strict=True)):
            if new is old or (isinstance(new, int | float | np.number) and new == old):
                continue
            packed = self.launch.params[index + 1]
            if isinstance(new, int | float | np.number):
                packed.value = new
            elif (
                new.shape == old.shape
                and new.dtype == old.dtype
                and new.is_contiguous
                and old.is_contiguous
            ):
                packed.data = new.ptr  # nothing else differs; packing the array again takes 10 us
            else:
                self.launch.set_param_at_index(index, new)
                self._own(index + 1)
        self.args = args

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
        self.device._wp.synchronize_event(self.event)
