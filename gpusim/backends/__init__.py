"""Devices: where kernels run. `open_device("auto" | "numpy" | "opencl[:which]" | "warp:cpu" | "warp:cuda:0")`."""

from gpusim.backends.device import Device
from gpusim.backends.select import open_device

__all__ = ["Device", "open_device"]
