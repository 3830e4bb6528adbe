"""Photodiodes one after the other: each takes its share, as long as light is left, and the last takes the rest."""

import numpy as np


def divide(whole, parts, shares):
    """Return the stage's result, see `divide.py`."""
    left, diodes = np.asarray(whole, np.float64), []
    for part, share in zip(parts, shares, strict=True):
        repeats = [-(-n // m) for n, m in zip(part.shape, share.shape, strict=True)]
        wanted = np.tile(share, repeats)[: part.shape[0], : part.shape[1]] * np.float64(part)
        diodes.append(np.clip(wanted, 0, left))
        left = left - diodes[-1]
    return np.array([*diodes, left])
