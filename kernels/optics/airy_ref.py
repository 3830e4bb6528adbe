"""Pixel-integrated transfer function of a diffraction-limited lens, float64: O(s) = 2/pi (acos s - s sqrt(1 - s^2))."""

import numpy as np


def otf(s):
    """Transfer function of a circular pupil at s = (frequency) lambda N, 1 at s = 0 and 0 from s = 1 on.

    Source: Hopkins, Proc. R. Soc. A 231 (1955), in-focus case.
    """
    s = np.minimum(np.abs(s), 1.0)
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))


def airy(q, aperture, rows, cols):
    """Sum over the replicas that the sampling folds onto each frequency; all with 1/q within reach."""
    height, width = np.broadcast_to(aperture, 2)
    fy = np.arange(rows // 2 + 1)[:, None] / rows
    fx = np.arange(cols // 2 + 1) / cols
    tables = np.zeros((len(q), rows // 2 + 1, cols // 2 + 1))
    for table, one_q in zip(tables, np.asarray(q, np.float64), strict=True):
        reach = int(np.ceil(1 / one_q + 0.5))
        for a in range(-reach, reach + 1):
            for b in range(-reach, reach + 1):
                y, x = fy + a, fx + b
                table += otf(np.hypot(y, x) * one_q) * np.sinc(height * y) * np.sinc(width * x)
    return tables
