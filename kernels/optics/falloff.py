"""Fall-off at every pixel: relative illumination of a lens, loss of microlenses in corners.

Ports: planes (planes, rows, cols) float32, gains (1 or planes, rows, cols) float32 [1] [, base
(planes, rows, cols) float32] -> planes (planes, rows, cols) float32 in the planes' unit. The cos^4
law needs no map: `sensor.collect` applies it.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage


@stage
def falloff(device: Device, planes: Array, gains: Array, base: Array | None = None) -> Array:
    """Multiply every plane by a map of gains, and add a base.

    Args:
        planes: Light of each plane, shape (planes, rows, cols).
        gains: Gain of every pixel [1], shape (1 or planes, rows, cols): one map for all planes, or
            one for each.
        base: Light to add to, shape of the planes; None for 0.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The sums, shape (planes, rows, cols), float32.

    Source:
        Farrell and Wandell, section 4.1 (relative illumination).
    """
    count, rows, cols = planes.shape
    planes, gains = device.array(planes), device.array(gains)
    own = int(gains.shape[0] > 1)
    out = device.empty((count, rows, cols))
    arrays = [planes, gains, out if base is None else device.array(base), out]
    numbers = [own, int(base is not None)]
    device.launch("optics.falloff", "falloff", out.shape, *arrays, *numbers, *out.shape)
    return out


def cases():
    """Yield cases: one map for all planes and one for each, over nine decades."""
    random = np.random.default_rng(9)
    why = "one float32 product rounds once, and a sum of positive terms again: half an ulp each"
    for planes, maps, rows, cols in ((1, 1, 1, 1), (3, 1, 3, 5), (4, 4, 63, 65), (2, 1, 5, 200)):
        light = (10.0 ** random.uniform(-3, 6, (planes, rows, cols))).astype(np.float32)
        gains = random.random((maps, rows, cols)).astype(np.float32)
        name = f"{rows}x{cols}, {planes} planes, {maps} maps"
        inputs = {"planes": light, "gains": gains}
        if maps == planes:
            inputs["base"] = random.random(light.shape, np.float32)
        yield Case(name, inputs, (len(inputs) - 1) * 2.0**-24, why, metric="local")


def bench(rows, cols):
    """Return inputs: three planes, one map."""
    random = np.random.default_rng(9)
    return {
        "planes": random.random((3, rows, cols), np.float32),
        "gains": random.random((1, rows, cols), np.float32),
    }


def operations(planes, gains, base=None):
    """Count operations: a multiplication for each value."""
    return planes.size
