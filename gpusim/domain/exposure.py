"""How long to expose: exposure values, automatic exposure, brackets."""

from dataclasses import dataclass
from math import floor, prod
from numbers import Real
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName, check_range, is_known

METHODS = ("highlights", "full", "percentile", "mean", "centre")
LONGEST = 1e12  # [s]
MOST_GAIN = 1e4  # analog gain beside the sensor's
MIDDLE_GREY = 0.18  # reflectance of a photographer's grey card
FILLED = 0.95  # of saturation: where a bright pixel is put by default
HIGHLIGHTS = 0.001  # share of the pixels that may be highlights: one glint in 10,000 pixels, blurred over ten
PLAIN = 1.5  # times the rest's brightest pixel, up to which a few pixels are a part of the picture: half a stop
LAMPS = 100.0  # times the same, beyond which they are lamps in the dark
CENTRE = 0.2  # standard deviation of the centre's weight over the frame's height and width


def exposure_value(f_number, exposure_time) -> Any:
    """Exposure value [stop], EV = log2(N^2 / T), of f-number N [1] and exposure time T [s].

    Arrays broadcast. Source: Farrell and Wandell, Image Systems Simulation, section 5.7.
    """
    return np.log2(np.square(f_number) / exposure_time)


def exposure_time(value, f_number):
    """Exposure time [s] of an exposure value [stop] at f-number N, T = N^2 / 2^EV: the inverse of `exposure_value`."""
    return np.square(f_number) / np.exp2(value)


def checked_time(time: float | None) -> float | None:
    """Return an exposure time [s], or None for the camera's own, as it is. Raises OutOfRange."""
    if time is not None and not (isinstance(time, Real) and 0 < time <= LONGEST):
        raise OutOfRange("exposure_time", f"{time} s", f"0 < exposure_time <= {LONGEST:g} s")
    return time


def checked_gain(gain: float) -> float:
    """Return an analog gain beside the sensor's [1] as it is. Raises OutOfRange."""
    if not (isinstance(gain, Real) and 0 < gain <= MOST_GAIN):
        raise OutOfRange("gain", gain, f"0 < gain <= {MOST_GAIN:g}")
    return gain


def bracket_times(time: float, stops) -> np.ndarray:
    """Exposure times [s] that are `stops` brighter than `time` [s], time 2^stops. Raises BadData, OutOfRange."""
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
    """Statistics of a frame's light, as `gpusim.kernels.sensor.meter` gives them.

    values: its result, for the weights and fractions of the AutoExposure that is to choose by it, shape (6 + 2 Q,).
    pixels: how many it is of.
    """

    values: np.ndarray
    pixels: int

    def over(self, seconds: float) -> "LightStatistics":
        """Those of electrons a second, from those of `seconds` [s]."""
        values = self.values.copy()
        scaled = np.arange(len(values)) != 4  # all but the count
        values[scaled] /= np.float32(seconds)
        return LightStatistics(values, self.pixels)

    def plus(self, rate: float) -> "LightStatistics":
        """The same with `rate` [e- s-1] more in every pixel; of weights whose products add up to 1."""
        values, more = self.values.copy(), np.float32(rate)
        mean, root, added = (float(value) for value in (values[1], values[2], more))
        values[2] = max(root**2 + 2 * mean * added + added**2, 0.0) ** 0.5
        values[[0, 1, 3, 5]] += more
        values[6:] += more  # adding to what is sorted leaves it sorted
        return LightStatistics(values, self.pixels)


