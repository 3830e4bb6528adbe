"""Sums of pixels of one colour, float32 in a fixed order: the bits are part of the contract."""

import numpy as np

from gpusim.kernels.sensor.bin import binned_shape, check_pixels


def bin(pixels, *, binning, stride=(1, 1), average=False):
    """Return the stage's result, see `bin.py`."""
    digital = check_pixels(pixels, average)
    (by, bx), (sy, sx) = binning, stride
    rows, cols = binned_shape(np.shape(pixels), binning, stride)
    whole = np.asarray(pixels)[: rows * by, : cols * bx].astype(np.int64 if digital else np.float32)
    blocks = whole.reshape(rows // sy, by, sy, cols // sx, bx, sx)
    columns = sum((blocks[:, j] for j in range(1, by)), start=blocks[:, 0])
    total = sum((columns[:, :, :, i] for i in range(1, bx)), start=columns[:, :, :, 0]).reshape(
        rows, cols
    )
    if not digital:
        return total
    return (np.rint(total / (by * bx)) if average else np.minimum(total, 65535)).astype(np.uint16)
