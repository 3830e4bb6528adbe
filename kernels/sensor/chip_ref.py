"""expected = max(min(scale mean, 1e30) response, 0) + dark_time dark, float32 as in `noise_ref`."""

import numpy as np

MOST = np.float32(1e30)  # in place of infinity: avoids inf x 0


def chip(mean, response=None, dark=None, *, scale=1.0, dark_time=0.0):
    """Return the stage's result, see `chip.py`."""
    mean = np.float32(scale) * np.asarray(mean, np.float32)
    expected = np.where(mean > MOST, MOST, mean)
    if response is not None:
        expected = expected * np.asarray(response, np.float32)
    expected = np.where(expected < 0, np.float32(0), expected)
    if dark is not None:
        with np.errstate(over="ignore"):  # more than any well holds
            expected = expected + np.float32(dark_time) * np.asarray(dark, np.float32)
    return expected
