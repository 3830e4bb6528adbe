"""Orientation of pictures: the number 1 .. 8 of TIFF's and EXIF's tag Orientation."""

import numpy as np


def turn(samples: np.ndarray, orientation: int) -> np.ndarray:
    """Return samples (rows, cols, ...) turned as the tag says; others than 2 .. 8 change nothing.

    Source: TIFF Revision 6.0, section 8, "Orientation".
    """
    if orientation in (5, 6, 7, 8):
        samples = samples.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        samples = samples[::-1]
    if orientation in (2, 3, 6, 7):
        samples = samples[:, ::-1]
    return samples
