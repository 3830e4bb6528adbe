"""Gradient-corrected linear demosaicking, float64.

Four 5 x 5 filters (and the transpose of one): Malvar, He and Cutler 2004, ICASSP III-485, figure 2.
Each is a mean of the wanted colour's neighbours plus a gain (1/2, 5/8 or 3/4) times the Laplacian
of the pixel's own colour.
"""

import numpy as np

GREEN = (
    np.array(
        [
            [0, 0, -1, 0, 0],  # at red and blue
            [0, 0, 2, 0, 0],
            [-1, 2, 4, 2, -1],
            [0, 0, 2, 0, 0],
            [0, 0, -1, 0, 0],
        ]
    )
    / 8
)
BESIDE = (
    np.array(
        [
            [0, 0, 0.5, 0, 0],  # at green: the colour left and right of it
            [0, -1, 0, -1, 0],
            [-1, 4, 5, 4, -1],
            [0, -1, 0, -1, 0],
            [0, 0, 0.5, 0, 0],
        ]
    )
    / 8
)
ACROSS = (
    np.array(
        [
            [0, 0, -1.5, 0, 0],  # red at blue, blue at red
            [0, 2, 0, 2, 0],
            [-1.5, 0, 6, 0, -1.5],
            [0, 2, 0, 2, 0],
            [0, 0, -1.5, 0, 0],
        ]
    )
    / 8
)
KEEP = np.zeros((5, 5))
KEEP[2, 2] = 1


def malvar(raw, *, phase, black_level, scale, balance=(1.0, 1.0)):
    """Return the stage's result, see `malvar.py`."""
    factors = dict(zip("RGB", (balance[0], 1.0, balance[1]), strict=True))
    signal = np.asarray(raw, np.float64) - black_level
    for place, letter in enumerate(phase):
        signal[place // 2 :: 2, place % 2 :: 2] *= factors[letter]
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(signal, 2, mode="reflect"), (5, 5))
    out = np.empty((3, *raw.shape))
    for place, letter in enumerate(phase):
        every = np.s_[place // 2 :: 2, place % 2 :: 2]
        beside = phase[place ^ 1]
        for color, plane in zip("RGB", out, strict=True):
            if color == letter:
                kernel = KEEP
            elif letter == "G":
                kernel = BESIDE if color == beside else BESIDE.T
            else:
                kernel = GREEN if color == "G" else ACROSS
            plane[every] = (windows[every] * kernel).sum(axis=(2, 3)) / factors[color]
    return out * scale
