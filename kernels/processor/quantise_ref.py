"""Whole numbers from raw values; float32 in a fixed order: the bits are part of the contract."""

import numpy as np

from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE
from gpusim.kernels.processor.quantise import LIGHT, check


def quantise(raw, *, black_level, scale):
    """Return the stage's result, see `quantise.py`."""
    check(raw, black_level, scale)
    with np.errstate(over="ignore", invalid="ignore"):
        light = (np.asarray(raw, np.float32) - np.float32(black_level)) * np.float32(scale)
        numbers = light / np.float32(LIGHT) + np.float32(CORRECTED_BLACK)
    return np.rint(np.clip(np.nan_to_num(numbers, nan=0.0), 0, CORRECTED_WHITE)).astype(np.uint16)
