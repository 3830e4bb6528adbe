"""The stages one after the other, float64: the definition of `develop`."""

import numpy as np

from gpusim.kernels.display.encode_ref import encode
from gpusim.kernels.processor.bilinear_ref import bilinear
from gpusim.kernels.processor.color_ref import color


def develop(raw, matrix, thresholds, *, phase, black_level, scale, ceiling=None, converter=None):
    """Return the stage's result, see `develop.py`."""
    if converter is not None:
        raw = digitise(raw, *converter)
    camera = bilinear(raw, phase=phase, black_level=black_level, scale=scale)
    return encode(color(camera, matrix, ceiling=ceiling), thresholds)


def digitise(electrons, gain, offset, most):
    """Return digital numbers, 0 for NaN, in float32: steps depend on the arithmetic."""
    level = np.float32(gain) * np.asarray(electrons, np.float32) + np.float32(offset)
    return np.rint(np.clip(np.nan_to_num(level, nan=0.0), 0, np.float32(most)))
