"""Linear grey from the digital numbers of a monochrome sensor.

Ports: raw (rows, cols) uint16 [DN] -> grey (1, rows, cols) float32, (DN - black_level) scale.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.cases import bench_mosaic
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def linear(device: Device, raw: Array, *, black_level: float, scale: float) -> Array:
    """Subtract the black level and scale; nothing is clipped.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear grey [1], shape (1, rows, cols), float32.
    """
    rows, cols = raw.shape
    grey = device.empty((1, rows, cols))
    arrays = [device.array(raw, np.uint16), grey]
    numbers = [float(black_level), float(scale), *warp_only(device, cols), rows * cols]
    device.launch("processor.linear", "linear", (rows * cols,), *arrays, *numbers)
    return grey


def cases():
    """Yield cases: black, white, below black, odd sizes."""
    random = np.random.default_rng(5)
    for rows, cols in ((1, 1), (3, 5), (63, 65)):
        raw = random.integers(0, 65536, (rows, cols), np.uint16)
        raw.flat[0] = 0
        yield Case(
            f"{rows}x{cols}",
            {"raw": raw, "black_level": 64.0, "scale": 1 / 1024},
            2.0**-24,
            "the difference of integers below 2^24 is exact, scaling by a power of two too; half an ulp is "
            "left for a contracted product",
            metric="local",
        )


def bench(rows, cols):
    """Return inputs: a 10-bit frame."""
    return bench_mosaic(5, rows, cols)


def operations(raw, black_level, scale):
    """Count operations: a subtraction and a multiplication for each value."""
    return 2 * raw.size
