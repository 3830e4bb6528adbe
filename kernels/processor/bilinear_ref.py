"""Bilinear demosaicking, float64: every colour is the mean of its nearest samples.

It is the normalised convolution of each colour's samples with the tent (1 2 1)' (1 2 1) / 4 (red,
blue) and the cross (0 1 0; 1 4 1; 0 1 0) / 4 (green): Losson, Macaire and Yang 2010, Advances in
Imaging and Electron Physics 162, section 3.
"""

import numpy as np

TENT = np.outer([1, 2, 1], [1, 2, 1]) / 4
CROSS = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4


def bilinear(raw, *, phase, black_level, scale):
    """Return the stage's result, see `bilinear.py`."""
    rows, cols = raw.shape
    padded = np.pad(np.asarray(raw, np.float64), 1, mode="reflect")
    parity = (np.arange(-1, rows + 1) % 2)[:, None] * 2 + np.arange(-1, cols + 1) % 2
    planes = []
    for color, kernel in zip("RGB", (TENT, CROSS, TENT), strict=True):
        sampled = np.isin(parity, [place for place, letter in enumerate(phase) if letter == color])
        samples = np.where(sampled, padded, 0.0)
        planes.append(
            sum(
                kernel[dy, dx] * samples[dy : dy + rows, dx : dx + cols]
                for dy in range(3)
                for dx in range(3)
            )
        )
    return (np.stack(planes) - black_level) * scale
