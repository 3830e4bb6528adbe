"""Plots of a sensor: raw mosaic, noise, signal-to-noise ratio and photon transfer."""

from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.measure.mosaic import color_mosaic, tile
from gpusim.measure.photon_transfer import PhotonTransfer
from gpusim.measure.photon_transfer import photon_transfer as measure_photon_transfer
from gpusim.measure.snr import snr_curve
from gpusim.pipeline.readout import Readout
from gpusim.plot.canvas import (
    CHANNELS,
    QUIET,
    axes_of,
    channel_colors,
    curve,
    finish,
    image,
    legend_once,
    picture_size,
    require_frame,
)

RAW_GAMMA = 2.2  # gamma of the mosaic's picture
# range of the histogram, and distance from black or saturation with clipped noise [sigma]
SPREAD, CUT = 5.0, 4.0
FLAT = (96, 96)  # pixels of the frames for a photon transfer curve
LOWEST = -10.0  # lowest SNR drawn [dB]


def raw(frame: Any, ax: Any = None, *, gamma: float = RAW_GAMMA) -> Any:
    """Plot a frame's raw mosaic, each pixel in its filter's colour.

    The black level is black, the white level has full colour.

    Args:
        frame: frame to plot.
        ax: matplotlib axes; None makes a new figure.
        gamma: (signal / white)^(1 / gamma) is shown.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type.
        Missing: if matplotlib is not installed.
        OutOfRange: if gamma is not positive and finite.
    """
    require_frame(frame, "raw")
    if not (isinstance(gamma, Real) and 0 < gamma < np.inf):
        raise OutOfRange("gamma", gamma, "0 < gamma < inf")
    sensor = frame.camera.sensor
    codes = raw_codes(frame.raw, sensor, gamma)
    rows, cols = codes.shape[:2]
    pattern = "stacked " + "".join(sensor.channels) if sensor.stacked else "/".join(sensor.cfa)
    return image(
        axes_of(ax, picture_size((rows, cols))),
        codes,
        f"{frame.camera.name}: raw, {pattern}, {cols} x {rows} pixels, 0 .. {sensor.white_level} DN",
    )


def raw_codes(raw, sensor: Sensor, gamma: float = RAW_GAMMA) -> np.ndarray:
    """Return uint8 (rows, cols, 3) of raw values [DN], (rows, cols) or stacked (C, rows, cols)."""
    black, white = sensor.dark_level, sensor.white_level
    values = np.clip(
        (np.asarray(raw, np.float32) - np.float32(black)) / np.float32(white - black), 0, 1
    )
    return color_mosaic(sensor, np.uint8(255 * values ** (1 / gamma) + 0.5))


