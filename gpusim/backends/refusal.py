"""Memory that a driver refuses after planning: one line that names the request and the remedy.

The need of a frame is estimated before anything is allocated (`DoesNotFit`). A driver may still
refuse memory: other processes use the device, or it allocates when a kernel first uses an array.
"""

from functools import wraps
from math import prod

import numpy as np

from gpusim.domain.errors import OutOfMemory


def of_shape(shape, dtype=np.float32):
    """Return a request for an array: its description and its size [byte]."""
    size = "x".join(map(str, shape)) or "1"
    return f"an array of {size} {np.dtype(dtype)}", prod(shape) * np.dtype(dtype).itemsize


def of_values(values, *_):
    """Return a request for a copy of values, size 0 if other libraries do not report it."""
    return "a copy of an array", _nbytes([values])


def of_launch(stage, _kernel, _grid, *args, **_):
    """Return the request of a launch: the kernel and the size of its arguments [byte]."""
    return f"a kernel of {stage}", _nbytes(args)


def of_commands(commands):
    """Return the request of recorded launches and copies: that with the largest arguments [byte]."""
    nbytes, largest = max(((_nbytes(one.args), one) for one in commands), key=lambda pair: pair[0])
    return f"a kernel of {largest.stage}", nbytes


def _nbytes(arrays):
    return sum(getattr(array, "nbytes", None) or getattr(array, "capacity", 0) for array in arrays)


def refusable(request):
    """Decorate a device's method: raise OutOfMemory if the driver refuses memory.

    The device then frees memory that it keeps for reuse; the next request may fit.

    Args:
        request: Function from the method's arguments to the description of the request and its size
            [byte], 0 if unknown.

    Returns:
        The decorator.
    """

    def of_method(method):
        @wraps(method)
        def call(self, *args, **kwargs):
            try:
                return method(self, *args, **kwargs)
            except Exception as error:
                reason = self.refusal(error)
                if not reason:
                    raise
                self.give_back()
                raise OutOfMemory(
                    *request(*args, **kwargs), self.name, self.memory, reason
                ) from error

        return call

    return of_method
