"""Planes of a scene of materials: a table look-up instead of a sum over bands.

Ports: ids (rows, cols) uint16, shading (rows, cols) float32, table (planes, materials) float32 ->
planes (planes, rows, cols) float32:

    planes_p(x) = shading(x) W[p, id(x)].

Six bytes per pixel are read instead of a whole spectrum.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def materials(device: Device, ids: Array, shading: Array, table: Array) -> Array:
    """Return weighted planes of a scene that stores one material per pixel.

    Args:
        ids: Material of each pixel, shape (rows, cols), uint16, below the number of materials.
        shading: Factor of each pixel, shape (rows, cols).
        table: Value of each material at shading 1 in each plane, shape (planes, materials).
        device: A `Device`, or its name for `open_device`.

    Returns:
        Planes, shape (planes, rows, cols), float32.
    """
    rows, cols = ids.shape
    ids, shading, table = device.array(ids, np.uint16), device.array(shading), device.array(table)
    planes, count = table.shape
    out = device.empty((planes, rows, cols))
    arrays = [ids, shading, table, out]
    sizes = [rows * cols, count, *warp_only(device, planes, cols)]
    defines = {"PLANES": planes}
    device.launch(
        "spectral.materials", "materials", (rows * cols,), *arrays, *sizes, defines=defines
    )
    return out


def cases():
    """Yield cases: one material to hundreds, shading over nine decades."""
    random, why = np.random.default_rng(2), "one float32 product rounds once: half an ulp"
    sizes = (1, 1, 3, 1), (3, 5, 3, 24), (63, 65, 31, 26), (5, 200, 4, 300)
    for rows, cols, planes, count in sizes:
        ids = random.integers(0, count, (rows, cols)).astype(np.uint16)
        shading = (10.0 ** random.uniform(-3, 6, (rows, cols))).astype(np.float32)
        table = random.random((planes, count)).astype(np.float32)
        name = f"{rows}x{cols}, {count} materials, {planes} planes"
        inputs = {"ids": ids, "shading": shading, "table": table}
        yield Case(name, inputs, 2.0**-24, why, metric="local")


def bench(rows, cols):
    """Return inputs: the 24 patches of a ColorChecker to 31 bands."""
    random = np.random.default_rng(2)
    return {
        "ids": random.integers(0, 24, (rows, cols)).astype(np.uint16),
        "shading": random.random((rows, cols), np.float32),
        "table": random.random((31, 24), np.float32),
    }


def operations(ids, shading, table):
    """Count operations: a multiplication for each sample."""
    return len(table) * ids.size
