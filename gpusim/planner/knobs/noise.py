"""Noise: fixed patterns that are far below the photon noise, measured by a tolerance."""

from dataclasses import replace
from math import sqrt
from typing import Any

from gpusim.domain.account import Bound
from gpusim.domain.sensor import Sensor
from gpusim.domain.tolerance import Tolerance

FAR = 10.0  # times below the tolerance: patterns that are left out
# of a normal distribution: 99.9 % of the pixels, all of some megapixels [sigma]
QUANTILE = 3.3
MAXIMUM = 5.0
RESPONSES = {"prnu": "PRNU", "row_prnu": "PRNU of rows", "column_prnu": "PRNU of columns"}
OFFSETS = {"dsnu": "DSNU", "row_dsnu": "DSNU of rows", "column_dsnu": "DSNU of columns"}


def without_negligible(sensor: Sensor, tolerance: Tolerance | None) -> tuple[Sensor, list[str]]:
    """Return the sensor without fixed patterns that are FAR below a tolerance, and their names.

    Without a tolerance it is the same sensor. The result depends only on sensor and tolerance, so
    digital numbers are the same on every device. Each is judged at its largest effect: a response
    at saturation, an offset in the dark. An offset is no relative error of a frame whose light is
    not known, so a tolerance with only a relative error keeps all offsets.
    """
    if tolerance is None:
        return sensor, []
    none: dict[str, Any] = {}
    left = []
    for name, words in (RESPONSES | OFFSETS).items():
        value = getattr(sensor.noise, name)
        if not value or (name in OFFSETS and tolerance.rms is not None):
            continue
        if name in RESPONSES:
            rms, sigma = value, value * sqrt(sensor.saturation)
        else:
            rms, sigma = 0.0, value / max(sensor.read_sigma, 1.0)
        bound = Bound(rms, sigma * QUANTILE, sigma * MAXIMUM)
        if FAR * bound.ratio(tolerance) <= 1:
            none[name] = 0.0
            _, _, size, _, unit, *_ = bound.nearest(tolerance)
            left.append(f"{words}: at most {size:.2g}{unit}")
    if none:
        sensor = replace(sensor, noise=replace(sensor.noise, **none))
    return sensor, left
