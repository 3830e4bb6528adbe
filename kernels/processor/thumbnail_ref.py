"""Means over the pixels of each block that are below the ceiling in every channel, float64."""

import numpy as np


def thumbnail(camera, ceiling, *, rows=48, cols=64):
    """Return the stage's result, see `thumbnail.py`."""
    from gpusim.kernels.processor.thumbnail import check_inputs

    channels, height, width = check_inputs(camera, rows, cols)
    rows, cols = min(rows, height), min(cols, width)
    camera = np.asarray(camera, np.float64)
    below = (camera < np.reshape(np.float32(ceiling), (-1, 1, 1))).all(0)
    out = np.full((channels, rows, cols), np.nan)
    for i in range(rows):
        for j in range(cols):
            block = np.s_[
                i * height // rows : (i + 1) * height // rows,
                j * width // cols : (j + 1) * width // cols,
            ]
            if below[block].any():
                out[:, i, j] = camera[:, *block][:, below[block]].mean(1)
    return out
