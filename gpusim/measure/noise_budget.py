"""The variance of a raw value by its causes: which noise dominates."""

from typing import Any

from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import Sensor


def noise_budget(
    sensor: Sensor, electrons: Any, seconds: float = 0.0, *, averaged: int = 1, added: int = 1
) -> dict[str, Any]:
    """Return the variance of a raw value by cause.

    The sum is that of `gpusim.domain.raw_noise.RawNoise`, whose remarks also apply here: row and
    column noise counts as independent noise of each pixel; telegraph noise, hot and dead pixels are
    not included. Noise near black or saturation is not clipped.

    Args:
        sensor: the sensor, as operated.
        electrons: mean electrons of light in an output pixel, a number or an array [e-].
        seconds: time during which dark current is collected [s].
        averaged: pixels whose digital numbers are averaged to one raw value (digital binning).
        added: pixels whose charge is added to one raw value (charge binning).

    Returns:
        Variance of each cause in electrons squared, in the form of `electrons` or a number. Causes
        that the sensor does not have are 0.
    """
    noise, gain = sensor.noise, sensor.gain_dn_per_electron
    parts = RawNoise.of(sensor, averaged)
    light = electrons * electrons / added
    found = {
        "photons": parts.photons * electrons,
        "dark current": parts.photons * noise.operating_dark_current * seconds,
        "read": noise.read**2,
        "reset": noise.reset**2,
        "converter": (noise.adc / gain) ** 2,
        "rows": noise.row**2,
        "columns": noise.column**2,
        "PRNU": noise.prnu**2 * light,
        "PRNU of lines": (noise.row_prnu**2 + noise.column_prnu**2) * light,
        "DSNU": noise.dsnu**2,
        "DSNU of lines": noise.row_dsnu**2 + noise.column_dsnu**2,
        "rounding": parts.rounding,
    }
    found = {cause: variance / averaged for cause, variance in found.items()}
    found["rounding"] += parts.rounding_of_mean
    return found
