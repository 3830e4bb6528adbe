"""How long a camera will expose a scene, before any frame: what the noise is that errors are measured in."""

from dataclasses import dataclass
from math import erf

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
        """Electrons of the frame's root mean square, at least one."""
        return max(self.seconds * self.size, 1.0)

    @classmethod
    def of(cls, camera, facts: Facts, weights, brightness, level: float, peak: float, q: float) -> "Operation":
        """For the light of a scene without blur.

        weights: of the channels, (C, L). brightness: sums over them, (rows, cols). level: its root mean square as the
        lens shows it. peak: of points split off it. q: of the lens, at the mean wavelength.
        """
        sensor, pairs = camera.sensor, facts.pairs
        rates = pairs.mixed(weights @ pairs.entry_spectra.T)
        if not sensor.stacked:
            cfa = sensor.cfa_indices
            rows, cols = np.arange(rates.shape[1])[:, None], np.arange(rates.shape[2])
            channel = cfa[rows % cfa.shape[0], cols % cfa.shape[1]]  # the period's rows in turn
            rates = np.take_along_axis(rates, channel[None], 0)
        looked = pairs.brightness(weights.sum(axis=0))
        light = float(np.sqrt(np.mean(np.square(looked, dtype=np.float64))))
        size = float(np.sqrt(np.mean(rates**2))) * (level / light if light > 0 else 1.0)
        seconds = sensor.exposure_time
        if seconds is None:
            middle = erf(0.5 / (0.42 * np.sqrt(2) * max(q, 0.05))) ** 2  # of a point's light, in its own pixel
            highest = max(float(brightness.max()), peak * middle)
            dark = sensor.noise.dark_current * sensor.noise.warmth
            try:
                seconds = sensor.auto_exposure.choose(rates + dark, sensor.saturation)[0]
                if sensor.auto_exposure.method == "full" and highest > 0:
                    seconds *= min(float(looked.max()) / highest, 1.0)
            except BadData:  # a dark scene: whoever exposes it says so
                seconds = 1.0
        return cls(float(seconds), size, float(sensor.read_sigma**2))
