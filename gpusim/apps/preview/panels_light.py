"""Panels of light and of raw values: spectra, line profiles, histograms, regions."""

import numpy as np

from gpusim.apps.preview.curves import ACCENT, Axis, Chart, Line, Mark, channel_color
from gpusim.apps.preview.figures import Note, Part, Table
from gpusim.apps.preview.measures import Inputs, Where, decibels, find_clipping
from gpusim.domain.errors import BadData
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.spectrum import energy_per_photon
from gpusim.measure.mosaic import channel_values, tile
from gpusim.measure.snr import snr
from gpusim.measure.spectra import QUANTITIES, electron_spectra, patch_spectrum

BINS, SOME = 128, 60000  # of the histogram, at most; pixels in it, about
LEAST_SHARE = 1e-3  # lowest share on the logarithmic axis [%]
WAITING = "the irradiance is computed when the settings and a moving scene rest"
# quantity of a profile -> its array, and its axis
PROFILES = {
    "electrons": ("mean", "mean electrons [e⁻]"),
    "DN": ("raw", "raw value [DN]"),
    "codes": ("codes", "display code"),
}


def spectrum(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the spectrum of the selected part, or of the pixel under the pointer."""
    quantity = chosen["quantity"]
    rows, cols = _part(where, found.scene.shape)
    place = f"columns {cols.start} .. {cols.stop - 1}, rows {rows.start} .. {rows.stop - 1}"
    if rows.stop - rows.start == cols.stop - cols.start == 1:
        place = f"column {cols.start}, row {rows.start}"
    if quantity == "radiance":
        region = cols.start, rows.start, cols.stop, rows.stop
        nodes, values = patch_spectrum(found.scene, region)
        lines = [Line("", nodes, values, ACCENT)]
        unit = QUANTITIES[quantity]
    else:
        if "irradiance" not in found.arrays:
            return [Note(WAITING)]
        nodes = found.scene.wavelengths
        light = found.arrays["irradiance"][:, rows, cols].mean(axis=(1, 2), dtype=np.float64)
        if quantity == "irradiance":
            lines = [Line("", nodes, light * energy_per_photon(nodes), ACCENT)]
            unit = "[W m⁻² nm⁻¹]"
        else:
            each = electron_spectra(found.camera, nodes, light, found.seconds)
            lines = [
                Line(letter, nodes, values, channel_color(letter))
                for letter, values in zip(found.camera.sensor.channels, each, strict=True)
            ]
            unit = "of a single pixel [e⁻/nm]"
    ends = Axis("wavelength [nm]", float(nodes[0]), float(nodes[-1]))
    return [Chart(f"spectrum at {place}", ends, Axis(f"{quantity} {unit}"), lines), Note(place)]


def profile(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the values along the row or column under the pointer."""
    name, label = PROFILES[chosen["quantity"]]
    values, is_row = found.arrays[name], chosen["along"] == "row"
    shape = values.shape[:2] if name == "codes" else values.shape[-2:]
    row, col = where.pixel(shape)
    line = np.s_[row, :] if is_row else np.s_[:, col]
    number = f"row {row}" if is_row else f"column {col}"
    across = np.arange(shape[is_row])
    sensor = found.sensor
    if name == "codes":
        lines = [
            Line(letter, across, values[..., plane][line], channel_color(letter))
            for plane, letter in enumerate("RGB")
        ]
    elif values.ndim == 3:
        lines = [
            Line(letter, across, plane[line], channel_color(letter))
            for letter, plane in zip(sensor.channels, values, strict=True)
        ]
    else:
        own = tile(sensor.cfa_indices, shape)[line]
        lines = [
            Line(letter, across[own == index], values[line][own == index], channel_color(letter))
            for index, letter in enumerate(sensor.channels)
            if (own == index).any()
        ]
    ends = Axis("column" if is_row else "row", 0, len(across) - 1)
    return [Chart(f"{chosen['quantity']} along {number}", ends, Axis(label), lines), Note(number)]


def histogram(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the shares of the raw values of each channel, and of clipped pixels."""
    sensor, raw = found.sensor, found.arrays["raw"]
    gain, dark = sensor.gain_dn_per_electron, sensor.dark_level
    some = _subsample(sensor, raw)
    top = float(sensor.white_level)
    if sensor.bits == FLOAT_BITS:
        low = min(0.0, *(float(values.min()) for values in some.values()))
        edges = np.linspace(low, max(top, *(float(one.max()) for one in some.values())), BINS + 1)
    else:
        step = -(-(int(top) + 1) // BINS)
        edges = np.arange(0, top + 1 + step, step) - 0.5  # whole numbers of values in a bin
    is_log = chosen["scale"] == "log"
    lines = []
    for letter, values in some.items():
        share = 100 * np.histogram(values, edges)[0] / values.size
        if is_log:
            share = np.maximum(share, LEAST_SHARE)
        lines.append(Line(letter, (edges[1:] + edges[:-1]) / 2, share, channel_color(letter)))
    full = dark + gain * sensor.saturation
    marks = [
        Mark(float(sensor.black_level), f"black level {sensor.black_level} DN"),
        Mark(full, f"saturation {sensor.saturation:.4g} e⁻"),
    ]
    if abs(full - top) > 0.5:
        marks.append(Mark(top, f"white level {top:.0f} DN"))
    x = Axis("raw value [DN]", float(edges[0]), float(max(edges[-1], full)))
    y = Axis("pixels [%]", LEAST_SHARE if is_log else 0.0, 100.0 if is_log else None, is_log)
    chart = Chart("histogram of raw values", x, y, lines, marks, ("[e⁻]", 1 / gain, dark))
    return [chart, Note(describe_clipping(*find_clipping(sensor, raw, found.merged_rendering)))]


def describe_clipping(bright: np.ndarray, dark: np.ndarray) -> str:
    """Return the shares of clipped pixels in words."""
    return f"clipped: {bright.mean():.2%} saturated, {dark.mean():.2%} at 0 DN"


def region(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return mean, standard deviation and their ratio for the raw values of a part."""
    sensor, raw = found.sensor, found.arrays["raw"]
    rows, cols = where.region(raw.shape[-2:])
    gain, dark = sensor.gain_dn_per_electron, sensor.dark_level
    body: list[tuple] = []
    for letter, values in channel_values(
        sensor, raw[..., rows, cols], (rows.start, cols.start)
    ).items():
        above = values.astype(np.float64) - dark
        sd = float(above.std(ddof=1)) if above.size > 1 else float("nan")
        try:
            ratio: str | float = snr(above[None])
        except BadData:
            ratio = "not defined: no mean above black"
        body.append(
            (
                letter,
                str(above.size),
                above.mean() + dark,
                sd,
                above.mean() / gain,
                sd / gain,
                ratio,
            )
        )
    head = ("channel", "pixels", "mean [DN]", "sd [DN]", "mean [e⁻]", "sd [e⁻]", "SNR [dB]")
    words = "selected" if where.part is not None else "near the pointer; select one with 'edge'"
    return [
        Table("statistics of a region", head, body),
        Note(
            f"region: columns {cols.start} .. {cols.stop - 1}, rows {rows.start} .. {rows.stop - 1}, "
            f"{words}; the sd has the scene's own changes, too"
        ),
    ]


def describe_pixel(found: Inputs, where: Where) -> str:
    """Return a line on the pixel under the pointer, from its mean electrons; "" without one."""
    if where.at is None or "mean" not in found.arrays:
        return ""
    sensor, mean = found.sensor, found.arrays["mean"]
    row, col = where.pixel(mean.shape[-2:])
    each = channel_values(sensor, mean[..., row : row + 1, col : col + 1], (row, col))
    words = [f"row {row}  column {col}"]
    for letter, values in each.items():
        electrons = float(values[0])
        number = electrons * sensor.gain_dn_per_electron + sensor.dark_level
        words.append(f"{letter} {electrons:.4g} e-  {min(number, sensor.white_level):.4g} DN")
        if found.averaged is not None and electrons > 0:
            variance = sum(found.variance(electrons).values())
            words.append(f"SNR {decibels(electrons, variance):.1f} dB")
    return "  ".join(words)


def _part(where, shape):
    """Return rows and columns of the selected part, or of the pixel under the pointer."""
    if where.part is not None:
        return where.region(shape)
    row, col = where.pixel(shape)
    return slice(row, row + 1), slice(col, col + 1)


def _subsample(sensor, raw):
    """Return values of about SOME pixels by channel: whole periods of the mosaic."""
    if raw.ndim == 3:
        step = max(1, round((raw[0].size / SOME) ** 0.5))
        return channel_values(sensor, raw[:, ::step, ::step])
    rows, cols = raw.shape
    high, wide = sensor.cfa_indices.shape
    step = max(1, round((raw.size / SOME) ** 0.5))
    y = (np.arange(0, rows, high * step)[:, None] + np.arange(high)).ravel()
    x = (np.arange(0, cols, wide * step)[:, None] + np.arange(wide)).ravel()
    return channel_values(sensor, raw[np.ix_(y[y < rows], x[x < cols])])
