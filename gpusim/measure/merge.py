"""What a merge of several exposures to one of high dynamic range starts from."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.short_repr import brief

MARGIN = 5.0  # standard deviations of a read below the well that still count as full: one saturated value in 3e6 passes


@dataclass(frozen=True, eq=False)
class MergeInputs:
    """Several measurements of the same light, shape (frames, rows, cols) or (frames, C, rows, cols).

    rates: electrons per second from light [e- s-1], float64; negative where noise made them so. variances: of these
    [e-2 s-2], float64. valid: whether neither the converter nor the well limited the value, bool.
    """

    rates: np.ndarray
    variances: np.ndarray
    valid: np.ndarray

    __repr__ = brief


def merge_inputs(frames, averaged: int = 1) -> MergeInputs:
    """Rates, variances and valid values of frames of one scene, such as `gpusim.bracket` takes.

    With the gain g [DN/e-], the electrons of dark current d and the exposure time t of a frame

        rate = ((raw - black level) / g - analog offset - d) / t,
        variance = (r t + d + read^2 + row^2 + column^2 + 1 / (12 g^2)) / t^2,

    for one pixel, and `RawNoise.variance` for the mean of several. r is the mean rate of all valid values of a pixel,
    each weighted by its exposure time, or 0 if that is negative. The variance is not taken from each value alone:
    weights of their inverse would then favour the values that happen to be low, and the merged rate be about one
    electron short. Fixed patterns, telegraph noise and the clipping of values below digital number 0 are not corrected
    for. Among averaged digital numbers saturated ones may be unseen.

    frames: objects with camera, exposure_time [s] and raw, shape (rows, cols) or (C, rows, cols) [DN], all alike.
    averaged: pixels whose digital numbers were averaged to one by digital binning [1].
    Raises BadData, OutOfRange. Source: Debevec and Malik, "Recovering high dynamic range radiance maps from
    photographs" (1997), for the merge of rates; Hasinoff, Durand and Freeman, "Noise-optimal capture for high dynamic
    range photography" (2010), for the variance.
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
                f"(C, rows, cols), all like frame 0, {shape}"
            )
        if not np.isfinite(raw).all():
            raise BadData(f"merge_inputs: frame {number} has NaN or infinite values")
        sensor = frame.camera.sensor
        noises.append(RawNoise.of(sensor, averaged))
        darks.append(sensor.noise.dark_current * sensor.noise.warmth * time)
        electrons = (raw - sensor.black_level) / sensor.gain_dn_per_electron - sensor.analog_offset
        found.append((electrons - darks[-1]) / time)
        full = electrons >= sensor.full_well - MARGIN * np.sqrt(noises[-1].variance(temporal=True))
        good.append(~full if sensor.bits == FLOAT_BITS else ~full & (raw < sensor.white_level))
    rates, valid = np.stack(found), np.stack(good)
    each = (-1, *[1] * len(shape))
    counts = np.where(valid.any(axis=0), valid, True) * times.reshape(
        each
    )  # where none is valid, all are as good
    light = np.maximum((rates * counts).sum(axis=0) / counts.sum(axis=0), 0.0)
    variances = np.stack(
        [
            noise.variance(light * time + dark, temporal=True) / time**2
            for noise, dark, time in zip(noises, darks, times, strict=True)
        ]
    )
    return MergeInputs(rates, variances, valid)
