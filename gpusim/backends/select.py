"""Devices by name."""

import functools
import threading

from gpusim.backends.device import Device, refuse_fork
from gpusim.backends.driver import cl_devices
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.warp import WarpDevice
from gpusim.domain.errors import DeviceError

_lock = threading.RLock()  # a device is opened once, also by several threads


def open_device(name: str = "auto") -> Device:
    """Open a device, once per process.

    Args:
        name: "numpy" (the float64 reference), "opencl" (the best one), "opencl:0" (by number),
            "opencl:nvidia" (by a part of its platform's or its own name), "warp:cpu",
            "warp:cuda:0", or "auto" (the best of all; see `gpusim devices`).

    Returns:
        The device.

    Raises:
        DeviceError: There is no such device; the message lists the devices.
    """
    if not isinstance(name, str):
        raise DeviceError(
            f'device: {type(name).__name__}, wanted a name, for example "auto" or "opencl:0"'
        )
    with _lock:
        return _open(name)


Device.opened_by = open_device  # opens pickled devices


@functools.cache
def _open(name):
    if name == "numpy":
        return Device()
    refuse_fork(name)
    if name in ("auto", "opencl", "warp"):
        return _best(name)
    backend, _, which = name.partition(":")
    if backend == "warp" and which:
        return WarpDevice(which, name)
    if backend == "opencl" and which:
        devices = cl_devices()
        for number, device in enumerate(devices):
            if which == str(number):
                return OpenCLDevice(device, f"opencl:{number}")
        for number, device in enumerate(devices):
            if (
                which.lower()
                in f"{device.platform.name} {device.platform.version} {device.name}".lower()
            ):
                return OpenCLDevice(device, f"opencl:{number}")
        listed = "; ".join(
            f"opencl:{n} = {d.name.strip()} ({d.platform.name})" for n, d in enumerate(devices)
        )
        raise DeviceError(
            f"no OpenCL device {which!r}; there is: {listed or 'none (pip install pyopencl[pocl])'}"
        )
    raise DeviceError(
        f"unknown device {name!r}: use auto, opencl, opencl:N, opencl:NAME, warp:cpu, warp:cuda:N, numpy"
    )


def _best(backend):
    """Return the preferred device; probe again if the cached one is gone or has changed."""
    from gpusim.backends.probe import best, identity

    entry = best(backend)
    try:
        device = open_device(entry["name"])
        if identity(device).items() <= entry.items():
            return device
    except DeviceError:
        pass
    return open_device(best(backend, refresh=True)["name"])
