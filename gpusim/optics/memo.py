"""Results of functions that are kept in memory, up to a number of bytes; products of matrices in threads of a pool."""

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from threading import Lock
from typing import Any

import numpy as np

from gpusim.optics.blas import one_core

_FORGET: list[Callable[[], None]] = []  # of each remembered function


def forget_results() -> None:
    """Forget the results of all functions that `remember` decorates."""
    for forget in _FORGET:
        forget()


def remember(most: int) -> Callable:
    """Return a decorator that keeps results of a function, up to `most` bytes of arrays, the last used ones.

    The function depends on nothing but its arguments, which are hashable. It returns an array or a tuple with arrays,
    which are made read-only.
    """

    def decorate(function):
        known: OrderedDict = OrderedDict()
        lock, held = Lock(), [0]

        def forget():
            with lock:
                known.clear()
                held[0] = 0

        _FORGET.append(forget)

        @wraps(function)
        def remembered(*args) -> Any:
            with lock:
                if args in known:
                    known.move_to_end(args)
                    return known[args]
            value = function(*args)
            for array in _arrays(value):
                array.flags.writeable = False
            with lock:
                if args not in known:
                    known[args] = value
                    held[0] += _bytes(value)
                while held[0] > most and len(known) > 1:
                    held[0] -= _bytes(known.popitem(last=False)[1])
            return value

        return remembered

    return decorate


def _arrays(value):
    return [
        one for one in (value if isinstance(value, tuple) else (value,)) if hasattr(one, "flags")
    ]


def _bytes(value):
    return sum(array.nbytes for array in _arrays(value))


def multiply(a: np.ndarray, b: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Return a @ b, in `out` if it is given, on one core: OpenBLAS's threads would compete with a pool's."""
    with one_core():
        return np.matmul(a, b, out=out)
