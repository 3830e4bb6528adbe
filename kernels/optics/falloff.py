"""Fall-off of every pixel: relative illumination of a measured lens, falloff of microlenses toward the corner.

Ports: planes (planes, rows, cols) float32, gains (1 or planes, rows, cols) float32 [1]
-> planes (planes, rows, cols) float32 of the planes' unit. The cos^4 law alone needs no map: `sensor.collect` has it.
"""

import numpy as np

from gpusim.kernels.stage import Case, stage


@stage
def falloff(device, planes, gains):
    """Multiply every plane by a map, its own or one for all.

    planes: shape (planes, rows, cols). gains: shape (1 or planes, rows, cols).
    Returns shape (planes, rows, cols). Source: Farrell and Wandell, section 4.1 (relative illumination).
    """
    count, rows, cols = planes.shape
    planes, gains = device.array(planes), device.array(gains)
    own = int(gains.shape[0] > 1)
    out = device.empty((count, rows, cols))
    device.launch("optics.falloff", "falloff", out.shape, planes, gains, out, own, *out.shape)
    return out


def cases():
    """One map for all planes and one for each, over nine decades."""
    random = np.random.default_rng(9)
    for planes, maps, rows, cols in ((1, 1, 1, 1), (3, 1, 3, 5), (4, 4, 63, 65), (2, 1, 5, 200)):
        yield Case(
            f"{rows}x{cols}, {planes} planes, {maps} maps",
            {
                "planes": (10.0 ** random.uniform(-3, 6, (planes, rows, cols))).astype(np.float32),
                "gains": random.random((maps, rows, cols)).astype(np.float32),
            },
            2.0**-24,
            "one float32 product rounds once: half an ulp",
            metric="local",
        )


def bench(rows, cols):
    """Three planes, one map."""
    random = np.random.default_rng(9)
    return {
        "planes": random.random((3, rows, cols), np.float32),
        "gains": random.random((1, rows, cols), np.float32),
    }


def operations(planes, gains):
    """A multiplication for each value."""
    return planes.size
