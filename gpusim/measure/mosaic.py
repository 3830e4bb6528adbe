"""Pictures of raw mosaics: every pixel in the colour of its filter."""

import numpy as np

from gpusim.domain.sensor import Sensor

LIGHTS = {
    "R": (1, 0, 0),
    "G": (0, 1, 0),
    "B": (0, 0, 1),
    "C": (0, 1, 1),
    "M": (1, 0, 1),
    "Y": (1, 1, 0),
    "E": (0, 1, 0.5),
    "W": (1, 1, 1),
}  # linear RGB; other letters are grey
GREY = (1, 1, 1)


def color_mosaic(sensor: Sensor, codes) -> np.ndarray:
    """Return a colour picture of a mosaic's codes, uint8 (rows, cols, 3).

    One channel and filters with unknown letters are grey. Stacked RGB is a picture; of other
    stacked layers the mean is shown. codes: uint8 (rows, cols), or (C, rows, cols) of stacked
    pixels.
    """
    codes = np.asarray(codes)
    if codes.ndim == 3:
        if sensor.channels == ("R", "G", "B"):
            return np.ascontiguousarray(np.moveaxis(codes, 0, -1))
        mean = codes.mean(axis=0, dtype=np.float32).astype(np.uint8)
        return np.repeat(mean[..., None], 3, axis=2)
    known = {} if sensor.is_monochrome else LIGHTS
    lights = [known.get(letter, GREY) for letter in sensor.channels]
    period = np.array(lights, np.float32)[sensor.cfa_indices]
    return (codes[..., None] * tile(period, codes.shape) + np.float32(0.5)).astype(np.uint8)


def tile(period: np.ndarray, shape) -> np.ndarray:
    """Return a period of a mosaic, (high, wide) or (high, wide, C), repeated over (rows, cols)."""
    rows, cols = (np.arange(count) % step for count, step in zip(shape, period.shape, strict=False))
    return period[np.ix_(rows, cols)]


def channel_values(
    sensor: Sensor, values: np.ndarray, corner: tuple[int, int] = (0, 0)
) -> dict[str, np.ndarray]:
    """Return the values of the pixels of each channel that a part of a mosaic has, (N,) by letter.

    values: (rows, cols), or (C, rows, cols) of stacked pixels. corner: row and column of its first
    pixel in the frame.
    """
    if values.ndim == 3:
        return {
            letter: plane.ravel() for letter, plane in zip(sensor.channels, values, strict=True)
        }
    period = np.roll(sensor.cfa_indices, [-at for at in corner], axis=(0, 1))
    own = tile(period, values.shape)
    found = {letter: values[own == index] for index, letter in enumerate(sensor.channels)}
    return {letter: one for letter, one in found.items() if one.size}
