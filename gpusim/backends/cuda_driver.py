"""Functions of CUDA's driver that Warp does not offer, or offers at more cost.

https://docs.nvidia.com/cuda/cuda-driver-api/
"""

import ctypes
import functools
import os
from typing import Any

from gpusim.domain.errors import DeviceError

OWNER = 9  # CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL
POINTER, COUNT = ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)
FUNCTIONS = {
    "cuPointerGetAttribute": (POINTER, ctypes.c_int, ctypes.c_uint64),
    "cuMemcpyDtoHAsync_v2": (POINTER, ctypes.c_uint64, ctypes.c_size_t, POINTER),
    "cuEventSynchronize": (POINTER,),
    "cuGraphGetRootNodes": (POINTER, ctypes.POINTER(POINTER), COUNT),
    "cuGraphNodeGetDependentNodes": (POINTER, ctypes.POINTER(POINTER), COUNT),
    "cuGraphKernelNodeGetParams_v2": (POINTER, POINTER),
    "cuGraphExecKernelNodeSetParams_v2": (POINTER, POINTER, POINTER),
}


@functools.cache
def cuda_driver() -> Any:
    """Return the driver's library; None if there is none, or one older than CUDA 12."""
    try:
        driver = ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
        for name, kinds in FUNCTIONS.items():
            getattr(driver, name).argtypes = kinds
    except (OSError, AttributeError):
        return None
    return driver


def call_driver(name: str, *args: Any) -> None:
    """Call a function of the driver. Raises DeviceError with its number of the error."""
    code = getattr(cuda_driver(), name)(*args)
    if code:
        raise DeviceError(f"CUDA's driver refused {name}: error {code}")


def ordinal_of(address: int) -> int | None:
    """Return the number of the CUDA device of this memory; None if it is unknown."""
    driver, number = cuda_driver(), ctypes.c_int(-1)
    if driver is None or driver.cuPointerGetAttribute(ctypes.byref(number), OWNER, address):
        return None
    return number.value
