"""Devices by name."""

import functools
import threading
from collections.abc import Sequence
from typing import Any

from gpusim.backends.device import Device, refuse_fork
from gpusim.backends.driver import cl_devices
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.ending import finish_at_exit
from gpusim.domain.errors import DeviceError

_lock = threading.RLock()  # a device is opened once, also by several threads


def open_device(name: str = "auto") -> Device:
    """Open a device, once per process.

    Args:
        name: "numpy" (the float64 reference), "opencl" (the best one), "opencl:0" (by number),
            "opencl:nvidia" (by a part of its platform's or its own name), "opencl:0#2" (a second
            queue of that device), "warp:cpu", "warp:cuda:0", or "auto" (the best of all; see
            `gpusim devices`).

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
        device = _open(name)
    finish_at_exit()
    return device


Device.opened_by = open_device  # opens pickled devices


def open_devices(names: Device | str | Sequence[Device | str] = "auto") -> list[Device]:
    """Open devices that share the work: of one kind, because only these give the same bits.

    Args:
        names: A Device or a name for `open_device`; several of them in a list, or their names
            separated by commas; or "gpus": the best GPU and all of its make. An OpenCL name that
            is repeated opens another queue of the same device.

    Returns:
        The devices, in the order of their names.

    Raises:
        DeviceError: There is no such device, devices are of different kinds, or one is repeated.
    """
    if names == "gpus":
        return _gpus()
    given: Any = names.split(",") if isinstance(names, str) else names
    found: list[Device] = []
    for one in given if isinstance(given, list | tuple) else [given]:
        device = one if isinstance(one, Device) else _open_next(one, found)
        home = getattr(device, "wp_device", device)
        if any(home is getattr(other, "wp_device", other) for other in found):
            raise DeviceError(f"{device.name} twice: only OpenCL devices have several queues")
        found.append(device)
    if not found:
        raise DeviceError("no device: wanted at least one name")
    for other in found[1:]:
        _require_alike(found[0], other)
    return found


def _open_next(name, found):
    """Return a device by its name: for an OpenCL device in `found` another queue of it."""
    device = open_device(name.strip() if isinstance(name, str) else name)
    base, queue = device.name, 1
    while device.kind == "opencl" and device in found:
        queue += 1
        device = open_device(f"{base}#{queue}")
    return device


def _require_alike(first, other):
    """Raise DeviceError if two devices are of different kinds."""
    from gpusim.backends.probe import hardware_id

    kinds = hardware_id(first), hardware_id(other)
    if len({*kinds}) > 1:
        raise DeviceError(
            f"{first.name} and {other.name} are of different kinds, which give different bits: "
            f"{' and '.join(kinds)}"
        )


def _gpus():
    """Return the best GPU and all of its make; probe again if a cached one is gone."""
    from gpusim.backends.probe import gpus

    try:
        return [open_device(name) for name in gpus()]
    except DeviceError:
        return [open_device(name) for name in gpus(refresh=True)]


@functools.cache
def _open(name):
    if name == "gpus" or "," in name:
        raise DeviceError(f"{name}: several devices, wanted one, for example opencl:0")
    if name == "numpy":
        return Device()
    refuse_fork(name)
    if name in ("auto", "opencl", "warp"):
        return _best(name)
    backend, _, which = name.partition(":")
    if backend == "warp" and which:
        from gpusim.backends.warp import WarpDevice

        return WarpDevice(which, name)
    if backend == "opencl" and which:
        devices = cl_devices()
        which, mark, queue = which.partition("#")
        if mark and not (queue.isdecimal() and int(queue) > 1 and which):
            raise DeviceError(f"{name}: wanted the number of another queue, for example opencl:0#2")
        for number, device in enumerate(devices):
            if which == str(number):
                return OpenCLDevice(device, f"opencl:{number}{mark}{queue}")
        for number, device in enumerate(devices):
            if (
                which.lower()
                in f"{device.platform.name} {device.platform.version} {device.name}".lower()
            ):
                return OpenCLDevice(device, f"opencl:{number}{mark}{queue}")
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
