"""Planes as pixels, whose channels are next to each other in memory, as files have them."""

from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import warp_only


def put_channels_last(device: Device, planes: Any) -> Any:
    """Return a copy of planes with the channels as the last axis.

    Args:
        device: The device.
        planes: Planes, shape (channels, rows, cols), float32.

    Returns:
        Pixels, shape (rows, cols, channels), float32 of the device, C-contiguous.
    """
    if device.kind == "numpy":
        return np.ascontiguousarray(np.moveaxis(planes, 0, -1))
    channels, *shape = planes.shape
    count = prod(shape)
    pixels = device.empty((count, channels))
    device.launch(
        "common.channels",
        "put_last",
        (count,),
        *(device.reshape(planes, (channels, count)), pixels),
        *(count, *warp_only(device, channels)),
        defines={"CHANNELS": channels},
    )
    return device.reshape(pixels, (*shape, channels))
