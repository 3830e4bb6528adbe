"""OpenBLAS on one core: its other threads spin for 40 to 70 ms after each product, and take cores from a device.

A plan takes few and small products and eigenvectors, apart in time. On 2 cores its threads cost more
than they bring: eigenvectors of 31 x 31 take 0.3 ms on one core and 68 ms of processor time on two.
Pools of threads share the large work.
"""

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock

# of wheels of NumPy, of SciPy, and of systems, by the width of integers
NAMES = [
    f"{prefix}openblas_{{}}_num_threads{suffix}"
    for prefix in ("scipy_", "")
    for suffix in ("64_", "")
]
_lock = Lock()
_users = 0  # contexts that are open, of all threads
_before: list[tuple[Callable, int]] = []  # threads of each library before the first of them


@contextmanager
def one_core() -> Iterator[None]:
    """Let OpenBLAS start no threads, in the whole process, until the last of these contexts ends.

    Products of other threads run on one core meanwhile, too. Other implementations of BLAS, and
    OpenBLAS where it is not found, stay as they are.
    """
    global _users
    with _lock:
        _users += 1
        if _users == 1:
            _before[:] = [(write, read()) for write, read in _libraries()]
            for write, _ in _before:
                write(1)
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                for write, count in _before:
                    write(count)


def _libraries() -> list[tuple[Callable, Callable]]:
    """Functions that set and get the number of threads, of the libraries that NumPy and SciPy are linked with.

    SciPy's is left out while nothing has imported `scipy.linalg`: it has no threads yet.
    """
    found = {}
    for module in ("numpy.linalg._umath_linalg", "scipy.linalg._fblas"):
        if module in sys.modules:
            found.update(_functions_of(str(sys.modules[module].__file__)))
    return list(found.values())


@cache
def _functions_of(path):
    """Return the same functions of one library by their addresses. path: of a module that is linked with it."""
    try:  # symbols of the module, and of libraries it needs
        library = ctypes.CDLL(path)
    except OSError:
        return {}
    found = {}
    for name in NAMES:
        write, read = (getattr(library, name.format(word), None) for word in ("set", "get"))
        if write and read:
            write.argtypes, write.restype = [ctypes.c_int], None
            found[ctypes.cast(write, ctypes.c_void_p).value] = write, read
    return found
