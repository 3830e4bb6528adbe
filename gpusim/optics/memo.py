"""Results of functions that are kept in memory, up to a number of bytes; products of matrices in threads of a pool."""

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from math import ceil
from threading import Lock
from typing import Any

import numpy as np

from gpusim.optics.otf import UNTHREADED

NARROWEST = 64  # columns of a piece, at least
LONGEST = 256  # terms of a sum in one piece: pieces are at least 32 x 32 then


def remember(most: int) -> Callable:
    """Return a decorator that keeps results of a function, up to `most` bytes of arrays, the last used ones.

    The function depends on nothing but its arguments, which are hashable. It returns an array or a tuple with arrays,
    which are made read-only.
    """

    def decorate(function):
        known: OrderedDict = OrderedDict()
        lock, held = Lock(), [0]

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


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, in pieces for which OpenBLAS starts no threads: these would compete with a pool's.

    For complex numbers it starts threads even for small products: they are products of real parts.
    """
    (rows, length), cols = a.shape, b.shape[1]
    if np.iscomplexobj(a) or np.iscomplexobj(b):
        every = multiply(_parts(a, 0), _parts(b, 1))
        real, imaginary = every[:rows, :cols], np.zeros((rows, cols), every.dtype)
        if np.iscomplexobj(a):
            imaginary = every[rows:, :cols]
        if np.iscomplexobj(b):
            imaginary = imaginary + every[:rows, cols:]
            real = real - every[rows:, cols:] if np.iscomplexobj(a) else real
        found = np.empty((rows, cols), np.result_type(a, b))
        found.real, found.imag = real, imaginary
        return found
    if rows * length * cols <= UNTHREADED:
        return a @ b
    terms = ceil(length / ceil(length / LONGEST))
    side = int((UNTHREADED / terms) ** 0.5)
    out = np.empty((rows, cols), np.result_type(a, b))
    for i in range(0, rows, side):
        for j in range(0, cols, side):
            piece, left, right = (
                out[i : i + side, j : j + side],
                a[i : i + side],
                b[:, j : j + side],
            )
            np.matmul(left[:, :terms], right[:terms], out=piece)
            for k in range(terms, length, terms):
                piece += left[:, k : k + terms] @ right[k : k + terms]
    return out


def multiply_wide(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Write a @ b, of many columns, to `out`: like `multiply`, but NumPy walks over the pieces."""
    step = UNTHREADED // (NARROWEST * a.shape[1])
    if not step:
        out[:] = multiply(a, b)
        return
    for first in range(0, len(a), step):
        left, to = a[first : first + step], out[first : first + step]
        side = UNTHREADED // left.size
        whole = b.shape[1] // side * side
        pieces, results = (
            values[:, :whole].reshape(len(values), -1, side).transpose(1, 0, 2)
            for values in (b, to)
        )
        np.matmul(left, pieces, out=results)
        np.matmul(left, b[:, whole:], out=to[:, whole:])


def _parts(values, axis):
    """Real and imaginary parts along an axis, one after the other; of real numbers these."""
    if not np.iscomplexobj(values):
        return values
    return np.concatenate([values.real, values.imag], axis=axis)
