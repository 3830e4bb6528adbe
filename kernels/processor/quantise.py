"""Whole numbers from raw values of a sensor without a converter, as in corrected mosaics.

Ports: raw (rows, cols) float32 -> (rows, cols) uint16:

    number = round(min(max((raw - black_level) scale / LIGHT + CORRECTED_BLACK, 0), CORRECTED_WHITE)),

LIGHT the light of one number. Each float32 operation is rounded separately: the same bits on every
device. Halves are rounded to even; NaN becomes 0.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE, check_black
from gpusim.kernels.stage import Array, exact_case, stage, warp_only

LIGHT = 1 / (CORRECTED_WHITE - CORRECTED_BLACK)  # of one number, the white level being 1


@stage
def quantise(device: Device, raw: Array, *, black_level: float, scale: float) -> Array:
    """Round raw values to whole numbers, CORRECTED_BLACK at black, CORRECTED_WHITE at white.

    Args:
        raw: Raw values [DN], shape (rows, cols), float32.
        black_level: Black level of raw [DN].
        scale: 1 / (white level - black level) [1/DN].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Numbers, clipped to 0 .. CORRECTED_WHITE, shape (rows, cols), uint16.

    Raises:
        BadData: `raw` does not have two axes.
        OutOfRange: `black_level` or `scale` is not allowed.
    """
    check(raw, black_level, scale)
    rows, cols = raw.shape
    numbers = device.empty((rows, cols), np.uint16)
    arrays = [device.array(raw), numbers]
    levels = [float(CORRECTED_BLACK), float(CORRECTED_WHITE)]
    parameters = [float(black_level), float(scale), LIGHT, *levels]
    sizes = [*warp_only(device, cols), rows * cols]
    device.launch("processor.quantise", "quantise", (rows * cols,), *arrays, *parameters, *sizes)
    return numbers


def check(raw, black_level, scale):
    """Raise BadData or OutOfRange as `quantise` does."""
    if len(raw.shape) != 2:
        raise BadData(f"raw values of shape {tuple(raw.shape)}: wanted (rows, cols)")
    check_black(black_level)
    if not 2.0**-64 <= scale <= 2.0**64:
        raise OutOfRange("scale", scale, "2^-64 <= scale <= 2^64")


def cases():
    """Yield cases.

    Black, white, halves, beyond both ends, NaN, infinities, denormals, odd sizes, scales far from
    1.
    """
    random = np.random.default_rng(13)
    why = "the same four float32 operations, rounded in the same way, and an exact rounding"
    sizes = (1, 1, 0.0, 65535.0), (1, 17, 64.25, 1023.0), (63, 65, -3.1, 5e-4), (31, 33, 64.0, 1e9)
    for rows, cols, black, white in sizes:
        raw = random.normal(black + 0.4 * (white - black), white - black, (rows, cols))
        name = f"{rows}x{cols}, black {black:g}, white {white:g}"
        raw = raw.astype(np.float32)
        yield exact_case(name, why, raw=raw, black_level=black, scale=1 / (white - black))
    hard = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-45, 3.4e38, -3.4e38, 64.0, 1023.0]
    hard = np.array([hard], np.float32)
    yield exact_case("hard values", why, raw=hard, black_level=64.0, scale=1 / 959)
    steps = (np.arange(-16384, 16384, dtype=np.float32) / 2)[None] * np.float32(LIGHT)
    yield exact_case("halves", why, raw=steps, black_level=0.0, scale=1.0)


def bench(rows, cols):
    """Return inputs: electrons up to a full well."""
    raw = 1e4 * np.random.default_rng(13).random((rows, cols), np.float32)
    return {"raw": raw, "black_level": 0.0, "scale": 1e-4}