def snr(
    camera: Camera | Sensor,
    ax: Any = None,
    *,
    light: str | Spectrum = "D65",
    seconds: float = 0.0,
    temporal: bool = False,
    label: str = "",
) -> Any:
    """Plot the signal-to-noise ratio of each channel against exposure, up to saturation.

    The grey line is the limit by photon noise only, for the channel with the highest response.

    Args:
        camera: a Camera or a Sensor.
        ax: matplotlib axes; None makes a new figure.
        light: light, see `gpusim.measure.snr_curve`.
        seconds: time of the dark current, see `gpusim.measure.snr_curve` [s].
        temporal: leave out fixed patterns, see `gpusim.measure.snr_curve`.
        label: name in the legend, for several sensors on one `ax`.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or the sensor has no noise.
        Missing: if matplotlib is not installed.
        OutOfRange: if `seconds` is negative or not finite.
        UnknownName: if the illuminant is unknown.
    """
    if not isinstance(camera, (Camera, Sensor)):
        raise BadData(f"snr: {type(camera).__name__}, wanted a Camera or a Sensor")
    sensor = camera.sensor if isinstance(camera, Camera) else camera
    found = snr_curve(sensor, light, seconds=seconds, temporal=temporal)
    if np.isposinf(found.snr).any():
        raise BadData(
            "snr: the sensor has no noise, so its ratio is infinite; set a noise, at least photon noise"
        )
    ax = axes_of(ax)
    left = ax.get_xlim()[0] if ax.get_lines() else np.inf
    lowest = max(LOWEST, float(found.snr.min()))
    most = int(found.saturation.argmin())
    below_saturation = found.exposure <= found.saturation[most]
    for (letter, color), values, full in zip(
        channel_colors(sensor.channels).items(), found.snr, found.saturation, strict=True
    ):
        best = f", at most {values.max():.1f} dB" if np.isfinite(full) else ""
        below = np.where(found.exposure <= full, values, np.nan)
        curve(ax, found.exposure, below, color, f"{label} channel {letter}{best}".strip())
        if np.isfinite(full):
            ax.plot([full], values[found.exposure == full], "o", color=color, markersize=4)
    limit = f"{label} photon noise only, channel {sensor.channels[most]}".strip()
    ax.plot(
        found.exposure[below_saturation],
        10 * np.log10(found.electrons[most, below_saturation]),
        color=QUIET,
        linestyle="--",
        zorder=0.5,
        label=legend_once(ax, limit),
    )
    ax.set_xscale("log")
    ax.set_ylim(bottom=lowest)
    ax.set_xlim(left=min(left, found.exposure[found.snr.max(axis=0) >= lowest][0]))
    named = light if isinstance(light, str) else light.name or "the given light"
    name = camera.name if isinstance(camera, Camera) else ""
    return finish(
        ax,
        name,
        f"{'temporal ' * temporal}SNR up to saturation",
        f"exposure of the sensor in {named} [lx s]",
        "signal to noise ratio [dB]",
    )


def noise(frame: Any, ax: Any = None) -> Any:
    """Plot a histogram of a frame's noise relative to the expected standard deviation.

    It shows raw values less the expected ones without noise, over the expected sigma of all noise
    including fixed patterns, for each channel. Pixels near black or saturation, whose noise is
    clipped, are left out. The dashed line is the normal distribution.

    Args:
        frame: frame of one exposure.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or no pixel can be used.
        Missing: if matplotlib is not installed.
    """
    deviations = noise_of(frame)
    ax, edges = axes_of(ax), np.linspace(-SPREAD, SPREAD, 41)
    middle, step = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    colors = channel_colors(frame.camera.sensor.channels)
    for letter, values in deviations.items():
        if values.size < 2:
            continue
        share = np.histogram(values, edges)[0] / (values.size * step)
        ax.step(
            middle,
            share,
            where="mid",
            color=colors[letter],
            label=f"{letter}: {values.size} pixels, mean {values.mean():+.3f}, sigma {values.std():.3f}",
        )
    ax.plot(
        middle,
        np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi),
        color="0.3",
        linestyle="--",
        label="normal",
    )
    ax.set_ylim(0, 1.55 * ax.get_ylim()[1])
    return finish(
        ax,
        frame.camera.name,
        "noise of one frame",
        "(raw value - expected) / expected sigma",
        "probability density",
    )


def noise_of(frame) -> dict[str, np.ndarray]:
    """Return deviations of the raw values over the expected sigma by channel [1].

    Pixels whose noise is clipped are left out.
    """
    require_frame(frame, "noise")
    if frame.averaged is None:
        raise BadData(
            "noise: a picture merged from several exposures has no single gain; wanted a frame of one exposure"
        )
    sensor = frame.camera.sensor
    own, gain = sensor.noise, sensor.gain_dn_per_electron
    electrons = frame.mean + own.operating_dark_current * frame.exposure_time
    parts = RawNoise.of(sensor, frame.averaged)
    variance = parts.variance(electrons) + (parts.response + parts.line_response) * np.square(
        frame.mean, dtype=float
    )
    sigma = np.sqrt(variance)
    inside = electrons + CUT * sigma < sensor.saturation
    if sensor.bits != FLOAT_BITS:
        inside &= sensor.dark_level + gain * (electrons - CUT * sigma) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (frame.raw - (sensor.dark_level + gain * electrons)) / (gain * sigma)
    inside &= np.isfinite(found)
    if not inside.any():
        raise BadData(
            "noise: all pixels are near black or saturation, where noise is clipped, or have no noise; "
            "wanted another exposure"
        )
    if found.ndim == 3:
        return {
            letter: one[use]
            for letter, one, use in zip(sensor.channels, found, inside, strict=True)
        }
    tiled = tile(sensor.cfa_indices, found.shape)
    return {
        letter: found[inside & (tiled == number)] for number, letter in enumerate(sensor.channels)
    }


