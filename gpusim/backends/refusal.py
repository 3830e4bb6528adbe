"""Memory that a driver refuses after a frame was planned: one line that says for what, and what to do.

What a frame needs is estimated before anything is allocated (`DoesNotFit`). A driver may refuse it all the same: other
processes use the device, or it allocates when a kernel first uses an array.
"""

from functools import wraps
from math import prod

import numpy as np

from gpusim.domain.errors import OutOfMemory


def of_shape(shape, dtype=np.float32):
    """A request for an array: what it is, and its size [byte]."""
    size = "x".join(map(str, shape)) or "1"
    return f"an array of {size} {np.dtype(dtype)}", prod(shape) * np.dtype(dtype).itemsize


def of_values(values, *_):
    """A request that has these values; those of other libraries may not say how large they are."""
    return "a copy of an array", _nbytes([values])


def of_launch(stage, _kernel, _grid, *args, **_):
    """A launch of a kernel with its arguments."""
    return f"a kernel of {stage}", _nbytes(args)


def of_command(command):
    """A launch, or a copy, that was noted."""
    return f"a kernel of {command.stage}", _nbytes(command.args)


def _nbytes(arrays):
    return sum(getattr(array, "nbytes", None) or getattr(array, "capacity", 0) for array in arrays)


def refusable(request):
    """Decorator of a device's method: memory that its driver refuses there raises OutOfMemory.

    request: function of the method's arguments to what is asked for, in words, and its size [byte], 0: not known.
    What the device keeps for reuse is given back then, so that less may be asked for next.
    """

    def of_method(method):
        @wraps(method)
        def asked(self, *args, **kwargs):
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

        return asked

    return of_method
