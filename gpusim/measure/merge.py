"""Inputs of a merge of several exposures into one high dynamic range picture."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.short_repr import short_repr

# read noise sigmas below the well that count as full: 1 in 3e6 saturated values passes
MARGIN = 5.0


@dataclass(frozen=True, eq=False)
class MergeInputs:
    """Measurements of the same light, shape (frames, rows, cols) or (frames, C, rows, cols).

    Attributes:
        rates: electrons per second from light [e- s-1], float64; negative if noise makes them so.
        variances: variances of the rates [e-2 s-2], float64.
        valid: whether neither the converter nor the well limited the value, bool.
    """

    rates: np.ndarray
    variances: np.ndarray
    valid: np.ndarray

    __repr__ = short_repr


def full_value(sensor: Sensor) -> float:
    """Return the digital number from which a pixel counts as full: MARGIN below the well, or the converter's end.

    Args:
        sensor: The sensor as operated.
    """
    well = sensor.full_well - MARGIN * RawNoise.of(sensor).variance() ** 0.5
    return min(sensor.dark_level + sensor.gain_dn_per_electron * well, sensor.white_level)


def merge_inputs(frames: Iterable[Any], averaged: int = 1) -> MergeInputs:
    """Return rates, variances and valid values of frames of one scene, see `gpusim.bracket`.

    With the gain g [DN/e-], the electrons of dark current d and the exposure time t of a frame

        rate = ((raw - black level) / g - analog offset - d) / t,
        variance = (r t + d + read^2 + row^2 + column^2 + 1 / (12 g^2)) / t^2,

    for one pixel, and `RawNoise.variance` for the mean of several. r is the mean rate of all valid
    values of a pixel, weighted by exposure time, or 0 if that is negative. The variance is not
    estimated from each value separately: inverse-variance weights would then favour values that
    happen to be low, and the merged rate would be about one electron too low. Fixed patterns,
    telegraph noise and the clipping of values below digital number 0 are not corrected. Saturated
    pixels may be hidden in averaged digital numbers.

    Source: Debevec and Malik, "Recovering high dynamic range radiance maps from photographs"
    (1997), for the merge of rates; Hasinoff, Durand and Freeman, "Noise-optimal capture for high
    dynamic range photography" (2010), for the variance.

    Args:
        frames: objects with camera, exposure_time [s] and raw [DN], shape (rows, cols) or (C, rows,
            cols), all of one shape.
        averaged: pixels averaged into one digital number by digital binning [1].

    Returns:
        The inputs of the merge.

    Raises:
        BadData: if there are no frames, or their raw values do not fit together or are not finite.
        OutOfRange: if an exposure time or `averaged` is out of range.
    """
    frames = list(frames)
    if not frames:
        raise BadData("merge_inputs: no frames; wanted one or more")
    if not (averaged >= 1 and averaged == int(averaged)):
        raise OutOfRange("averaged", averaged, "a whole number of pixels, averaged >= 1")
    shape, noises, darks, found, good = np.shape(frames[0].raw), [], [], [], []
    times = np.array([frame.exposure_time for frame in frames], np.float64)
    for number, (frame, time) in enumerate(zip(frames, times, strict=True)):
        if not 0 < time < np.inf:
            raise OutOfRange(
                f"exposure_time of frame {number}", f"{time} s", "0 < exposure_time < inf"
            )
        raw = np.asarray(frame.raw, np.float64)
        if raw.shape != shape or raw.ndim not in (2, 3) or not raw.size:
            raise BadData(
                f"merge_inputs: frame {number} has the shape {raw.shape}; wanted (rows, cols) or "
                f"(C, rows, cols), the same for all frames; frame 0 has {shape}"
            )
        if not np.isfinite(raw).all():
            raise BadData(f"merge_inputs: frame {number} has NaN or infinite values")
        sensor = frame.camera.sensor
        noises.append(RawNoise.of(sensor, averaged))
        darks.append(sensor.noise.operating_dark_current * time)
        electrons = (raw - sensor.black_level) / sensor.gain_dn_per_electron - sensor.analog_offset
        found.append((electrons - darks[-1]) / time)
        full = electrons >= sensor.full_well - MARGIN * np.sqrt(noises[-1].variance(temporal=True))
        good.append(~full if sensor.bits == FLOAT_BITS else ~full & (raw < sensor.white_level))
    rates, valid = np.stack(found), np.stack(good)
    each = (-1, *[1] * len(shape))
    # all count if none is valid
    counts = np.where(valid.any(axis=0), valid, True) * times.reshape(each)
    light = np.maximum((rates * counts).sum(axis=0) / counts.sum(axis=0), 0.0)
    variances = np.stack(
        [
            noise.variance(light * time + dark, temporal=True) / time**2
            for noise, dark, time in zip(noises, darks, times, strict=True)
        ]
    )
    return MergeInputs(rates, variances, valid)
