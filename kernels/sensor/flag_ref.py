"""Dead or hot pixels, for each block of pixels that become one."""

import numpy as np

from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.sensor.flag import check_planes


def flag(response=None, dark=None, *, least=0.0, binning=(1, 1), stride=(1, 1)):
    """Return the stage's result, see `flag.py`."""
    shape = check_planes(response, dark, least)
    bad = np.zeros(shape, bool)
    if response is not None:
        bad |= np.asarray(response, np.float32) == 0
    if dark is not None:
        bad |= np.asarray(dark, np.float32) > np.float32(least)
    rows, cols = binned_shape(shape, binning, stride)
    (by, bx), (sy, sx) = binning, stride
    blocks = bad[: rows * by, : cols * bx].reshape(rows // sy, by, sy, cols // sx, bx, sx)
    return np.where(blocks.any(axis=(1, 4)).reshape(rows, cols), 255, 0).astype(np.uint8)
