"""How long a camera will expose a scene, before any frame: what the noise is that errors are measured in."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.planner.facts import Facts


@dataclass(frozen=True)
class Operation:
    """How a camera is operated.

    seconds: exposure time [s]. size: root mean square of the mosaic [e- s-1]. noise: variance of the read noise [e-2].
    """

    seconds: float
    size: float
    noise: float

    @property
    def level(self) -> float:
        """Electrons of the frame's root mean square."""
        return max(self.seconds * self.size, 1e-30)

    @classmethod
    def of(
        cls,
        camera,
        facts: Facts,
        weights,
        level: float,
        highest: float,
        exposure_time: float | None = None,
    ) -> "Operation":
        """For the light of a scene.

        weights: of the channels, (C, L). level, highest: root mean square and maximum over the frame of the sums over
        the channels, as the lens shows them. exposure_time: given, in place of the camera's [s].
        """
        sensor, rates = camera.sensor, facts.channels(weights)
        looked = rates.sum(axis=0)
        if not sensor.stacked:
            cfa = sensor.cfa_indices
            rows, cols = np.arange(rates.shape[1])[:, None], np.arange(rates.shape[2])
            channel = cfa[rows % cfa.shape[0], cols % cfa.shape[1]]  # the period's rows in turn
            rates = np.take_along_axis(rates, channel[None], 0)
        light = float(np.sqrt(np.mean(looked**2)))
        size = float(np.sqrt(np.mean(rates**2))) * (level / light if light > 0 else 1.0)
        seconds = sensor.exposure_time if exposure_time is None else exposure_time
        if seconds is None:
            dark = sensor.noise.dark_current * sensor.noise.warmth
            try:
                automatic, brightest = sensor.auto_exposure, float(looked.max())
                if automatic.method == "highlights" and brightest > 0:
                    top = (
                        rates.max() * highest / brightest
                    )  # the frame's brightest need not be among these samples
                    rates = np.append(np.minimum(rates, top), top)
                seconds = automatic.choose(rates + dark, sensor.saturation)[0]
                if automatic.method == "full" and highest > 0:
                    seconds *= brightest / highest
            except BadData:  # a dark scene: whoever exposes it says so
                seconds = 1.0
        return cls(float(seconds), size, float(sensor.read_sigma**2))
