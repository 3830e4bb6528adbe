"""Light that flickers: lamps on the mains, and dimmed ones that are switched."""

from dataclasses import dataclass, replace
from math import inf, pi
from numbers import Real

import numpy as np

from gpusim.domain.errors import OutOfRange, shown

FASTEST = 1e7  # [Hz]


@dataclass(frozen=True)
class Flicker:
    """Brightness of all light over time, 1 in the mean.

    frequency: of the light [Hz]: twice that of the mains. depth: of a sinusoid, (most - least) / (most + least).
    duty: part of the time in which switched light is on, in place of a sinusoid; None: a sinusoid. phase: part of a
    period that has gone by at time 0: a sinusoid is brightest, switched light goes on, at phase 0.
    Source: IEEE Std 1789-2015 for the words. Raises OutOfRange.
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
                raise OutOfRange(f"flicker.{name}", shown(value), "a number")
            value = float(value)
            if not (low <= value <= high and np.isfinite(value)) or (
                name == "frequency" and not value
            ):
                least = "above 0" if name == "frequency" else f"{low:g}"
                raise OutOfRange(f"flicker.{name}", value, f"{least} .. {high:g}")
        if self.duty is not None and not 0 < self.duty <= 1:
            raise OutOfRange("flicker.duty", self.duty, "0 < duty <= 1")

    def since(self, start: float) -> "Flicker":
        """The same on a clock that is at 0 at a time [s] of this one."""
        return replace(self, phase=(self.phase + self.frequency * start) % 1)

    def integrals(self, times) -> tuple[np.ndarray, np.ndarray]:
        """Of the brightness, and of the brightness times the time, from 0 to the times [s]: shape of the times each."""
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
            for now, then in zip(self._switched(times + begun), self._switched(begun), strict=True)
        )
        return whole, moment - whole * begun

    def _switched(self, times):
        """The same of light that goes on at time 0."""
        periods = np.floor(times * self.frequency)
        part = np.clip(
            times * self.frequency - periods, 0, self.duty
        )  # of this period in which it was on
        whole = (periods + part / self.duty) / self.frequency
        moment = (
            periods * (periods - 1) / 2
            + periods * self.duty / 2
            + (periods * part + part**2 / 2) / self.duty
        )
        return whole, moment / self.frequency**2
