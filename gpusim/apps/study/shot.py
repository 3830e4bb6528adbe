"""The picture of one camera in one scene, for measures: each part is fetched at its first use."""

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gpusim.color.rendering import Rendering
from gpusim.domain.camera import Camera

if TYPE_CHECKING:
    from gpusim.apps.study.scenes import IdealPicture, StudyScene
    from gpusim.pipeline.loop import Loop


class Shot:
    """One picture. `gpusim.measure` takes it like a `Frame`.

    Args:
        loop: The loop that makes it; valid until its next update.
        place: The scene.
        seed: Seed of the noise.
        number: Number of the frame.
    """

    def __init__(self, loop: "Loop", place: "StudyScene", seed: int, number: int):
        self._loop, self.place, self.seed, self.number = loop, place, seed, number
        self._exposure = loop.expose()
        self.kept: dict[str, float] = {}  # numbers that several measures use

    def __repr__(self):
        return f"Shot({self.place.name!r} by {self.camera!r})"

    @property
    def scene(self):
        """The scene."""
        return self.place.scene

    @property
    def camera(self) -> Camera:
        """The camera as operated: its sensor is binned and has the chosen analog gain."""
        return self._exposure.camera

    @property
    def exposure_time(self) -> float:
        """Exposure time [s]."""
        return self._exposure.exposure_time

    def _fetch(self, name):
        return np.array(
            self._loop.simulator.device.numpy(
                self._loop.output(name, seed=self.seed, first=self.number)
            )
        )

    @cached_property
    def raw(self) -> np.ndarray:
        """Digital numbers (rows, cols) or, for stacked pixels, (C, rows, cols) [DN]."""
        return self._layers(self._fetch("raw"))

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean electrons without noise, float32, of the scene's pixels [e-]."""
        return self._fetch("mean")

    @cached_property
    def codes(self) -> np.ndarray:
        """Display codes (rows, cols, 3), uint8."""
        return self._fetch("codes")

    @cached_property
    def _linear(self) -> tuple[np.ndarray, Rendering]:
        shown, rendering = self._loop.linear(seed=self.seed, first=self.number)
        return np.array(self._loop.simulator.device.numpy(shown)), rendering

    @property
    def planes(self) -> np.ndarray:
        """Linear display RGB before the tone curve, float32 (3, rows, cols)."""
        return self._linear[0]

    @property
    def linear(self) -> np.ndarray:
        """`planes` with the channels last, (rows, cols, 3)."""
        return np.moveaxis(self.planes, 0, -1)

    @property
    def rendering(self) -> Rendering:
        """Conversion to colours."""
        return self._linear[1]

    @cached_property
    def shown(self) -> np.ndarray:
        """`planes` with the exposure divided out, clipped to the display's range, float32."""
        return np.clip(self.planes * np.float32(1 / self.rendering.diffuser), 0, 1)

    @property
    def ideal(self) -> "IdealPicture":
        """The picture of the scene on the display, without lens and noise."""
        return self.place.ideal_on(self.camera.display, self.planes.shape[1:])

    def channels_of_patch(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield, for each place of the mosaic, raw values above the black level and their noise-free shape.

        They are of the scene's even patch. The noise-free shape is 1 if the pixels are binned.
        """
        sensor, (top, left, bottom, right) = self.camera.sensor, self.place.even_patch()
        raw = np.atleast_3d(self.raw.T).T  # (C, rows, cols)
        mean = np.atleast_3d(self.mean.T).T
        down, across = (raw.shape[axis] / self.scene.shape[axis - 1] for axis in (1, 2))
        high, wide = (1, 1) if sensor.stacked else (len(sensor.cfa), len(sensor.cfa[0]))
        cut = np.s_[int(top * down) : int(bottom * down), int(left * across) : int(right * across)]
        for layer in range(len(raw)):
            part = raw[layer][cut].astype(np.float64) - sensor.black_level
            true = mean[layer][cut].astype(np.float64) if mean.shape == raw.shape else None
            for row in range(high):
                for col in range(wide):
                    own = part[row::high, col::wide]
                    light = np.ones(own.shape) if true is None else true[row::high, col::wide]
                    if own.size > 1:
                        yield own, light if light.mean() > 0 else np.ones(own.shape)

    def _layers(self, raw):
        """Return raw values with layers of stacked pixels on a first axis."""
        sensor = self.camera.sensor
        if not sensor.stacked:
            return raw
        return raw.reshape(len(sensor.channels), -1, raw.shape[1])
