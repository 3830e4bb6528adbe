"""Correction of lens shading in any mosaic: every pixel times a smooth gain.

Ports: raw (rows, cols) uint16 [DN], gains (C, ny, nx) float32 [1] -> (rows, cols) uint16 with black
at 4096 and white at 65535 (see levels.py):

    round(4096 + 61439 gain (DN - black_level) scale), clipped to 0 .. 65535

Demosaick it with black_level = 4096, scale = 1 / 61439.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import MOSAICS, RGGB, random_mosaic
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.interpolate import checked_mosaic
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE, check_black
from gpusim.kernels.stage import Array, Case, exact_case, stage

MOST_NODES = 1024  # each way: places between them are counted in 32-bit integers


@stage
def shade(
    device: Device, raw: Array, gains: Array, *, cfa: Array, black_level: float, scale: float
) -> Array:
    """Multiply every pixel by its channel's gain at its place.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        gains: Gains of each channel [1] at nodes that are even from edge to edge of the frame,
            bilinear between them, shape (C, ny, nx), 2 nodes or more along each axis, finite and >=
            0.
        cfa: Channel of each pixel in one period of the mosaic, at most 8 x 8, whole numbers 0 .. C
            - 1 that all occur.
        black_level: Black level [DN].
        scale: 1 / (white_level - black_level) [1/DN]. Values that gains lift above white are
            clipped.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Numbers with black at 4096 and white at 65535, shape (rows, cols), uint16.

    Raises:
        BadData: `raw` is no mosaic of uint16, the mosaic is not allowed, or the gains' shape does
            not fit.
        OutOfRange: `black_level`, `scale` or a gain is not allowed.
    """
    check_mosaic(raw, scale)
    check_black(black_level)
    cfa = checked_mosaic(np.asarray(device.numpy(cfa)))
    channels = int(cfa.max()) + 1
    shape = tuple(gains.shape)
    if (
        len(shape) != 3
        or shape[0] != channels
        or not 2 <= min(shape[1:]) <= max(shape[1:]) <= MOST_NODES
    ):
        raise BadData(
            f"gains: shape {shape}, wanted ({channels}, 2 .. {MOST_NODES}, 2 .. {MOST_NODES}): nodes of each "
            "of the mosaic's channels"
        )
    if isinstance(gains, np.ndarray) and not (np.isfinite(gains).all() and gains.min() >= 0):
        wrong = gains[~(np.isfinite(gains) & (gains >= 0))]
        raise OutOfRange("gains", f"{wrong[0]:.6g}", "0 <= gain < inf")
    rows, cols = raw.shape
    _, ny, nx = shape
    lines = device.empty((cfa.shape[0], ny, cols))
    out = device.empty((rows, cols), np.uint16)
    arrays = [device.array(gains), device.array(cfa, np.int32), lines]
    device.launch("processor.shade", "widen", lines.shape, *arrays, *cfa.shape, ny, nx, cols)
    arrays = [device.array(raw, np.uint16), lines, out]
    levels = CORRECTED_WHITE - CORRECTED_BLACK
    numbers = [float(black_level), float(scale * levels), float(CORRECTED_BLACK)]
    sizes = [cfa.shape[0], ny, rows, cols]
    device.launch("processor.shade", "shade", (rows, cols), *arrays, *numbers, *sizes)
    return out


def cases():
    """Yield cases.

    Mosaics, sizes down to one pixel, steep gains, gains of 0, below black, clipped.
    """
    random = np.random.default_rng(10)
    why = (
        "gain: 6 roundings (two fractions, two means of two) of at most 2^-24 times the largest, 8; with the "
        "product below 61439 x 8 x 6 2^-24 < 0.2 steps where nothing is clipped: the rounding to whole numbers may "
        "differ by one"
    )
    for name in ("Bayer", "X-Trans", "grey"):
        cfa = MOSAICS[name]
        for rows, cols, ny, nx in ((1, 1, 2, 2), (3, 5, 4, 3), (63, 130, 5, 9), (40, 33, 17, 65)):
            raw = random_mosaic(random, 4095, (rows, cols))
            gains = random.uniform(0, 8, (cfa.max() + 1, ny, nx)).astype(np.float32)
            inputs = {"gains": gains, "cfa": cfa, "black_level": 64.0, "scale": 1 / 4031}
            title = f"{name} {rows}x{cols}, {ny}x{nx} nodes"
            yield Case(title, {"raw": raw, **inputs}, 1.0, why, metric="exact")
    yield exact_case(
        "no correction",
        "gain 1: three roundings are below 61439 x 3 x 2^-24 < .02, and the exact result is a whole number",
        raw=random.integers(0, 65536, (20, 30), np.uint16),
        gains=np.ones((3, 3, 3), np.float32),
        cfa=RGGB,
        black_level=4096.0,
        scale=1 / 61439,
    )


def bench(rows, cols):
    """Return inputs: a 10-bit Bayer mosaic, 17 x 17 nodes."""
    random = np.random.default_rng(10)
    raw = random.integers(0, 1024, (rows, cols), np.uint16)
    gains = random.uniform(1, 4, (3, 17, 17)).astype(np.float32)
    return {"raw": raw, "gains": gains, "cfa": RGGB, "black_level": 64.0, "scale": 1 / 959}
