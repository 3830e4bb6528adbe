"""Demosaicking of a Bayer mosaic by the linear filters of Malvar, He and Cutler.

Ports: raw (rows, cols) uint16 [DN] -> rgb (3, rows, cols) float32, (DN - black_level) scale: linear
camera red, green and blue, 1 at the white level if scale = 1 / (white_level - black_level).
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.cases import SATURATED, bench_mosaic, random_mosaic
from gpusim.kernels.processor.bayer import RED, check_mosaic, red_pixel
from gpusim.kernels.processor.levels import check_balance
from gpusim.kernels.stage import Array, Case, exact_case, stage


@stage
def malvar(
    device: Device,
    raw: Array,
    *,
    phase: str,
    black_level: float,
    scale: float,
    balance: tuple[float, float] = (1.0, 1.0),
) -> Array:
    """Demosaick by means of nearest samples, corrected by the own colour's Laplacian.

    Measured samples are kept, and nothing is clipped. The mosaic is mirrored at its borders without
    repeating the end pixel, which keeps every sample's colour. An axis of a single pixel mirrors
    onto itself.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: "RGGB", "GRBG", "GBRG" or "BGGR".
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        balance: Factors of (red, blue) for corrections [1], with which white is as strong in them
            as in green. The result is divided by them.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear camera RGB [1], shape (3, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16.
        OutOfRange: `scale` or `balance` is not allowed.
        UnknownName: There is no such phase.

    Source:
        Malvar, He and Cutler 2004, "High-quality linear interpolation for demosaicing of
        Bayer-patterned color images", ICASSP III-485, figure 2.
    """
    check_mosaic(raw, scale)
    red_row, red_col = red_pixel(phase)
    red, blue = check_balance(balance)
    rows, cols = raw.shape
    out = device.empty((3, rows, cols))
    pairs = cols // 2 + 1  # enough for either column phase
    run = 1 if device.is_gpu else pairs  # a GPU wants many small items, LLVM a loop to vectorise
    fours = device.kind == "opencl" and device.is_gpu and cols % 4 == 0
    arrays = [device.array(raw, np.uint16), out]
    numbers = [float(black_level), float(scale), red, blue, red_row, red_col, run, rows, cols]
    grid = (rows, cols // 4 if fours else -(-pairs // run))
    defines = {"GPU": 1} if device.is_gpu else None
    group = None if device.is_gpu else (1, 1)
    device.launch(
        "processor.malvar", "malvar", grid, *arrays, *numbers, defines=defines, group=group
    )
    return out


def cases():
    """Yield cases.

    All phases, odd and degenerate sizes, black, saturation, values below the black level.
    """
    random = np.random.default_rng(7)
    why = (
        "weights are 16ths, and sums of 16-bit integers with whole weights of at most 64 in all stay below 2^22: "
        "exact, so only the subtraction and the product round: (1 + 2^-24)^2 - 1 < 2^-23 (1 + 2^-24) relative"
    )
    for phase in RED:
        sizes = (1, 1), (1, 4), (5, 1), (2, 2), (2, 3), (3, 5), (63, 65), (16, 130), (9, 64)
        for rows, cols in sizes:
            raw = random_mosaic(random, 65535, (rows, cols))
            inputs = {"raw": raw, "phase": phase, "black_level": 64.0, "scale": 1 / 1024}
            tolerance = 2.0**-23 * (1 + 2.0**-24)
            yield Case(f"{phase} {rows}x{cols}", inputs, tolerance, why, metric="local")
    for phase, balance in zip(RED, ((2.1, 1.4), (0.7, 3.0), (1.0, 0.25), (2.5, 2.5)), strict=True):
        raw = random.integers(0, 65536, (33, 36), np.uint16)
        most = max(1, *(a / b for a in (*balance, 1) for b in (*balance, 1)))
        levels = {"black_level": 64.0, "scale": 1 / 65536}
        yield Case(
            f"{phase} balanced {balance}",
            {"raw": raw, "phase": phase, **levels, "balance": balance},
            6 * 2.0**-24 * (1 + 1.5 * most),
            "six roundings (share, product, sum, three of the end) of the largest sum of absolute terms, "
            "neighbours and 24 16ths of the Laplacian times the share, by a peak of 1 or more",
        )
    checkers = np.where(np.add.outer(np.arange(12), np.arange(14)) % 3 == 0, 65535, 0)
    yield exact_case(
        "black and saturated",
        "16ths of whole numbers below 2^22 are exact",
        raw=checkers.astype(np.uint16),
        phase="GBRG",
        black_level=0.0,
        scale=1.0,
    )
    yield SATURATED


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic."""
    return {**bench_mosaic(7, rows, cols), "phase": "RGGB"}
