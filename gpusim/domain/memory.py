"""Arrays in host memory and of other libraries, and the check that a request for memory fits.

Protocols: DLPack (https://dmlc.github.io/dlpack, the Python specification), the CUDA array
interface (Numba manual, version 3), and NumPy's `__array__` and `__array_interface__`.
"""

import os
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadData, DoesNotFit, TooLarge

_LIMIT: ContextVar[int | None] = ContextVar("gpusim_memory_limit", default=None)


class Pinned(np.ndarray):
    """An array in host memory that a device reads at the full rate of its bus: see `Device.pinned`.

    Scenes do not check its values, because a video changes them later. The device finds wrong
    values when it computes the frame, or the next one.
    """


def host_memory() -> int:
    """Return the available memory [byte]: MemAvailable on Linux, elsewhere all physical memory."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError):  # no sysconf on Windows: the allocation itself will fail
        return 2**63


@contextmanager
def limit_memory(nbytes: int):
    """Lower the limit of `require_memory` in this thread, for files from other machines.

    nbytes: Most memory that one request may need [byte].
    """
    token = _LIMIT.set(nbytes)
    try:
        yield
    finally:
        _LIMIT.reset(token)


def require_memory(what: str, needed: int):
    """Raise DoesNotFit if `needed` [byte] exceeds the available memory.

    Raise TooLarge if it exceeds the limit of `limit_memory`.
    """
    limit = _LIMIT.get()
    if limit is not None and needed > limit:
        raise TooLarge(what, min(needed, 2**63), limit)
    available = host_memory()
    if needed > available:
        raise DoesNotFit(what, min(needed, 2**63), available, "this computer")


# Kinds of memory by DLPack: host memory, pinned for CUDA or ROCm, managed by CUDA.
READ_BY_HOST = (1, 3, 11, 13)
CPU, CUDA = (1, 0), (2, 13)  # host memory as a DLPack device; kinds that CUDA reads
NUMPYS = ("__array__", "__array_interface__", "__array_struct__")


class Described:
    """An array in CUDA memory that has only the CUDA array interface, with `shape` and `dtype`.

    Args:
        source: The array. It is kept alive because it owns the memory.
    """

    def __init__(self, source):
        self.source = source  # owns the memory
        self.__cuda_array_interface__ = source.__cuda_array_interface__
        self.shape = tuple(self.__cuda_array_interface__["shape"])
        self.dtype = np.dtype(self.__cuda_array_interface__["typestr"])


def describe_array(values, what: str):
    """Return an array with `shape` and `dtype`: the value itself, or a view of its memory.

    Args:
        values: An array of any library.
        what: Name of the array in messages.

    Returns:
        An array with `shape` and `dtype`.

    Raises:
        BadData: The value is no array.
    """
    if hasattr(values, "shape") and hasattr(values, "dtype"):
        return values
    if hasattr(values, "__cuda_array_interface__"):
        return Described(values)
    if hasattr(values, "__dlpack_device__") or any(hasattr(values, name) for name in NUMPYS):
        return to_host(values, what)
    raise BadData(
        f"{what}: {name_of(values)}, wanted an array: NumPy's, a device's, or one with __dlpack__, "
        "__cuda_array_interface__ or __array__"
    )


def is_array(values) -> bool:
    """Return True for an array of NumPy or of another library."""
    return hasattr(values, "dtype") or any(
        hasattr(values, name) for name in ("__cuda_array_interface__", "__dlpack_device__", *NUMPYS)
    )


def type_of(values) -> np.dtype | None:
    """Return the NumPy type of an array's values, or None if NumPy has no type of that name."""
    kind = values.dtype
    if isinstance(kind, np.dtype):
        return kind
    try:
        # torch.float32, say
        return np.dtype(getattr(kind, "__name__", None) or str(kind).rpartition(".")[2])
    except TypeError:
        return None


def name_of(values) -> str:
    """Return the library and class of an array, for messages."""
    return f"{type(values).__module__.partition('.')[0]}.{type(values).__name__}"


def dlpack_kind(values) -> int | None:
    """Return DLPack's kind of memory of an array, or None without a usable DLPack protocol."""
    if not hasattr(values, "__dlpack__"):
        return None
    try:
        return int(values.__dlpack_device__()[0])
    except Exception:  # any library, any cause; the array may have another protocol
        return None


def to_host(values, reader: str) -> np.ndarray:
    """Return values in host memory, a view if they are there, otherwise a copy.

    Values that are no array go through `np.asarray`.

    Args:
        values: Array of any library, or numbers.
        reader: Name of the caller for messages.

    Returns:
        A NumPy array.

    Raises:
        BadData: The memory cannot be read.
    """
    if isinstance(values, np.ndarray):
        return values
    kind, cause = dlpack_kind(values), None
    if kind is not None:
        try:
            return (
                np.from_dlpack(values)
                if kind in READ_BY_HOST
                else np.from_dlpack(values, device="cpu")
            )
        # the class depends on the library: a tensor with a gradient, no copies by DLPack
        except Exception as error:
            cause = error
    protocols = kind is not None or hasattr(values, "__cuda_array_interface__")
    if not protocols or any(hasattr(values, name) for name in NUMPYS):
        try:
            return np.asarray(values)
        except (TypeError, BufferError, RuntimeError) as error:
            if not protocols:
                raise
            cause = cause if kind in READ_BY_HOST else error
    why = "" if cause is None else f" ({str(cause).partition(chr(10))[0][:150]})"
    raise BadData(
        f"{reader}: cannot read an array of {name_of(values)}{why}: give a copy in host memory, such as "
        "x.detach().cpu(), x.get() or x.numpy(), or for CUDA memory use device warp:cuda:0"
    )
