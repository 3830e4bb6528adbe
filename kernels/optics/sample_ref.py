"""out = A_y planes A_x^T with the weights as the rows of dense matrices, float64."""

import numpy as np


def sample(planes, start_y, weights_y, start_x, weights_x):
    """Return the stage's result, see `sample.py`."""
    planes = np.asarray(planes, np.float64)
    return (_matrix(start_y, weights_y, planes.shape[1]) @ planes) @ _matrix(
        start_x, weights_x, planes.shape[2]
    ).T


def _matrix(start, weights, size):
    matrix = np.zeros((len(start), size))
    for row, first, values in zip(matrix, start, np.asarray(weights, np.float64), strict=True):
        row[first : first + len(values)] = values
    return matrix
