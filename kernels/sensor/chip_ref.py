"""expected = max(min(scale mean, 1e30) response, 0) + dark_time dark, in float32: see `noise_ref` for why."""

import numpy as np

MOST = np.float32(1e30)  # stands for infinity, so that no inf 0 arises


def chip(mean, response=None, dark=None, *, scale=1.0, dark_time=0.0):
    """See the contract."""
    mean = np.float32(scale) * np.asarray(mean, np.float32)
    expected = np.where(mean > MOST, MOST, mean)
    if response is not None:
        expected = expected * np.asarray(response, np.float32)
    expected = np.where(expected < 0, np.float32(0), expected)
    if dark is not None:
        with np.errstate(over="ignore"):  # more than any well holds
            expected = expected + np.float32(dark_time) * np.asarray(dark, np.float32)
    return expected
