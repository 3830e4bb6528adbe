"""Photoreceptor of an event camera's pixel: light becomes a voltage with noise.

All signals are in units of the natural logarithm of the light. I is the electrons per second of
light and dark current, Q the charge of an e-fold (`EventSensor.charge`):

- The logarithmic photoreceptor is a pole at a = I / Q [1/s]: slow in dim light.
- Photodiode and feedback transistor carry the same current and have its shot noise: white, 2 / I
  together, before a. Behind the pole its variance is 1 / Q in dim light, independent of the light.
- The amplifier's noise makes its loop charge the photodiode's capacitance. Below a the loop reduces
  it to the share SHARE, above a it does not: (s + SHARE a) / (s + a). So it falls as the light
  grows.
- The source follower has two equal poles b; together they have lost 3 dB at the `cutoff`.

Sources: Delbruck and Mead 1994, "Adaptive photoreceptor with wide dynamic range", ISCAS, for the
circuit; the noise is derived here from its small-signal equations. Hu, Liu and Delbruck 2021, "v2e:
From video frames to realistic DVS events", CVPRW, for the published behaviour that it is compared
with: shot noise events, bandwidth proportional to the light.
"""

from math import ceil, exp, log, pi, sqrt

import numpy as np

SHARE = 0.87  # of the amplifier's noise amplitude remains in bright light; fitted to halve the rate
# source follower time constants: noise held this long loses STEP^2 / 12 = .5 % of its variance
STEP = 0.25
SETTLED = 8.0  # source follower time constants before the first instant
# Noise events per second and hertz of cutoff behind two equal poles, by threshold over standard
# deviation, for a random initial level: own simulation of 8000 pixels, good to 1 % up to 4.5 and
# to 5 % at 6.
RATIOS = np.array((0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 6, 7))
RATES = np.array(
    (9.16, 3.19, 1.47, 0.754, 0.397, 0.212, 0.111, 0.0559, 0.0270, 0.0124, 2.17e-3, 2.5e-4)
)


def noise_deviation(rate: float, cutoff: float, threshold: float, mismatch: float) -> float:
    """Return the standard deviation of the noise [ln] that makes `rate` events per second.

    rate: mean over the pixels [Hz]. cutoff: [Hz]. threshold: mean of the ON and OFF thresholds
    [ln]. mismatch: relative standard deviation of each threshold; pixels with low thresholds make
    most events.
    """
    if rate == 0:
        return 0.0
    ratios = np.linspace(RATIOS[0], RATIOS[-1], 200)
    # over the normal distribution of the pixels' mean thresholds
    places, weights = np.polynomial.hermite_e.hermegauss(7)
    own = np.maximum(ratios[:, None] * (1 + mismatch / sqrt(2) * places), RATIOS[0])
    rates = np.exp(np.interp(own, RATIOS, np.log(RATES))) @ (weights / weights.sum())
    return threshold / float(np.interp(-log(rate / cutoff), -np.log(rates), ratios))


class Photoreceptor:
    """Photoreceptors of all pixels of a chip."""

    def __init__(self, sensor, random):
        """Set up from an EventSensor and a NumPy random generator."""
        self._charge, self._random = sensor.charge, random
        self._pole = 2 * pi * sensor.cutoff / sqrt(sqrt(2) - 1)
        self._step = STEP / self._pole
        deviation = noise_deviation(
            sensor.noise, sensor.cutoff, (sensor.on + sensor.off) / 2, sensor.mismatch
        )
        self._density = 4 * deviation**2 / self._pole  # two-sided, of noise before the two poles
        self._before, self._stages = np.empty(0), [np.empty(0)] * 3

    def begin(self, before: np.ndarray) -> np.ndarray:
        """Return the output at the first instant; before: logarithm of steady light, (pixels,)."""
        rates = np.exp(before)
        # stationary variance behind the first pole: shot noise and the amplifier's reduced part
        variance = (2 / rates + (1 - SHARE) ** 2 * self._density) * rates / self._charge / 2
        first = before + np.sqrt(variance) * self._random.standard_normal(before.shape)
        self._before, self._stages = before, [first, before, before]
        count = ceil(SETTLED / STEP)
        for _ in self._steps(before, before, count, self._step):
            pass
        return self._stages[2]

    def advance(self, now: np.ndarray, seconds: float):
        """Yield (elapsed part, output) at time steps while the light changes linearly.

        now: final logarithm of the light, (pixels,). seconds: duration of the change [s].
        """
        before, self._before = self._before, now
        count = ceil(seconds / self._step)
        yield from self._steps(before, now, count, seconds / count)

    def _steps(self, before, now, count, step):
        """Yield exponential time steps.

        Noise and light are held over a step; each stage sees the mean of the stage before.
        """
        keep = 1 - exp(-self._pole * step)
        steady = np.array_equal(before, now)
        amplifier, shape = sqrt(self._density / step), before.shape
        for number in range(count):
            if not number or not steady:
                light = before + (now - before) * ((number + 0.5) / count)
                rates = np.exp(light)
                turns = rates / self._charge * step
                follows = -np.expm1(-turns)
                late = follows / turns  # share of a change that remains, mean over the step
                shot = np.sqrt(2 / (rates * step))
            own = amplifier * self._random.standard_normal(shape)
            source = light + shot * self._random.standard_normal(shape) - (1 - SHARE) * own
            first, second, third = self._stages
            stage = first + follows * (source - first)
            middle = second + keep * (source + (first - source) * late + own - second)
            self._stages = [stage, middle, third + keep * ((second + middle) / 2 - third)]
            yield (number + 1) / count, self._stages[2]