def photon_transfer(
    what: Any, ax: Any = None, *, seed: int = 0, device: Device | str = "auto"
) -> Any:
    """Plot the photon transfer curve: temporal noise against signal, with fitted figures.

    Both are in digital numbers.

    Args:
        what: a PhotonTransfer of `gs.photon_transfer`; or a Camera or a Sensor, measured by
            simulated frames of even light from 1e-4 of saturation to above it.
        ax: matplotlib axes; None makes a new figure.
        seed: seed of the simulated frames.
        device: device for the simulated frames, see `gpusim.Simulator`.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or the sensor cannot be measured.
        Missing: if matplotlib is not installed.
    """
    name = what.name if isinstance(what, Camera) else ""
    if isinstance(what, (Camera, Sensor)):
        what = measure_transfer(what.sensor if isinstance(what, Camera) else what, seed, device)
    if not isinstance(what, PhotonTransfer):
        raise BadData(
            f"photon_transfer: {type(what).__name__}, wanted a PhotonTransfer, a Camera or a Sensor"
        )
    ax, floor = axes_of(ax), what.dark_noise_dn
    signal, total = what.signal, np.sqrt(np.maximum(what.variance, 0) + floor**2)
    lit = signal > 0
    ax.plot(signal[lit], total[lit], "o", color="0.2", markersize=4, label="frames")
    line = np.geomspace(signal[lit].min(), signal[what.saturation_level], 100)
    ax.plot(
        line,
        np.sqrt(what.gain * line),
        color=CHANNELS["B"],
        linestyle="--",
        label=f"photons: K = {what.gain:.4g} DN/e⁻",
    )
    ax.axhline(
        floor,
        color=CHANNELS["G"],
        linestyle="--",
        label=f"dark: {floor:.3g} DN, {what.dark_noise:.3g} e⁻",
    )
    ax.plot(line, np.sqrt(what.gain * line + floor**2), color=CHANNELS["R"], label="both")
    ax.axvline(
        signal[what.saturation_level],
        color=QUIET,
        label=f"saturation: {what.saturation_capacity:.4g} e⁻, range {what.dynamic_range_db:.1f} dB",
    )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.5 * min(floor, total[lit].min()))
    return finish(
        ax,
        name,
        "photon transfer",
        "signal above dark [DN]",
        "temporal noise, standard deviation [DN]",
    )


def measure_transfer(
    sensor: Sensor, seed: int = 0, device: Device | str = "auto"
) -> PhotonTransfer:
    """Measure the photon transfer of an unbinned sensor by simulated frames of even light.

    The light has the wavelength of highest quantum efficiency. Raises BadData.
    """
    sensor = replace(sensor, binning=(1, 1), stacked=False)
    readout = Readout(sensor, device)
    efficiency = float(sensor.qe.values.max()) * sensor.fill_factor
    parts = np.unique(np.concatenate([np.geomspace(1e-4, 0.05, 16), np.linspace(0.1, 1.3, 25)]))
    pixels = np.ones(FLAT, np.float32)

    def frames(electrons, number, count=2):
        return readout.draw_electrons(
            electrons * pixels, 1e-9, seed=seed, first=2 * number, frames=count
        )

    levels = (
        frames(np.float32(part * sensor.saturation), 1 + number)
        for number, part in enumerate(parts)
    )
    return measure_photon_transfer(
        levels, frames(np.float32(0), 0), parts * sensor.saturation / efficiency
    )
