"""Whether a picture is all white or all black, and the exposure time that would do."""

from dataclasses import replace

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.sensor import Sensor

WHITE, BLACK = (
    255,
    32,
)  # display codes: all channels at the first, or below the second (1.4 % of white)
SHARE = 0.99  # of the pixels
LOOKED_AT = 256  # rows and columns that are looked at
FACTOR = 2.0  # between the exposure times: below it the scene itself is white or black


def describe_brightness(codes: np.ndarray, mean: np.ndarray, seconds: float, sensor: Sensor) -> str:
    """Return one line if a picture is all white or all black, else "".

    Args:
        codes: Display codes, uint8, shape (rows, cols, 3).
        mean: Mean electrons of the light, shape (..., rows, cols) [e-].
        seconds: Exposure time [s].
        sensor: The sensor as operated. Its automatic exposure, without limits, gives the time that would do.

    Returns:
        The line.
    """
    rows, cols = (max(1, size // LOOKED_AT) for size in codes.shape[:2])
    looked = codes[::rows, ::cols]
    is_white = bool((looked.min(axis=2) >= WHITE).mean() >= SHARE)
    if not is_white and (looked.max(axis=2) < BLACK).mean() < SHARE:
        return ""
    seen = "the picture is all white" if is_white else "the picture is all black"
    automatic = replace(sensor.auto_exposure, longest=None, most_gain=1.0)
    try:
        better, _ = automatic.choose(mean / seconds, sensor.saturation)
    except BadData:
        return f"{seen}: no light reaches the sensor"
    if (seconds / better if is_white else better / seconds) < FACTOR:
        return ""
    long = "long" if is_white else "short"
    return (
        f"{seen}: an exposure of {1e3 * seconds:.3g} ms is too {long}, {1e3 * better:.3g} ms would do "
        f"(--exposure {1e3 * better:.3g}ms, or exposure_time_ms in a camera file)"
    )
