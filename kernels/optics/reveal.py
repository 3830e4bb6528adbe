"""Light of a layer of a picture: at some samples, another sample's instead of their own.

Behind a nearer layer the light of the nearest sample goes on that shows nothing of it. A sample that
shows two layers has the light of one after the light of a sample of the other, times its part, is
taken away:

    out(at_k) = (1 + f_k) planes(source_k) - f_k planes(other_k),    out = planes elsewhere.

Ports: planes (planes, rows, cols) float32, index (3, n) int32, factor (n,) float32 [1] -> (planes, rows,
cols) float32 in the planes' unit.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage


@stage
def reveal(device: Device, planes: Array, index: Array, factor: Array) -> Array:
    """Replace the light of samples.

    Args:
        planes: Light of each plane, shape (planes, rows, cols).
        index: Samples that are replaced, all different; samples whose light they get; and samples
            whose light is taken away: their numbers, row by row, shape (3, n).
        factor: How often it is taken away, and the other's added [1], shape (n,).
        device: A `Device`, or its name for `open_device`.

    Returns:
        The light, shape (planes, rows, cols), float32.
    """
    count, rows, cols = planes.shape
    planes, out = device.array(planes), device.empty(planes.shape)
    launch = functools.partial(device.launch, "optics.reveal")
    launch("begin", out.shape, planes, out, *out.shape)
    if factor.shape[0]:
        arrays = [planes, device.array(index, np.int32), device.array(factor), out]
        launch("reveal", (count, factor.shape[0]), *arrays, count, factor.shape[0], rows * cols)
    return out


def cases():
    """Yield cases: one sample, none, a twentieth of them, light over nine decades."""
    random = np.random.default_rng(37)
    for planes, rows, cols, count in ((1, 1, 1, 1), (2, 3, 5, 0), (3, 33, 65, 110)):
        light = (10.0 ** random.uniform(-3, 6, (planes, rows, cols))).astype(np.float32)
        at = random.permutation(rows * cols)[:count]
        others = random.integers(0, rows * cols, (2, count))
        yield Case(
            f"{planes} planes, {rows}x{cols}, {count} samples",
            {
                "planes": light,
                "index": np.stack([at, *others]).astype(np.int32),
                "factor": random.choice([0, 0.3, 1], count).astype(np.float32),
            },
            5 * 2.0**-24,
            "a sum of two products of at most twice the largest light",
        )


def bench(rows, cols):
    """Return inputs: three planes, a twentieth of the samples."""
    random = np.random.default_rng(37)
    at = np.arange(0, rows * cols, 20)
    return {
        "planes": random.random((3, rows, cols), np.float32),
        "index": np.stack([at, at[::-1], at]).astype(np.int32),
        "factor": np.zeros(len(at), np.float32),
    }
