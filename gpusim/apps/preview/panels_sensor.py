"""Panels of the sensor: efficiency and filters, signal to noise, and the noise by cause."""

import numpy as np

from gpusim.apps.preview.curves import ACCENT, Axis, Chart, Line, Mark, channel_color
from gpusim.apps.preview.figures import Bars, Note, Part
from gpusim.apps.preview.measures import Inputs, Where, decibels
from gpusim.domain.errors import BadData
from gpusim.measure.mosaic import channel_values

POINTS = 200  # of the curves
LOWEST = -10.0  # lowest signal to noise shown [dB]


def efficiency(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the efficiency of each channel, the lens's transmission and the filters."""
    sensor, optics = found.camera.sensor, found.camera.optics
    nodes = sensor.qe.wavelengths
    lines = [
        Line(f"channel {letter}", nodes, values, channel_color(letter))
        for letter, values in zip(sensor.channels, sensor.qe.values, strict=True)
    ]
    lens = optics.transmission_at(nodes)
    if lens.min() < 1:
        lines.append(Line("lens", nodes, lens, dash="6 3"))
    filters = sensor.filters
    if filters is not None and not filters.is_whole:
        table = filters.table
        lines += [
            Line(f"filter {letter}", table.wavelengths, values, channel_color(letter), "2 2")
            for letter, values in zip(filters.letters, np.atleast_2d(table.values), strict=True)
            if letter in sensor.channels
        ]
        for name, part in (("photodetector", filters.photodetector), ("IR cut", filters.ir_cut)):
            if part is not None:
                lines.append(Line(name, part.wavelengths, part.values, dash="1 3"))
    seen = np.flatnonzero(sensor.qe.values.max(axis=0) > 0)
    x = Axis("wavelength [nm]", float(nodes[seen[0]]), float(nodes[seen[-1]]))
    y = Axis("efficiency [e⁻/photon], transmission", 0.0)
    return [Chart("quantum efficiency", x, y, lines)]


def snr(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return signal to noise against electrons, and the points of the pixel or part."""
    sensor = found.sensor
    dark = sensor.noise.operating_dark_current * found.seconds
    room = sensor.saturation - dark
    if not room > 0:
        raise BadData(
            f"dark current fills the pixel: {dark:.4g} e- in {found.seconds:.4g} s; "
            "wanted a shorter exposure"
        )
    electrons = np.geomspace(min(1.0, room / 10), room, POINTS)
    fixed = {"PRNU", "PRNU of lines", "DSNU", "DSNU of lines"}
    parts = found.variance(electrons)
    temporal = sum(value for cause, value in parts.items() if cause not in fixed)
    lines = [
        Line("all noise", electrons, decibels(electrons, sum(parts.values()))),
        Line("without fixed patterns", electrons, decibels(electrons, temporal), dash="6 3"),
        Line("photon noise only", electrons, 10 * np.log10(electrons), dash="1 3"),
    ]
    points, words = _points(found, where)
    shown = []
    for letter, mean in points.items():
        value = float(decibels(mean, sum(found.variance(mean).values()))) if mean > 0 else -np.inf
        shown.append(f"{letter} {mean:.4g} e⁻, {value:.1f} dB")
        at = np.array([mean]), np.array([max(value, LOWEST)])
        lines.append(Line(letter, *at, channel_color(letter), is_points=True))
    finite = [value for line in lines[:3] for value in line.y if np.isfinite(value)]
    y = Axis("signal to noise [dB]", max(LOWEST, min(finite)), max(finite) + 3)
    x = Axis("mean electrons [e⁻]", float(electrons[0]), float(sensor.saturation), True)
    mark = Mark(float(sensor.saturation), "saturation")
    return [
        Chart("signal to noise ratio", x, y, lines, [mark]),
        Note(f"{words}: {'; '.join(shown)}"),
    ]


def budget(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the standard deviation of a raw value by cause, largest first."""
    points, words = _points(found, where)
    mean = float(np.mean(list(points.values())))
    parts = {cause: float(value) for cause, value in found.variance(mean).items() if value > 0}
    total = sum(parts.values())
    if not total > 0:
        return [Note("the sensor has no noise")]
    order = sorted(parts, key=lambda cause: -parts[cause])
    values = {cause: parts[cause] ** 0.5 for cause in order} | {"all together": total**0.5}
    most = f"{order[0]} dominates: {parts[order[0]] / total:.0%} of the variance"
    colors = {order[0]: ACCENT, "all together": "currentColor"}
    return [
        Bars(f"noise at {mean:.4g} e⁻", "standard deviation [e⁻]", values, colors),
        Note(f"{most}; {words}"),
    ]


def _points(found, where):
    """Return mean electrons by channel of the pixel or part, and the place in words."""
    mean = found.arrays["mean"]
    if where.part is not None:
        rows, cols = where.region(mean.shape[-2:])
        words = "mean of the selected part"
    else:
        row, col = where.pixel(mean.shape[-2:])
        rows, cols, words = slice(row, row + 1), slice(col, col + 1), f"row {row}, column {col}"
    each = channel_values(found.sensor, mean[..., rows, cols], (rows.start, cols.start))
    return {letter: float(one.mean(dtype=np.float64)) for letter, one in each.items()}, words
