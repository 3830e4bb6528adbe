"""Devices, on which kernels run: `open_device("auto")` and other names opens one."""

from gpusim.backends.device import Device
from gpusim.backends.select import open_device

__all__ = ["Device", "open_device"]
