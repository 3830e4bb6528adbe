"""How a camera moves before a scene: along a path, and as a hand shakes it."""

from dataclasses import dataclass
from functools import cached_property
from math import isfinite, log, pi

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.view import View

WAVES = 24  # of a shake along each axis
SLOWEST, FASTEST = 0.5, 12.0  # [Hz] of a hand: from sway to tremor
ROLL = 1e-3  # [rad] that a hand turns a camera for a pixel that it moves it, of a frame a thousand pixels wide


@dataclass(frozen=True)
class Motion:
    """View of a camera at every time.

    pan: rows and columns a second by which what is in the middle of the frame moves [pixel/s]. roll: of the camera
    [rad/s]. zoom: magnification at time 0. zooming: factor by which it grows in a second. shake: root mean square of a
    hand's displacement along each axis [pixel]: waves of SLOWEST to FASTEST, as strong as they are slow, and turns of
    ROLL with them. seed: of the shake.
    Raises BadData, OutOfRange.
    """

    pan: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    zoom: float = 1.0
    zooming: float = 1.0
    shake: float = 0.0
    seed: int = 0

    def __post_init__(self):
        try:
            numbers = [
                float(part) for part in (*self.pan, self.roll, self.zoom, self.zooming, self.shake)
            ]
        except (TypeError, ValueError):
            raise BadData(f"motion = {self!r}: wanted numbers") from None
        if len(numbers) != 6 or not all(map(isfinite, numbers)):
            raise BadData(f"motion = {self!r}: wanted finite numbers, two of them for pan")
        if not self.shake >= 0:
            raise OutOfRange("motion.shake", self.shake, "0 or more pixels")
        if not self.zooming > 0:
            raise OutOfRange("motion.zooming", self.zooming, "a factor above 0")
        self.at(0.0)

    def at(self, time: float) -> View:
        """What the camera sees at a time [s]. Raises OutOfRange where that is too wide a view."""
        down, right, turn = self._shaken(time)
        return View(
            (self.pan[0] * time + down, self.pan[1] * time + right),
            self.roll * time + turn,
            self.zoom * self.zooming**time,
        )

    def _shaken(self, time):
        if not self.shake:
            return 0.0, 0.0, 0.0
        frequency, amplitude, phase = self._waves
        moves = (amplitude * np.sin(2 * pi * frequency * time + phase)).sum(axis=1)
        return tuple(float(move) for move in self.shake * moves * (1, 1, ROLL))

    @cached_property
    def _waves(self):
        """Frequencies [Hz], amplitudes and phases of the waves of three axes, each of a root mean square of 1."""
        random = np.random.Generator(np.random.Philox(self.seed))
        place = (np.arange(WAVES) + random.random((3, WAVES))) / WAVES
        frequency = SLOWEST * np.exp(place * log(FASTEST / SLOWEST))
        amplitude = 1 / frequency
        amplitude *= np.sqrt(2 / np.square(amplitude).sum(axis=1, keepdims=True))
        return frequency, amplitude, 2 * pi * random.random((3, WAVES))
