"""Memory that a preview gives back after its pages have gone."""

import ctypes
import gc
import sys

from gpusim.backends import Device
from gpusim.optics.memo import forget_results


def free_memory(device: Device, is_idle: bool) -> None:
    """Free memory that is only kept for reuse.

    Args:
        device: Device of the preview.
        is_idle: Whether no page is open: tables of lenses are then forgotten, too.
    """
    gc.collect()  # loops and their values refer to one another
    device.sync()
    device.give_back()
    if is_idle:
        forget_results()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc; others have none
        if trim is not None:
            trim(0)
