"""Measurements next to a picture on the page: light, edges, and the error of the electrons."""

from math import log10

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import GpusimError
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import Sensor
from gpusim.measure.sfr import mtf50, sfr
from gpusim.pipeline.loop import Loop

BINS, SOME = 64, 60000  # of the histogram; pixels in it, about
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear RGB, as Rec. 709 and sRGB have it
SPAN = 4.0  # root mean squares of the error from grey to full colour


def light(loop: Loop, mean, at: tuple[int, int] | None) -> dict:
    """Return the histogram of mean electrons, and the electrons of one pixel.

    mean: (rows, cols), or of stacked pixels (C, rows, cols) [e-]. at: row and column, or None. The
    histogram counts some of the pixels, in BINS from 0 to `full well`, by the letters of the
    channels.
    """
    sensor = loop.exposure.camera.sensor
    full = float(sensor.saturation)
    counts = {
        letter: np.histogram(np.minimum(values, full), BINS, (0, full))[0].tolist()
        for letter, values in _some(sensor, mean)
    }
    found: dict = {"counts": counts, "full well": full, "black level": float(sensor.dark_level)}
    if at is not None and mean.ndim == 2:
        y, x = (min(max(place, 0), n - 1) for place, n in zip(at, mean.shape, strict=True))
        electrons = float(mean[y, x])
        noise = RawNoise.of(sensor, loop.simulator.readout.averaged)
        sigma = float(noise.variance(electrons, temporal=True)) ** 0.5
        numbers = electrons * sensor.gain_dn_per_electron + sensor.dark_level
        found["pixel"] = {
            "row": y,
            "col": x,
            "electrons": electrons,
            "dn": float(min(numbers, sensor.white_level)),
            "snr": 20 * log10(max(electrons, 1e-9) / max(sigma, 1e-9)),
        }
    return found


def edge(linear, part: tuple[slice, slice]) -> dict:
    """Return the spatial frequency response of a part of a picture, or the reason why it has none.

    linear: display RGB (rows, cols, 3). The result has lists of frequencies [cycle/pixel] and
    responses up to 1 cycle/pixel, `mtf50` [cycle/pixel] and the edge's angle [degree]; or only
    `why`.
    """
    values = np.asarray(linear, np.float64)[part] @ LUMINANCE
    try:
        found = sfr(values)
        half = float(mtf50(found))
    except GpusimError as error:
        return {"why": str(error)}
    seen = found.frequencies <= 1
    return {
        "frequencies": found.frequencies[seen].tolist(),
        "response": found.response[seen].tolist(),
        "mtf50": half,
        "angle": float(np.degrees(found.angle)),
    }


def error_map(mean, truth) -> np.ndarray:
    """Return codes (rows, cols, 3) of an error: grey 0, red too many electrons, full colour at SPAN."""
    wrong = np.asarray(mean, np.float64) - truth
    wrong = wrong if wrong.ndim == 2 else wrong.mean(axis=0)
    part = np.clip(wrong / max(SPAN * np.sqrt(np.mean(wrong**2)), 1e-300), -1, 1)
    grey = 128 * (1 - np.abs(part))
    red = grey + 255 * np.maximum(part, 0)
    blue = grey + 255 * np.maximum(-part, 0)
    codes = np.stack([red, grey, blue], axis=-1)
    return (np.clip(codes, 0, 255) + 0.5).astype(np.uint8)


def _some(sensor: Sensor, values):
    """Return the channels' letters, and values of some of their pixels."""
    if values.ndim == 3:
        step = max(1, values[0].size // SOME)
        return zip(sensor.channels, values.reshape(len(values), -1)[:, ::step], strict=True)
    cfa = sensor.cfa_indices
    high, wide = cfa.shape
    step = max(1, round((values.size / SOME) ** 0.5))
    found = []
    for index, letter in enumerate(sensor.channels):
        places = np.argwhere(cfa == index)
        parts = [values[y :: high * step, x :: wide * step].ravel() for y, x in places]
        found.append((letter, np.concatenate(parts)))
    return found


def on_host(device: Device, array) -> np.ndarray:
    """Return a host copy of an array of the device."""
    return np.array(device.numpy(array))
