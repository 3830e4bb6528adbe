"""Noise: fixed patterns that are far below the photon noise, measured by a tolerance."""

from dataclasses import replace
from math import sqrt
from typing import Any

from gpusim.domain.account import Bound, Tolerance
from gpusim.domain.sensor import Sensor

FAR = 10.0  # times below the tolerance
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
    found = {
        name: Bound(
            value, *(value * sqrt(sensor.saturation) * times for times in (QUANTILE, MAXIMUM))
        )
        for name in RESPONSES
        if (value := getattr(sensor.noise, name))
    }
    if tolerance.rms is None:
        dark = max(sensor.read_sigma, 1.0)
        found |= {
            name: Bound(0.0, *(value / dark * times for times in (QUANTILE, MAXIMUM)))
            for name in OFFSETS
            if (value := getattr(sensor.noise, name))
        }
    left = {name: bound for name, bound in found.items() if FAR * bound.ratio(tolerance) <= 1}
    if not left:
        return sensor, []
    named = RESPONSES | OFFSETS
    words = [
        f"{named[name]}: at most {bound.nearest(tolerance)[2]:.2g}{bound.nearest(tolerance)[4]}"
        for name, bound in left.items()
    ]
    none: dict[str, Any] = dict.fromkeys(left, 0.0)
    return replace(sensor, noise=replace(sensor.noise, **none)), words
