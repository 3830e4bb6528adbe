"""Devices, on which kernels run: `open_device("auto")` and other names open one, `open_devices("gpus")` several."""

from gpusim.backends.device import Device
from gpusim.backends.select import open_device, open_devices

__all__ = ["Device", "open_device", "open_devices"]
