"""Exposure: times as text, exposure values, automatic exposure, brackets."""

import re
from dataclasses import dataclass
from math import floor, prod
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange, check_fields, check_known, within

METHODS = ("highlights", "full", "percentile", "mean", "centre")
LIMITS = {
    "level": within("0 < level <= 1"),
    "percentile": within("0 < percentile <= 100", "%"),
    "longest": within("0 < longest <= 1e12", "s"),
    "most_gain": within("1 <= most_gain <= 1e4"),
}
LONGEST = 1e12  # [s]
MOST_GAIN = 1e4  # largest analog gain on top of the sensor's own
MIDDLE_GREY = 0.18  # reflectance of a photographer's grey card
FILLED = 0.95  # default level of a bright pixel, relative to saturation
HIGHLIGHTS = 0.001  # share of pixels that may clip: one glint in 10,000, blurred over ten pixels
# Ratio of the brightest pixel to the brightest of the rest:
PLAIN = 1.5  # up to this ratio (half a stop) it is part of the picture
LAMPS = 100.0  # above this ratio it is a lamp in the dark
CENTRE = 0.2  # standard deviation of the centre weight, relative to height and width of the frame


def exposure_value(f_number: ArrayLike, exposure_time: ArrayLike) -> Any:
    """Return the exposure value EV = log2(N^2 / T). Arrays broadcast.

    Args:
        f_number: F-number N [1].
        exposure_time: Exposure time T [s].

    Returns:
        Exposure value [stop], a NumPy scalar or array.

    Source:
        Farrell and Wandell, Image Systems Simulation, section 5.7.
    """
    return np.log2(np.square(f_number) / np.asarray(exposure_time))


def exposure_time(value, f_number):
    """Return the exposure time T = N^2 / 2^EV [s], the inverse of `exposure_value`.

    Args:
        value: Exposure value [stop].
        f_number: F-number N [1].

    Returns:
        Exposure time [s].
    """
    return np.square(f_number) / np.exp2(value)


def checked_time(time: float | None) -> float | None:
    """Return an exposure time [s], or None. Raise OutOfRange if it is not allowed."""
    if time is not None and not (isinstance(time, Real) and 0 < time <= LONGEST):
        raise OutOfRange("exposure_time", f"{time} s", f"0 < exposure_time <= {LONGEST:g} s")
    return time


def checked_gain(gain: float) -> float:
    """Return an analog gain [1]. Raise OutOfRange if it is not allowed."""
    if not (isinstance(gain, Real) and 0 < gain <= MOST_GAIN):
        raise OutOfRange("gain", gain, f"0 < gain <= {MOST_GAIN:g}")
    return gain


def bracket_times(time: float, stops) -> np.ndarray:
    """Return the exposure times `time` 2^stops [s]. Raise BadData or OutOfRange."""
    try:
        stops = np.atleast_1d(np.asarray(stops, np.float64))
    except (TypeError, ValueError):
        raise BadData(f"stops of a bracket = {stops!r}: wanted a list of numbers") from None
    times = time * np.exp2(stops)
    if stops.ndim != 1 or not stops.size or not (np.isfinite(times) & (times > 0)).all():
        raise OutOfRange(
            "stops of a bracket",
            stops.tolist(),
            "a list of finite numbers, small enough for a time",
        )
    return times


@dataclass(frozen=True)
class LightStatistics:
    """Statistics of the light in a frame, computed by `gpusim.kernels.sensor.meter`.

    Attributes:
        values: Result of the kernel for the weights and fractions of an AutoExposure, shape (6 + 2
            Q,).
        pixels: Number of pixels that were counted.
    """

    values: np.ndarray
    pixels: int

    def over(self, seconds: float) -> "LightStatistics":
        """Return the statistics per second, if these are for an exposure of `seconds` [s]."""
        values = self.values.copy()
        scaled = np.arange(len(values)) != 4  # all but the count
        values[scaled] /= np.float32(seconds)
        return LightStatistics(values, self.pixels)

    def plus(self, rate: float) -> "LightStatistics":
        """Return the statistics with `rate` [e- s-1] added to every pixel.

        The products of the weights must add up to 1.
        """
        values, more = self.values.copy(), np.float32(rate)
        mean, root, added = map(float, (values[1], values[2], more))
        values[2] = max(root**2 + 2 * mean * added + added**2, 0.0) ** 0.5
        values[[0, 1, 3, 5]] += more
        values[6:] += more  # order statistics stay sorted
        return LightStatistics(values, self.pixels)


