"""Bilinear demosaicking of a Bayer mosaic, with black level and scale.

Ports: raw (rows, cols) uint16 [DN] -> rgb (3, rows, cols) float32, (DN - black_level) scale: linear
camera red, green and blue, 1 at the white level if scale = 1 / (white_level - black_level).
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.cases import SATURATED, bench_mosaic, random_mosaic
from gpusim.kernels.processor.bayer import RED, check_mosaic, red_pixel
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage


@stage
def bilinear(device: Device, raw: Array, *, phase: str, black_level: float, scale: float) -> Array:
    """Demosaick by the means of the nearest 2 or 4 samples.

    Measured samples are kept, and nothing is clipped. The mosaic is mirrored at its borders without
    repeating the end pixel, which keeps every sample's colour. An axis of a single pixel has no
    neighbour of another colour and mirrors onto itself.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: "RGGB", "GRBG", "GBRG" or "BGGR".
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear camera RGB [1], shape (3, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16.
        OutOfRange: `scale` is not above 0.
        UnknownName: There is no such phase.

    Source:
        Losson, Macaire and Yang 2010, Advances in Imaging and Electron Physics 162, section 3.
    """
    check_mosaic(raw, scale)
    red_row, red_col = red_pixel(phase)
    rows, cols = raw.shape
    out = device.empty((3, rows, cols))
    run, shape = items(device, cols)
    arrays = [device.array(raw, np.uint16), out]
    defines = shape | {"ELECTRONS": 0}
    numbers = [float(black_level), float(scale), red_row, red_col, run, rows, cols]
    group = None if device.is_gpu else (1, 1)
    grid = (-(-rows // shape["ROWS"]), -(-cols // run))
    device.launch(
        "processor.bilinear", "bilinear", grid, *arrays, *numbers, defines=defines, group=group
    )
    return out


def items(device, cols):
    """Return a work-item's columns, and ROWS and vector WIDTH: whole rows on CPUs, few on GPUs."""
    if is_opencl_cpu(device):
        return -(-cols // 8) * 8, {"WIDTH": 8, "ROWS": 4}
    if device.kind == "opencl" and cols % 4 == 0:
        return 4, {"WIDTH": 4, "ROWS": 2}
    return 1, {"WIDTH": 1, "ROWS": 4}


def cases():
    """Yield cases.

    All phases, odd and degenerate sizes, black, saturation, values below the black level.
    """
    random = np.random.default_rng(2)
    why = (
        "sums of four 16-bit integers and their halves are exact in float32, so only the subtraction and the "
        "product round: (1 + 2^-24)^2 - 1 < 2^-23 (1 + 2^-24) relative"
    )
    for phase in RED:
        for rows, cols in ((1, 1), (1, 4), (5, 1), (2, 2), (3, 5), (63, 65), (16, 130), (9, 12)):
            raw = random_mosaic(random, 65535, (rows, cols))
            inputs = {"raw": raw, "phase": phase, "black_level": 64.0, "scale": 1 / 1024}
            tolerance = 2.0**-23 * (1 + 2.0**-24)
            yield Case(f"{phase} {rows}x{cols}", inputs, tolerance, why, metric="local")
    raw = np.full((6, 6), 64, np.uint16)
    yield exact_case(
        "black", "64 - 64 is exact", raw=raw, phase="RGGB", black_level=64.0, scale=2.0
    )
    yield SATURATED


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic."""
    return {**bench_mosaic(2, rows, cols), "phase": "RGGB"}
