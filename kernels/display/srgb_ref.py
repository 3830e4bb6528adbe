"""sRGB encoding, float64: IEC 61966-2-1:1999, 5.2; codes are rounded to the nearest."""

import numpy as np


def srgb(rgb):
    """Rgb (3, rows, cols) linear -> (rows, cols, 3) uint8. NaN is black."""
    linear = np.clip(np.nan_to_num(np.asarray(rgb, np.float64), nan=0.0), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.moveaxis(np.floor(255 * encoded + 0.5).astype(np.uint8), 0, -1)
