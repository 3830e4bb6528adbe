"""OpenCL's driver: how it is loaded, its devices, and how it ends."""

import os
import sys
import time
from contextlib import suppress

from gpusim.backends.caches import prepare_opencl
from gpusim.domain.errors import DeviceError

LAST = 60  # [s] that the end of a process waits for a thread that launches something


def pyopencl():
    """Return the package with PoCL's cache prepared. Raise DeviceError if it is missing."""
    if "pyopencl" not in sys.modules:
        prepare_opencl()
        _import_apart()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(
            f"OpenCL devices need pyopencl ({error}); pip install 'pyopencl[pocl]'"
        ) from error
    return pyopencl


class _Forgetful(dict):
    """pyopencl's record of how arguments are set, for this process only.

    pyopencl's file of it saves less than 1 ms a kernel. The file is code in a data base, opened on
    import; damage there ends in an error or in other code.
    """

    def store_if_not_present(self, key, value):
        self.setdefault(key, value)


def _import_apart():
    """Import pyopencl without its file of code; its cache of programs stays in use."""
    before = os.environ.get("PYOPENCL_NO_CACHE")
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    try:
        import pyopencl
        import pyopencl.invoker as invoker
    except ImportError:  # the caller reports it
        return
    finally:
        del os.environ["PYOPENCL_NO_CACHE"]
        if before is not None:
            os.environ["PYOPENCL_NO_CACHE"] = before
    if before is None and hasattr(pyopencl, "_PYOPENCL_NO_CACHE"):
        pyopencl._PYOPENCL_NO_CACHE = False
        invoker.invoker_cache = _Forgetful()


def cl_devices() -> list:
    """Return every OpenCL device of every platform, in the ICD loader's order."""
    cl = pyopencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # no platform at all is an error code, not an empty list
        return []
    found = []
    for platform in platforms:
        try:
            found += platform.get_devices()
        except cl.Error:  # a platform without devices
            continue
    return found


def is_gpu(cl_device) -> bool:
    """Return whether a device is a GPU; oclgrind, on the processor, says that it is of every type."""
    types = pyopencl().device_type
    return cl_device.type & (types.GPU | types.CPU) == types.GPU


def finish(lock, queues, waits: list, process: int):
    """Wait for all launches and let no other thread launch more: a device or the process ends.

    waits: threads in the driver. Python would end them on their return, which C++ does not survive.
    process: owner of the queues; queues of a forked process do not work.
    """
    if os.getpid() != process:
        return
    stop = time.monotonic() + LAST
    lock.acquire(timeout=LAST)  # for good; a thread that hangs in its driver keeps it
    for queue in filter(None, queues):
        with suppress(Exception):  # of a driver that has failed: there is no work left
            queue.finish()
    while waits and time.monotonic() < stop:
        time.sleep(1e-3)
