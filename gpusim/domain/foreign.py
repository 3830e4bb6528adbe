"""Arrays of other libraries: what they say of themselves, and how the host reads them.

Protocols: DLPack (https://dmlc.github.io/dlpack, the Python specification), the CUDA array interface (Numba's manual,
version 3), and NumPy's own `__array__` and `__array_interface__`.
"""

import numpy as np

from gpusim.domain.errors import BadData

READ_BY_HOST = (
    1,
    3,
    11,
    13,
)  # DLPack's kinds of memory: the host's own, pinned for CUDA or ROCm, managed by CUDA
CPU, CUDA = (1, 0), (2, 13)  # the host's own as a DLPack device; kinds that CUDA reads
NUMPYS = ("__array__", "__array_interface__", "__array_struct__")


class Described:
    """An array in CUDA memory that says its shape and type by the CUDA array interface alone."""

    def __init__(self, source):
        self.source = source  # its memory must live as long
        self.__cuda_array_interface__ = source.__cuda_array_interface__
        self.shape = tuple(self.__cuda_array_interface__["shape"])
        self.dtype = np.dtype(self.__cuda_array_interface__["typestr"])


def described(values, what: str):
    """The array itself where it has `shape` and `dtype`; else what has them, of the same memory. Raises BadData."""
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
    """Whether a value is an array of NumPy or of another library."""
    return hasattr(values, "dtype") or any(
        hasattr(values, name) for name in ("__cuda_array_interface__", "__dlpack_device__", *NUMPYS)
    )


def type_of(values) -> np.dtype | None:
    """Type of an array's values; None where NumPy has none of that name."""
    kind = values.dtype
    if isinstance(kind, np.dtype):
        return kind
    try:
        return np.dtype(
            getattr(kind, "__name__", None) or str(kind).rpartition(".")[2]
        )  # torch.float32, say
    except TypeError:
        return None


def name_of(values) -> str:
    """What an array is called in messages."""
    return f"{type(values).__module__.partition('.')[0]}.{type(values).__name__}"


def dlpack_kind(values) -> int | None:
    """DLPack's kind of the memory that an array is in; None where it says nothing, or not by DLPack."""
    if not hasattr(values, "__dlpack__"):
        return None
    try:
        return int(values.__dlpack_device__()[0])
    except Exception:  # by any library for any cause; the array may have another protocol
        return None


def to_host(values, reader: str) -> np.ndarray:
    """Values in host memory: a view where they are there, else a copy. What is no array NumPy makes one of.

    reader: who asks, for messages. Raises BadData for memory that cannot be read.
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
        except (
            Exception
        ) as error:  # of any class by library: a tensor with a gradient, no copies by DLPack
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
