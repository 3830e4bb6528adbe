"""From a device's name to the device."""

import functools

from gpusim.backends.device import Device
from gpusim.backends.opencl import OpenCLDevice, cl_devices
from gpusim.backends.warp import WarpDevice
from gpusim.domain.errors import DeviceError


@functools.cache
def open_device(name: str = "auto") -> Device:
    """Open a device once per process.

    name: "numpy" (the float64 reference), "opencl" (the best one), "opencl:0" (by number), "opencl:nvidia" (by a part
    of its platform's or its own name), "warp:cpu", "warp:cuda:0", or "auto" (the best of all; see `gpusim devices`).
    Raises DeviceError that lists what there is.
    """
    if name == "numpy":
        return Device()
    if name in ("auto", "opencl", "warp"):
        from gpusim.backends.probe import best

        return open_device(best(name))
    backend, _, which = name.partition(":")
    if backend == "warp" and which:
        return WarpDevice(which, name)
    if backend == "opencl" and which:
        devices = cl_devices()
        for number, device in enumerate(devices):
            if which == str(number):
                return OpenCLDevice(device, f"opencl:{number}")
        for number, device in enumerate(devices):
            if which.lower() in f"{device.platform.name} {device.platform.version} {device.name}".lower():
                return OpenCLDevice(device, f"opencl:{number}")
        listed = "; ".join(f"opencl:{n} = {d.name.strip()} ({d.platform.name})" for n, d in enumerate(devices))
        raise DeviceError(f"no OpenCL device {which!r}; there is: {listed or 'none (pip install pyopencl[pocl])'}")
    raise DeviceError(f"unknown device {name!r}: use auto, opencl, opencl:N, opencl:NAME, warp:cpu, warp:cuda:N, numpy")