@dataclass(frozen=True)
class AutoExposure:
    """How an exposure time and an analog gain are chosen from the light.

    method: what is brought to `level` of saturation [1]: "highlights" the brightest pixel but for a thousandth of them,
        see `without_highlights`; "full" the brightest pixel, so that nothing clips; "percentile" the `percentile`-th of
        the pixels [%], so that a few lamps may clip; "mean" the average; "centre" the average weighted by a Gaussian
        about the frame's middle.
    level: by default 0.95 for a bright pixel, and for an average 0.95 x 18 %, so that white is at 0.95.
    longest: exposure time at most [s], None: any. Where it is too short the analog gain is raised, up to most_gain [1].
    Raises BadData, OutOfRange, UnknownName.
    """

    method: str = "highlights"
    level: float = None  # type: ignore[assignment]  # a number from the start on
    percentile: float = 99.0
    longest: float | None = None
    most_gain: float = 1.0

    def __post_init__(self):
        if not is_known(self.method, METHODS):
            raise UnknownName("exposure method", str(self.method), METHODS)
        if self.level is None:
            object.__setattr__(self, "level", FILLED * MIDDLE_GREY if self.averages else FILLED)
        check_range("auto_exposure", self, "level", "0 < level <= 1", lambda value: 0 < value <= 1)
        check_range(
            "auto_exposure",
            self,
            "percentile",
            "0 < percentile <= 100",
            lambda value: 0 < value <= 100,
            "%",
        )
        check_range(
            "auto_exposure",
            self,
            "longest",
            "0 < longest <= 1e12",
            lambda value: 0 < value <= 1e12,
            "s",
        )
        check_range(
            "auto_exposure",
            self,
            "most_gain",
            "1 <= most_gain <= 1e4",
            lambda value: 1 <= value <= 1e4,
        )
        if self.most_gain > 1 and self.longest is None:
            raise BadData(
                f"auto_exposure.most_gain = {self.most_gain:.6g} without longest: the gain rises where the "
                "longest exposure time is too short; wanted both"
            )

    @property
    def averages(self) -> bool:
        """Whether an average is brought to the level, and not a bright pixel."""
        return self.method in ("mean", "centre")

    @property
    def white(self) -> float:
        """Where this metering puts a perfect white diffuser, or the brightest surface, over saturation [1], at most 1.

        A camera's picture has display white there, so that what it meters looks as it should at its own exposure and
        too dark or too bright at another. "highlights", "full" and "percentile" bring a bright pixel to the level and
        take it for white: level. "mean" and "centre" bring an average to it and take that for MIDDLE_GREY, the mean
        reflectance of scenes: white, of reflectance 1, is then at level / MIDDLE_GREY, or beyond saturation. An average
        is over all colours of the mosaic, so that the strongest, whose value counts, makes grey a little brighter than
        that.
        """
        return min(self.level / MIDDLE_GREY, 1.0) if self.averages else self.level

    def signal(self, electron_rate) -> float:
        """What is brought to the level [e- s-1], of electrons per second and pixel, shape (..., rows, cols)."""
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
        down, right = self._centred(rate.shape)
        return float(np.mean(down @ rate.astype(np.float64) @ right))

    @property
    def fractions(self) -> tuple[float, ...]:
        """Of the pixels, from the darkest on: the quantiles that are asked of `LightStatistics`."""
        return {"percentile": (self.percentile / 100,), "highlights": (1 - HIGHLIGHTS,)}.get(
            self.method, ()
        )

    def weights(self, shape) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the "centre" along both axes of a frame of shape (..., rows, cols); their products add up to 1.

        Shapes (layers rows,) and (cols,): the frame's layers lie one below the other.
        """
        down, right = self._centred(shape)
        layers = prod(shape[:-2])
        return np.tile(down / layers, layers), right

    @staticmethod
    def _centred(shape):
        weights = [
            np.exp(-0.5 * (((np.arange(n) + 0.5) / n - 0.5) / CENTRE) ** 2) for n in shape[-2:]
        ]
        return [weight / weight.sum() for weight in weights]

    def signal_of(self, statistics: LightStatistics) -> float:
        """The same as `signal` of the statistics of the pixels. Raises BadData for light that is not finite."""
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

    def choose(self, electron_rate, saturation: float) -> tuple[float, float]:
        """Exposure time [s] and analog gain [1].

        electron_rate: mean electrons per second of every pixel, of light and dark current [e- s-1], shape (..., rows,
            cols); or their LightStatistics.
        saturation: electrons at which a pixel stops counting at an analog gain of 1 [e-] (`Sensor.saturation`).
        Raises BadData when there is no light to expose for or some that is not finite, OutOfRange.
        """
        if not 0 < saturation < np.inf:
            raise OutOfRange("saturation", f"{saturation} e-", "0 < saturation < inf")
        metered = isinstance(electron_rate, LightStatistics)
        rate = self.signal_of(electron_rate) if metered else self.signal(electron_rate)
        if not 0 < rate < np.inf:
            raise BadData(
                f"automatic exposure: the {self.method} signal is {rate:.4g} e-/s; a dark scene needs "
                "exposure_time_ms in the camera file"
            )
        time = self.level * saturation / rate
        if self.longest is None or time <= self.longest:
            return time, 1.0
        return self.longest, min(time / self.longest, self.most_gain)


def without_highlights(rest: float, brightest: float) -> float:
    """Return the light that "highlights" brings to the level, from the brightest pixel and the brightest of the rest.

    rest: the quantile below which all but HIGHLIGHTS of the pixels lie. Up to PLAIN times as much, the brightest pixel
    counts, and nothing clips. Brighter ones are glints or lamps in a picture: the rest counts, and they clip. From
    LAMPS times on they are the picture, as stars are, and from LAMPS^2 times on the brightest counts again. The result
    is continuous in the ratio of the two.
    """
    if not PLAIN * rest < brightest < LAMPS**2 * rest:
        return brightest
    ratio = brightest / rest
    return rest * max(1.0, PLAIN**2 / ratio, (ratio / LAMPS) ** 2)


def auto_exposure(
    electron_rate, saturation: float, level: float | None = None, method: str = "full"
) -> float:
    """Exposure time [s] at which the signal that `method` of `AutoExposure` names reaches `level` of saturation.

    Arguments, returns and raises as there.
    """
    automatic = AutoExposure(method) if level is None else AutoExposure(method, level)
    return automatic.choose(np.atleast_2d(electron_rate), saturation)[0]
