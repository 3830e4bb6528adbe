"""The variance of a raw value as a sum of named parts."""

from dataclasses import dataclass
from typing import Any

from gpusim.domain.sensor import FLOAT_BITS, Sensor

ROUNDING = 1 / 12  # variance of rounding to whole digital numbers [DN^2]


@dataclass(frozen=True)
class RawNoise:
    """Parts of the variance of the raw value of one pixel, in electrons squared. See `Noise`.

    Row and column noise counts as independent noise of each pixel, although the part that binned
    pixels share averages out less. Telegraph noise, hot and dead pixels are not included.

    Args:
        photons: Variance per mean electron of light or dark current: 1, or 0 without photon noise.
        read: Read, reset and converter noise of one read [e-^2].
        lines: Row and column noise of one frame [e-^2].
        offsets, line_offsets: Fixed offset patterns of pixels, and of rows and columns [e-^2].
        response, line_response: Relative variance of the response of pixels, and of rows and
            columns [1]; multiplies the squared electrons of light.
        rounding: Rounding to whole digital numbers [e-^2], 0 without a converter.
        averaged: Number of digital numbers that are averaged into a raw value (digital binning).
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
        """Return the noise of a sensor with its settings.

        Args:
            sensor: The sensor.
            averaged: See the class.

        Returns:
            The parts of the variance.
        """
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
        """Variance of rounding the mean of `averaged` digital numbers, 0 for a single one [e-^2].

        The mean of n whole numbers lies k / n from the nearest whole number. If the noise is about
        one digital number or more, all k are equally likely. For odd n, k runs from -(n - 1) / 2 to
        (n - 1) / 2, and the mean of (k / n)^2 is (1 - 1 / n^2) / 12. For even n, k runs from -n / 2
        to n / 2, the two ends with half the weight: (1 + 2 / n^2) / 12.
        """
        return self.rounding * (
            1 - self.averaged**-2 if self.averaged % 2 else 1 + 2 * self.averaged**-2
        )

    def variance(self, electrons: Any = 0.0, *, temporal: bool = False) -> Any:
        """Return the variance of a raw value around its mean, without PRNU.

        Args:
            electrons: Mean electrons of light and dark current [e-], a number or an array.
            temporal: Include only noise that differs from frame to frame.

        Returns:
            Variance [e-^2], in the form of `electrons`.
        """
        fixed = 0.0 if temporal else self.offsets + self.line_offsets
        return self._of_mean(self.photons * electrons + self.read + self.lines + fixed)

    def profile(self, full: float) -> tuple[float, float]:
        """Return (S, O) of the variance S x + O of x = electrons / full, the NoiseProfile of DNG.

        Only temporal noise counts. The variance a + b electrons [e-^2] divided by full^2 is a /
        full^2 + (b / full) x.

        Args:
            full: Electrons of light and dark current at x = 1 [e-].

        Returns:
            S and O [1].
        """
        dark, one = self.variance(temporal=True), self.variance(1.0, temporal=True)
        return (one - dark) / full, dark / full**2

    def difference(self, electrons: float, light: float) -> float:
        """Return the mean square difference of two neighbours in uniform light [e-^2].

        Half of the pairs are in a row, half in a column.

        Args:
            electrons: Mean electrons of light and dark current [e-].
            light: The part of them that PRNU multiplies [e-].

        Returns:
            Mean square [e-^2].
        """
        own = self.photons * electrons + self.read + self.offsets + self.response * light**2
        # Row noise cancels within a row and counts twice within a column; column noise vice versa.
        lines = (self.lines + self.line_offsets + self.line_response * light**2) / 2
        return 2 * self._of_mean(own + lines)

    def _of_mean(self, variance):
        """Return the variance of the mean of `averaged` values, with rounding."""
        return (variance + self.rounding) / self.averaged + self.rounding_of_mean
