"""Motion of a camera in front of a scene: along a path, and by hand shake."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite, log, pi
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import View

WAVES = 24  # number of waves of a shake along each axis
SLOWEST, FASTEST = 0.5, 12.0  # [Hz] frequencies of a hand: from sway to tremor
PLAIN = View()
ROLL = 1e-3  # [rad/pixel] rotation by a hand per displacement, for a frame 1000 pixels wide


@dataclass(frozen=True)
class Motion:
    """View of a camera as a function of time.

    Args:
        pan: Speed of the scene point at the centre of the frame, along rows and columns
            [pixel/s].
        roll: Rotation speed of the camera [rad/s].
        zoom: Magnification at time 0 [1].
        zooming: Factor on the magnification per second [1].
        shake: RMS displacement by a hand along each axis [pixel]: a sum of waves of SLOWEST to
            FASTEST with amplitudes inverse to frequency, and rotations of ROLL.
        seed: Seed of the shake.
        travel: Speed of the camera's place down, right and ahead [m/s]: near things move more than
            far ones, so the scene needs depth.
        base: View of the scene at rest, before which the camera moves; see `through`.

    Raises:
        BadData: A value is no finite number.
        OutOfRange: A value is outside its range.
    """

    pan: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    zoom: float = 1.0
    zooming: float = 1.0
    shake: float = 0.0
    seed: int = 0
    travel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base: View = field(default=PLAIN, repr=False)

    def __post_init__(self):
        try:
            numbers = [
                float(part)
                for part in (
                    *self.pan,
                    self.roll,
                    self.zoom,
                    self.zooming,
                    self.shake,
                    *self.travel,
                )
            ]
        except (TypeError, ValueError):
            raise BadData(f"motion = {self!r}: wanted numbers") from None
        if (len(self.pan), len(self.travel)) != (2, 3) or not all(map(isfinite, numbers)):
            raise BadData(
                f"motion = {self!r}: wanted finite numbers, two of them for pan and three for travel"
            )
        if not self.shake >= 0:
            raise OutOfRange("motion.shake", self.shake, "0 or more pixels")
        if not self.zooming > 0:
            raise OutOfRange("motion.zooming", self.zooming, "a factor above 0")
        self.at(0.0)

    def place(self, time: float) -> tuple[float, float, float]:
        """Return how far the camera has moved at one time.

        Args:
            time: Time [s].

        Returns:
            Down, right and ahead [m].
        """
        down, right, ahead = (float(speed) * time for speed in self.travel)
        return down, right, ahead

    def at(self, time: float) -> View:
        """Return the view at one time.

        Args:
            time: Time [s].

        Returns:
            The view.

        Raises:
            OutOfRange: Shift or zoom of the view is outside its range, see `View`.
        """
        down, right, turn = map(float, self._shake_at(time))
        own = View(
            (self.pan[0] * time + down, self.pan[1] * time + right),
            self.roll * time + turn,
            self.zoom * self.zooming**time,
        )
        return own if self.base.is_plain else self.base.compose(own)

    def places(self, times: Any, y: Any, x: Any, ratio: float = 1.0) -> tuple[Any, Any]:
        """Return the scene positions that frame positions show at times, as `at(time).place(y, x, ratio)` does.

        Args:
            times: Times [s], a number or an array, as y and x are.
            y: Rows of the frame, relative to its centre [sample].
            x: Columns of the frame [sample].
            ratio: Scene samples per pixel.

        Returns:
            Rows and columns of the scene, relative to its centre [sample].
        """
        times = np.asarray(times, np.float64)
        down, right, turn = self._shake_at(times)
        angle, zoom = self.roll * times + turn, self.zoom * self.zooming**times
        c, s = np.cos(angle) / zoom, np.sin(angle) / zoom
        rows = c * y + s * x + ratio * (self.pan[0] * times + down)
        return self.base.place(rows, c * x - s * y + ratio * (self.pan[1] * times + right), ratio)

    def through(self, view: View) -> "Motion":
        """Return the same motion of the frame that a view shows.

        Args:
            view: View of a scene at rest.

        Returns:
            The motion, whose views are composed with this one.
        """
        return self if view.is_plain else replace(self, base=view)

    def _shake_at(self, times):
        """Return the displacement by hand shake, of the shape of times: rows, columns [pixel], rotation [rad]."""
        if not self.shake:
            return 0.0, 0.0, 0.0
        frequency, amplitude, phase = self._waves
        times = np.asarray(times)[..., None, None]
        moves = (amplitude * np.sin(2 * pi * frequency * times + phase)).sum(axis=-1)
        return np.moveaxis(self.shake * moves * (1, 1, ROLL), -1, 0)

    @cached_property
    def _waves(self):
        """Frequencies [Hz], amplitudes and phases of the waves along three axes, RMS 1 each."""
        random = np.random.Generator(np.random.Philox(self.seed))
        place = (np.arange(WAVES) + random.random((3, WAVES))) / WAVES
        frequency = SLOWEST * np.exp(place * log(FASTEST / SLOWEST))
        amplitude = 1 / frequency
        amplitude *= np.sqrt(2 / np.square(amplitude).sum(axis=1, keepdims=True))
        return frequency, amplitude, 2 * pi * random.random((3, WAVES))
