"""The variance of a raw value, as a sum of named parts."""

from dataclasses import dataclass
from typing import Any

from gpusim.domain.sensor import FLOAT_BITS, Sensor

ROUNDING = 1 / 12  # variance of rounding to whole digital numbers [DN^2]


@dataclass(frozen=True)
class RawNoise:
    """Parts of the variance of one pixel's raw value, in electrons squared; see `Noise` for what they come from.

    photons: 1, or 0 where electrons are not counted: the variance of a mean electron, of light or dark current [e-].
    read: of a read: reset, readout and converter [e-^2]. lines: row and column noise of one frame [e-^2].
    offsets, line_offsets: fixed patterns of the pixels, and of rows and columns [e-^2]: the same in every frame.
    response, line_response: the same of the relative response [1], times the square of the light's electrons.
    rounding: to a whole digital number, 0 without a converter [e-^2].
    averaged: pixels whose digital numbers' mean a raw value is (digital binning) [1].
    Rows and columns count as if their noise were each pixel's own: what binned pixels share of it averages out less.
    Telegraph noise, hot and dead pixels are no part of it.
    """

    photons: float
    read: float
    lines: float
    offsets: float
    line_offsets: float
    response: float
    line_response: float
    rounding: float
    averaged: int = 1

    @classmethod
    def of(cls, sensor: Sensor, averaged: int = 1) -> "RawNoise":
        """The noise of a sensor as operated; averaged: see the class."""
        noise, gain = sensor.noise, sensor.gain_dn_per_electron
        return cls(
            photons=float(noise.photon != "none"),
            read=sensor.read_sigma**2,
            lines=noise.row**2 + noise.column**2,
            offsets=noise.dsnu**2,
            line_offsets=noise.row_dsnu**2 + noise.column_dsnu**2,
            response=noise.prnu**2,
            line_response=noise.row_prnu**2 + noise.column_prnu**2,
            rounding=0.0 if sensor.bits == FLOAT_BITS else ROUNDING / gain**2,
            averaged=averaged,
        )

    @property
    def rounding_of_mean(self) -> float:
        """Variance of rounding the mean of `averaged` digital numbers to a whole one, 0 for a single one [e-^2].

        The mean of n whole numbers lies k / n from the nearest one. With noise of a digital number or so every k is
        equally likely, -(n - 1) / 2 .. (n - 1) / 2 for odd n: the mean of (k / n)^2 is (1 - 1 / n^2) / 12. For even n
        k goes from -n / 2 to n / 2, of which the two ends, halves, share one place: (1 + 2 / n^2) / 12.
        """
        return self.rounding * (
            1 - self.averaged**-2 if self.averaged % 2 else 1 + 2 * self.averaged**-2
        )

    def variance(self, electrons: Any = 0.0, *, temporal: bool = False) -> Any:
        """Variance of a raw value around `electrons`, a number or an array [e-^2], without PRNU.

        electrons: mean, of light and dark current [e-]. temporal: only what differs from frame to frame.
        """
        fixed = 0.0 if temporal else self.offsets + self.line_offsets
        return self._averaged(self.photons * electrons + self.read + self.lines + fixed)

    def profile(self, full: float) -> tuple[float, float]:
        """(S, O) of the variance S x + O of x = electrons / full, as a DNG's NoiseProfile has it.

        full: electrons, of light and dark current, at x = 1 [e-]. It tells what differs from frame to frame alone. The
        variance a + b electrons [e-^2], over full^2, is a / full^2 + (b / full) x: O and S.
        """
        dark, one = self.variance(temporal=True), self.variance(1.0, temporal=True)
        return (one - dark) / full, dark / full**2

    def difference(self, electrons: float, light: float) -> float:
        """Mean square of the difference of two neighbours in even light, as many in a row as in a column [e-^2].

        electrons: mean, of light and dark current [e-]. light: its part that PRNU multiplies [e-].
        """
        own = self.photons * electrons + self.read + self.offsets + self.response * light**2
        # The rows' noise cancels in a row and comes twice in a column, the columns' the other way round.
        lines = (self.lines + self.line_offsets + self.line_response * light**2) / 2
        return 2 * self._averaged(own + lines)

    def _averaged(self, variance):
        return (variance + self.rounding) / self.averaged + self.rounding_of_mean
