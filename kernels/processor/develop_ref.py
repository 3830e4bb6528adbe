"""One stage after the other, float64: the definition of what `develop` does at once."""

import numpy as np

from gpusim.kernels.display.encode_ref import encode
from gpusim.kernels.processor.bilinear_ref import bilinear
from gpusim.kernels.processor.color_ref import color


def develop(raw, matrix, thresholds, *, phase, black_level, scale, ceiling=None, converter=None):
    """Raw (rows, cols) [DN] or, with a converter, [e-] -> codes (rows, cols, 3)."""
    if converter is not None:
        raw = digitised(raw, *converter)
    camera = bilinear(raw, phase=phase, black_level=black_level, scale=scale)
    return encode(color(camera, matrix, ceiling=ceiling), thresholds)


def digitised(electrons, gain, offset, most):
    """Digital numbers, NaN as 0. In float32: a converter's steps are where its own arithmetic puts them."""
    level = np.float32(gain) * np.asarray(electrons, np.float32) + np.float32(offset)
    return np.rint(np.clip(np.nan_to_num(level, nan=0.0), 0, np.float32(most)))
