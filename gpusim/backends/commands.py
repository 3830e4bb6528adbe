"""Commands of an OpenCL device: kernels with arguments, transfers from the host."""

import numpy as np

from gpusim.backends.buffers import OpenCLArray
from gpusim.backends.device import Transfer


class Command:
    """A separate kernel object with its arguments.

    stage: stage that is charged. name: name of the kernel. spare: list to which the kernel finally
    returns.
    """

    def __init__(self, device, stage, name, kernel, pieces, args, spare):
        self.device, self.stage, self.name = device, stage, name
        self.kernel, self.args, self.spare = kernel, args, spare
        self.pieces = [
            (size[::-1], block[::-1], offset[::-1] if any(offset) else None)
            for size, block, offset in pieces
        ]
        self.enqueue = device._cl.enqueue_nd_range_kernel
        for index, value in enumerate(args):
            self._set(index, value)

    def __del__(self):
        self.spare.append(self.kernel)

    def _set(self, index, value):
        if isinstance(value, OpenCLArray):
            value = value.buffer
        elif isinstance(value, int | np.integer):
            value = np.int32(value)
        else:
            value = np.float32(value)
        self.kernel.set_arg(index, value)

    def set(self, args):
        for index, (old, new) in enumerate(zip(self.args, args, strict=True)):
            if new is old or (not isinstance(new, OpenCLArray) and new == old):
                continue
            self._set(index, new)
        self.args = args

    def start(self):
        device = self.device
        with device._lock:
            for size, block, offset in self.pieces:
                event = self.enqueue(device.queue, self.kernel, size, block, offset)
                clock = device._clock
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
