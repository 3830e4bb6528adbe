"""Flickering light: lamps on mains power, and dimmed lamps that are switched."""

from dataclasses import dataclass, replace
from math import inf, pi
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import OutOfRange, format_value

FASTEST = 1e7  # [Hz]


@dataclass(frozen=True)
class Flicker:
    """Relative brightness of all light over time, with mean 1.

    Args:
        frequency: Frequency of the light [Hz], twice the mains frequency.
        depth: Modulation of a sinusoid, (max - min) / (max + min) [1].
        duty: Fraction of the period in which switched light is on, or None for a sinusoid.
        phase: Fraction of a period that has passed at time 0. At phase 0 a sinusoid is brightest,
            and switched light turns on.

    Raises:
        OutOfRange: A number is outside its range.

    Source:
        IEEE Std 1789-2015 for the terms.
    """

    frequency: float
    depth: float = 1.0
    duty: float | None = None
    phase: float = 0.0

    def __post_init__(self):
        for name, low, high in (
            ("frequency", 0.0, FASTEST),
            ("depth", 0.0, 1.0),
            ("phase", -inf, inf),
        ):
            value = getattr(self, name)
            if not isinstance(value, Real):
                raise OutOfRange(f"flicker.{name}", format_value(value), "a number")
            value = float(value)
            if not (low <= value <= high and np.isfinite(value)) or (
                name == "frequency" and not value
            ):
                least = "above 0" if name == "frequency" else f"{low:g}"
                raise OutOfRange(f"flicker.{name}", value, f"{least} .. {high:g}")
        if self.duty is not None and not 0 < self.duty <= 1:
            raise OutOfRange("flicker.duty", self.duty, "0 < duty <= 1")

    def since(self, start: float) -> "Flicker":
        """Return the flicker on a clock that starts later.

        Args:
            start: Time at which the new clock is at 0 [s].

        Returns:
            The same light with another phase.
        """
        return replace(self, phase=(self.phase + self.frequency * start) % 1)

    def integrals(self, times: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Integrate the brightness, and the brightness times the time, from 0 on.

        Args:
            times: Upper ends of the integrals [s].

        Returns:
            Both integrals [s] and [s^2], each in the shape of `times`.
        """
        times = np.asarray(times, np.float64)
        if self.duty is None:
            turn = 2 * pi * self.frequency
            start, angle = 2 * pi * self.phase, turn * times + 2 * pi * self.phase
            whole = times + self.depth * (np.sin(angle) - np.sin(start)) / turn
            moment = times * np.sin(angle) / turn + (np.cos(angle) - np.cos(start)) / turn**2
            return whole, times**2 / 2 + self.depth * moment
        begun = self.phase / self.frequency  # the phase moves the time
        whole, moment = (
            now - then
            for now, then in zip(
                self._integrate_pulses(times + begun),
                self._integrate_pulses(begun),
                strict=True,
            )
        )
        return whole, moment - whole * begun

    def _integrate_pulses(self, times):
        """Return both integrals for switched light that turns on at time 0."""
        periods = np.floor(times * self.frequency)
        # part of this period in which it was on
        part = np.clip(times * self.frequency - periods, 0, self.duty)
        whole = (periods + part / self.duty) / self.frequency
        moment = (
            periods * (periods - 1) / 2
            + periods * self.duty / 2
            + (periods * part + part**2 / 2) / self.duty
        )
        return whole, moment / self.frequency**2