@dataclass(frozen=True)
class AutoExposure:
    """Rule that sets exposure time and analog gain from the light in the frame.

    Args:
        method: Signal that is brought to `level`. "highlights": the brightest pixel, except for a
            thousandth of the pixels, see `without_highlights`. "full": the brightest pixel; nothing
            clips. "percentile": the given percentile of the pixels; a few lamps may clip. "mean":
            the average. "centre": the average weighted by a Gaussian about the centre of the frame.
        level: Target, relative to saturation [1]. The default is 0.95 for a bright pixel, and 0.95
            x 18 % for an average, which puts white at 0.95.
        percentile: Percentile for method "percentile" [%].
        longest: Longest exposure time [s], or None for no limit. If it is too short, the analog
            gain rises up to most_gain.
        most_gain: Largest analog gain [1].

    Raises:
        BadData: most_gain without longest.
        OutOfRange: A number is outside its range.
        UnknownName: The method is not known.
    """

    method: str = "highlights"
    level: float = None  # type: ignore[assignment]  # a number from the start on
    percentile: float = 99.0
    longest: float | None = None
    most_gain: float = 1.0

    def __post_init__(self):
        check_known("exposure method", self.method, METHODS)
        if self.level is None:
            object.__setattr__(self, "level", FILLED * MIDDLE_GREY if self.averages else FILLED)
        check_fields("auto_exposure", self, LIMITS)
        if self.most_gain > 1 and self.longest is None:
            raise BadData(
                f"auto_exposure.most_gain = {self.most_gain:.6g} without longest: the gain rises if the "
                "longest exposure time is too short; wanted both"
            )

    @property
    def averages(self) -> bool:
        """True if the method brings an average to the level, False if a bright pixel."""
        return self.method in ("mean", "centre")

    @property
    def white(self) -> float:
        """Signal of a perfect white diffuser, or the brightest surface, over saturation [1].

        At most 1. Pictures of a camera have display white at this signal. The metered scene then
        has its normal brightness at the metered exposure, and is darker or brighter at others.
        "highlights", "full" and "percentile" bring a bright pixel to the level and take it as
        white: the result is `level`. "mean" and "centre" bring an average to the level and take it
        as MIDDLE_GREY, the mean reflectance of scenes: white, with reflectance 1, is at level /
        MIDDLE_GREY, or saturated. The average includes all colours of the mosaic, while the
        strongest channel defines white; grey therefore comes out slightly brighter.
        """
        return min(self.level / MIDDLE_GREY, 1.0) if self.averages else self.level

    def signal(self, electron_rate: ArrayLike) -> float:
        """Return the signal that the method brings to the level.

        Args:
            electron_rate: Electrons per second of each pixel [e- s-1], shape (..., rows, cols).

        Returns:
            The signal [e- s-1].
        """
        rate = np.asarray(electron_rate)
        if self.method == "full":
            return float(rate.max())
        if self.method == "mean":
            return float(rate.mean(dtype=np.float64))
        if self.method == "percentile":
            return float(np.percentile(rate, self.percentile))
        if self.method == "highlights":
            return without_highlights(
                float(np.percentile(rate, 100 * self.fractions[0])), float(rate.max())
            )
        down, right = map(_center_weights, rate.shape[-2:])
        return float(np.mean(down @ rate.astype(np.float64) @ right))

    @property
    def fractions(self) -> tuple[float, ...]:
        """Quantiles that `LightStatistics` must contain, as fractions of the pixels."""
        return {"percentile": (self.percentile / 100,), "highlights": (1 - HIGHLIGHTS,)}.get(
            self.method, ()
        )

    def weights(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights of method "centre" along both axes; their products add up to 1.

        Args:
            shape: Shape of the frame, (..., rows, cols). Layers are stacked along the rows.

        Returns:
            Weights of rows, shape (layers rows,), and of columns, shape (cols,).
        """
        down, right = map(_center_weights, shape[-2:])
        layers = prod(shape[:-2])
        return np.tile(down / layers, layers), right

    def signal_of(self, statistics: LightStatistics) -> float:
        """Return the same as `signal`, from the statistics of the pixels.

        Args:
            statistics: Statistics of electrons per second, with the quantiles `fractions`.

        Returns:
            The signal [e- s-1].

        Raises:
            BadData: The light is not finite.
        """
        highest, mean, _, centre, missing, _, *pair = statistics.values
        if missing:
            raise BadData(
                f"automatic exposure: {missing:.0f} of {statistics.pixels} pixels have NaN or infinite light"
            )
        if pair:  # as numpy.percentile rounds
            place = (statistics.pixels - 1) * self.fractions[0]
            low, high = pair
            part = place - floor(place)
            found = float(
                low + (high - low) * part if part < 0.5 else high - (high - low) * (1 - part)
            )
            return (
                found if self.method == "percentile" else without_highlights(found, float(highest))
            )
        return float({"full": highest, "mean": mean, "centre": centre}[self.method])

    def choose(
        self, electron_rate: ArrayLike | LightStatistics, saturation: float
    ) -> tuple[float, float]:
        """Choose exposure time and analog gain.

        Args:
            electron_rate: Mean electrons per second of each pixel, from light and dark current [e-
                s-1], shape (..., rows, cols), or their LightStatistics.
            saturation: Electrons at which a pixel saturates with an analog gain of 1 [e-]
                (`Sensor.saturation`).

        Returns:
            Exposure time [s] and analog gain [1].

        Raises:
            BadData: The scene is dark, or its light is not finite.
            OutOfRange: The saturation is not positive and finite.
        """
        if not 0 < saturation < np.inf:
            raise OutOfRange("saturation", f"{saturation} e-", "0 < saturation < inf")
        if isinstance(electron_rate, LightStatistics):
            rate = self.signal_of(electron_rate)
        else:
            rate = self.signal(electron_rate)
        if not 0 < rate < np.inf:
            raise BadData(
                f"automatic exposure: the {self.method} signal is {rate:.4g} e-/s; a dark scene needs "
                "exposure_time_ms in the camera file"
            )
        time = self.level * saturation / rate
        if self.longest is None or time <= self.longest:
            return time, 1.0
        return self.longest, min(time / self.longest, self.most_gain)


def _center_weights(count):
    """Return Gaussian weights of sum 1 of `count` rows or columns."""
    weights = np.exp(-0.5 * (((np.arange(count) + 0.5) / count - 0.5) / CENTRE) ** 2)
    return weights / weights.sum()


def without_highlights(rest: float, brightest: float) -> float:
    """Return the signal that "highlights" brings to the level.

    The brightest pixel counts up to PLAIN times the rest: nothing clips. Above that it is a glint
    or a lamp in a picture: the rest counts and the glint clips. From LAMPS times on, bright pixels
    are the picture (stars, for example), and from LAMPS^2 times on the brightest pixel counts
    again. The result is continuous in the ratio of the two.

    Args:
        rest: Quantile that exceeds all but HIGHLIGHTS of the pixels.
        brightest: The brightest pixel.

    Returns:
        The signal, in the unit of the arguments.
    """
    if not PLAIN * rest < brightest < LAMPS**2 * rest:
        return brightest
    ratio = brightest / rest
    return rest * max(1.0, PLAIN**2 / ratio, (ratio / LAMPS) ** 2)


def auto_exposure(
    electron_rate, saturation: float, level: float | None = None, method: str = "full"
) -> float:
    """Return the exposure time at which the signal of a method reaches `level` of saturation.

    Args:
        electron_rate: See `AutoExposure.choose`.
        saturation: See `AutoExposure.choose`.
        level: See `AutoExposure`; None: its default.
        method: See `AutoExposure`.

    Returns:
        Exposure time [s].

    Raises:
        BadData: See `AutoExposure.choose`.
        OutOfRange: See `AutoExposure` and `AutoExposure.choose`.
        UnknownName: The method is not known.
    """
    automatic = AutoExposure(method) if level is None else AutoExposure(method, level)
    return automatic.choose(np.atleast_2d(electron_rate), saturation)[0]


TIME = re.compile(r"(\d+\.?\d*(?:e[+-]?\d+)?|\.\d+)(?:/(\d+\.?\d*))? ?(s|ms|us)?", re.ASCII)
PER_SECOND = {None: 1.0, "s": 1.0, "ms": 1e3, "us": 1e6}


def parse_seconds(text: str) -> float:
    """Return the seconds of a time like 1/60, 0.01, 10ms or 500us. Raise ValueError."""
    match = TIME.fullmatch(text)
    time = (
        float(match[1]) / float(match[2] or 1) / PER_SECOND[match[3]]
        if match and float(match[2] or 1)
        else 0.0
    )
    if not 0 < time <= LONGEST:
        raise ValueError(
            f"{text!r}: wanted seconds such as 1/60 or 0.01, 10ms, 500us, above 0 and up to {LONGEST:g} "
            "s, or auto"
        )
    return time
