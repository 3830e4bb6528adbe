"""Luminance and chroma of OpenEXR: Y, RY = (R - Y) / Y and BY = (B - Y) / Y.

RY and BY are stored for every second row and column. Source: OpenEXR's documentation, "Technical
Introduction", "Luminance/Chroma Images", and the filter of its class RgbaYca.
"""

import numpy as np

# weights of the samples at distances 1, 3 .. 13 on either side, for a place between two samples
WEIGHTS = (0.627123, -0.186077, 0.087929, -0.043159, 0.019597, -0.007540, 0.002128)


def rgb_from_chroma(luminance, red, blue, chromaticities) -> np.ndarray:
    """Return a picture in its own linear RGB, float32 (3, rows, cols).

    luminance: (rows, cols). red, blue: RY and BY, of all pixels or of every second row and column.
    chromaticities: (x, y) of red, green, blue and white, (4, 2).
    """
    columns = np.stack([*chromaticities.T, 1 - chromaticities.sum(axis=1)])
    weights = columns[1, :3] * np.linalg.solve(columns[:, :3], columns[:, 3] / columns[1, 3])
    rgb = np.empty((3, *luminance.shape), np.float32)
    for place, chroma in ((0, red), (2, blue)):
        for axis in (1, 0):
            chroma = _double(chroma, axis, luminance.shape[axis])
        rgb[place] = (chroma + 1) * luminance
    rgb[1] = (luminance - weights[0] * rgb[0] - weights[2] * rgb[2]) / weights[1]
    return rgb


def _double(samples, axis, count):
    """Return `count` samples along an axis from every second one, with the outermost repeated."""
    held = samples.shape[axis]
    if held == count:
        return samples
    reach = len(WEIGHTS)
    wide = np.pad(samples, [(reach, reach) if one == axis else (0, 0) for one in (0, 1)], "edge")
    wide = np.moveaxis(wide, axis, 0)
    between = np.zeros((held, *wide.shape[1:]), np.float32)
    for distance, weight in enumerate(WEIGHTS):
        before, after = reach - distance, reach + 1 + distance
        between += np.float32(weight) * (wide[before : before + held] + wide[after : after + held])
    doubled = np.empty((2 * held, *wide.shape[1:]), np.float32)
    doubled[::2], doubled[1::2] = wide[reach : reach + held], between
    return np.moveaxis(doubled[:count], 0, axis)
